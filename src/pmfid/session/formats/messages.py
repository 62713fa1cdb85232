"""Messages of a robot's log: each number in them is a signal, named by its dotted path."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass

import numpy as np

from pmfid.session.formats.signals import ClockedSignals, Signal

#: Most elements of an array that become columns; a longer one is an image or a cloud.
LONGEST = 64
DEEPEST = 8
NANOSECOND = 1e-9


def signals_of(messages: Iterable[tuple[str, int, object]]) -> ClockedSignals:
    """Signals of messages, as (topic, stamp [ns], message): "/joint_states.position.0" on the stamps of its topic. A
    stamp inside a message is in s from the first one."""
    stamps: dict[str, list[int]] = {}
    values: dict[str, list[float | int]] = {}
    moments = set[str]()
    for topic, time, message in messages:
        for path, number in _numbers(topic, message, DEEPEST, moments):
            stamps.setdefault(path, []).append(time)
            values.setdefault(path, []).append(number)
    first = min((times[0] for times in stamps.values()), default=0)
    found = {}
    for path, times in stamps.items():
        since = np.array([time - first for time in times], np.float64) * NANOSECOND
        own = values[path]
        numbers = [value - own[0] for value in own] if path in moments else own
        found[path] = Signal(since, np.array(numbers, np.float64) * (NANOSECOND if path in moments else 1.0))
    return ClockedSignals(found)


def _numbers(path: str, value: object, depth: int, moments: set[str]) -> Iterator[tuple[str, float | int]]:
    """The numbers in a message by path; paths of stamps [ns] go into `moments`."""
    if isinstance(value, bool | int | float | np.number | np.bool_):
        yield path, value.item() if isinstance(value, np.generic) else value
        return
    inside = _inside(value)
    if depth == 0 or inside is None:
        return
    moment = _moment(inside)
    if moment is not None:
        moments.add(path)
        yield path, moment
        return
    for name, part in inside.items():
        if not name.startswith("__"):
            yield from _numbers(f"{path}.{name}", part, depth - 1, moments)


def _inside(value: object) -> Mapping[str, object] | None:
    """The parts of a value by name; None for a value without parts that may be numbers."""
    if isinstance(value, Mapping):
        return value
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str | bytes) and len(value) <= LONGEST:
        return {str(k): part for k, part in enumerate(value)}
    return None


def _moment(inside: Mapping[str, object]) -> int | None:
    """Nanoseconds of a stamp of ROS or Foxglove; None for any other value."""
    nanos = inside.get("nanosec", inside.get("nsec"))
    seconds = inside.get("sec")
    named = set(inside) - {"__msgtype__"} in ({"sec", "nanosec"}, {"sec", "nsec"})
    return seconds * 10**9 + nanos if named and isinstance(seconds, int) and isinstance(nanos, int) else None

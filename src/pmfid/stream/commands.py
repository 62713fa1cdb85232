"""Commands to the engine, and its counters."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from threading import Lock

from pmfid.stream.tuning import TUNING

__all__ = ["Counters"]

#: Sorted pairs of label and value.
Labels = tuple[tuple[str, str], ...]


@dataclass
class Counters:
    """Totals that only grow (`add`) and levels that are set (`put`). Names are Prometheus's, as
    "pmfid_samples_total"; labels are few: sources, sinks, reasons, groups, never axes."""

    _values: dict[tuple[str, Labels], float] = field(default_factory=dict, init=False)
    _lock: Lock = field(default_factory=Lock, init=False)

    def add(self, name: str, amount: float = 1, **labels: str) -> None:
        """Adds to a total."""
        key = name, tuple(sorted(labels.items()))
        with self._lock:
            self._values[key] = self._values.get(key, 0) + amount

    def put(self, name: str, value: float, **labels: str) -> None:
        """Sets a level."""
        with self._lock:
            self._values[name, tuple(sorted(labels.items()))] = value

    def values(self) -> Mapping[tuple[str, Labels], float]:
        """All of them now."""
        with self._lock:
            return dict(self._values)


@dataclass(frozen=True)
class Acknowledge:
    """Someone has acknowledged the alarm with this notice number."""

    number: int
    note: str


@dataclass(frozen=True)
class Refer:
    """The present parameters of the axis become its reference."""

    axis: str


@dataclass(frozen=True)
class RestartNumbers:
    """The sender of the axis restarted without a higher epoch: its next samples are taken whatever their numbers."""

    axis: str


Command = Acknowledge | Refer | RestartNumbers


class Commands:
    """Commands on their way to the engine, from any thread. A `Notice` reports the result of each."""

    def __init__(self) -> None:
        self._waiting: deque[Command] = deque()
        self._lock = Lock()

    def acknowledge(self, number: int, note: str) -> bool:
        """False if the queue of commands is full."""
        return self._put(Acknowledge(number, note[: TUNING.longest_note]))

    def refer(self, axis: str) -> bool:
        """False if the queue of commands is full."""
        return self._put(Refer(axis))

    def restart_numbers(self, axis: str) -> bool:
        """False if the queue of commands is full."""
        return self._put(RestartNumbers(axis))

    def _put(self, command: Command) -> bool:
        with self._lock:
            if len(self._waiting) >= TUNING.commands_most:
                return False
            self._waiting.append(command)
            return True

    def take_all(self) -> list[Command]:
        """Removes and returns all waiting commands, in order; for the engine."""
        with self._lock:
            commands, self._waiting = list(self._waiting), deque()
        return commands

"""Rows and notices as an engine offers them, a sink that can fail, and a standard input for the tests of services."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pmfid.service.sinks.queued import Queued, QueueLimits, SinkSection
from pmfid.stream.outcome import Counters, EstimateRows, Kindred, Notice
from tests.patience import PATIENCE

ALARM = {
    "event": "alarm",
    "time": 12.5,
    "parameter": "mass",
    "direction": "up",
    "change": 0.21,
    "std": 0.02,
    "unit": "kg",
    "relative": 0.2,
    "changed_at": 11.0,
    "statistic": 31.0,
    "threshold": 20.0,
}


def kindred(axes: int = 3, config: str = "cart.toml", names: tuple[str, ...] = ("mass", "friction")) -> Kindred:
    """Return a group of axes x0, x1, ..."""
    named = tuple(f"x{k}" for k in range(axes))
    return Kindred(config, names, ("kg",) * len(names), 0.01, np.ones(len(names)), named)


def block(group: Kindred, first: int = 1, samples: int = 1) -> EstimateRows:
    """Return rows of every axis in the order of time, with numbers that identify each row."""
    k, q = len(group.axes), len(group.names)
    axis = np.tile(np.arange(k), samples)
    number = first + np.repeat(np.arange(samples), k)
    theta = number[:, None] + 0.25 * np.arange(q) + 0.001 * axis[:, None]
    return EstimateRows(
        group,
        axis,
        number,
        1e9 + 0.01 * number,
        0.5 * number,
        number * 7,
        theta,
        theta / 100,
        np.full(axis.size, 0.125),
        np.full(axis.size, 2, np.uint32),
        np.ones(axis.size, np.uint8),
        1.0,
    )


def alarm(number: int, axis: str = "x1", **changed: object) -> Notice:
    """Return an alarm on the mass."""
    return Notice(axis, number, 1.7e9 + number, {**ALARM, **changed})


def notice(number: int, event: str, axis: str = "x1", **what: object) -> Notice:
    """Return a notice of any other event."""
    return Notice(axis, number, 1.7e9 + number, {"event": event, **what})


def numbers(outcomes: list[EstimateRows | Notice]) -> list[int]:
    """Return the numbers of the notices, and of the first row of each block."""
    return [one.number if isinstance(one, Notice) else int(one.number[0]) for one in outcomes]


@dataclass
class Host:
    """A service that hosts a sink."""

    folder: Path
    name: str = "hall-3"
    counters: Counters = field(default_factory=Counters)
    reported: list[dict[str, Any]] = field(default_factory=list)

    @property
    def tell(self) -> Callable[[dict[str, Any]], None]:
        """Return a function that keeps the reports."""
        return self.reported.append

    def count(self, name: str, **labels: str) -> float:
        """Return the value of a total or a level."""
        return self.counters.values().get((name, tuple(sorted(labels.items()))), 0.0)


@dataclass
class Faulty:
    """A sink that keeps its input and can fail.

    `error` is raised while it is set, and `open_error` is raised by `open`. The number `poison` raises ValueError.
    `put` waits for the event `hold`.
    """

    name: str = "s"
    takes_rows: bool = True
    events: frozenset[str] | None = None
    error: Exception | None = None
    open_error: Exception | None = None
    poison: int | None = None
    hold: threading.Event | None = None
    got: list[EstimateRows | Notice] = field(default_factory=list)
    opened: int = 0
    closed: int = 0
    puts: int = 0

    def open(self) -> None:
        self.opened += 1
        if self.open_error:
            raise self.open_error

    def put(self, outcomes: list[EstimateRows | Notice]) -> None:
        self.puts += bool(outcomes)
        if self.hold is not None and outcomes:
            self.hold.wait(PATIENCE)
        if self.error:
            raise self.error
        if self.poison in numbers(outcomes):
            raise ValueError(f"number {self.poison} is poison")
        self.got += outcomes

    def close(self) -> None:
        self.closed += 1


def queue_of(section: SinkSection, name: str, host: Host, limits: QueueLimits | None = None) -> Queued:
    """Return the queue of a section's sink, not yet started."""
    return Queued(section.make(name, host), host.counters, host.tell, limits or section.limits)  # type: ignore[arg-type]


def until(true: Callable[[], object], seconds: float = PATIENCE) -> bool:
    """Wait until the condition is true."""
    end = time.monotonic() + seconds
    while not true():
        if time.monotonic() > end:
            return False
        time.sleep(0.002)
    return True


@contextmanager
def standard_input() -> Iterator[Callable[[str], None]]:
    """Replace standard input by a pipe, and yield a function that writes to the pipe."""
    out, into = os.pipe()
    with os.fdopen(out) as stream, pytest.MonkeyPatch.context() as patched:
        patched.setattr("sys.stdin", stream)
        yield lambda text: _write(into, text.encode())
    os.close(into)


@contextmanager
def file_as_input(path: Path) -> Iterator[None]:
    """Replace standard input by a file."""
    with path.open() as stream, pytest.MonkeyPatch.context() as patched:
        patched.setattr("sys.stdin", stream)
        yield


def _write(file: int, data: bytes) -> None:
    while data:
        data = data[os.write(file, data) :]

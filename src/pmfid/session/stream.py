"""Samples as they arrive: lines of CSV from a pipe, and the same from a record; stopping in good order."""

from __future__ import annotations

import math
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, BinaryIO

from pmfid.errors import UsageError, did_you_mean
from pmfid.session.clock import time_factor
from pmfid.session.config import Axis
from pmfid.session.records import Record

#: Beyond it neighbouring whole numbers are no longer separate doubles.
_MAX_COUNT = 2.0**53


@dataclass(frozen=True)
class Sample:
    """time [s]; u, NaN where the line is bad; counts; missing: samples that should have come before; problem: of the
    line, or ""."""

    time: float
    u: float
    counts: int
    missing: int = 0
    problem: str = ""


class _InterruptedError(Exception):
    """A signal came while nothing was being processed."""


@dataclass
class Stop:
    """Ends a run after the sample in hand at SIGINT and SIGTERM, or at once where it waits for the next one."""

    requested: bool = field(default=False, init=False)
    _waiting: bool = field(default=False, init=False)

    def _handle(self, number: int, frame: Any) -> None:
        self.requested = True
        if self._waiting:
            raise _InterruptedError

    @contextmanager
    def handling(self) -> Iterator[Stop]:
        """Signals are handled here inside of the block."""
        before = {number: signal.signal(number, self._handle) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield self
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def read(self, stream: BinaryIO) -> bytes:
        """The next line, b"" at the end or when a signal comes."""
        try:
            self._waiting = True
            line = b"" if self.requested else stream.readline()
            self._waiting = False
        except _InterruptedError:
            return b""
        finally:
            self._waiting = False
        return line


def record_samples(record: Record, stop: Stop) -> Iterator[Sample]:
    """The samples of a record, from time 0."""
    for k in range(record.u.size):
        if stop.requested:
            return
        yield Sample(k * record.dt, float(record.u[k]), int(record.counts[k]))


def line_samples(stream: BinaryIO, axis: Axis, dt: float, stop: Stop) -> Iterator[Sample]:
    """A sample for every line after the header, as soon as it is there.

    A line that cannot be used gives a sample with u = NaN and the last count, so that time goes on. dt: sample period
    [s]. Raises UsageError for a header without the columns of [record], or no line at all.
    """
    header = stop.read(stream)
    if not header.strip():
        if stop.requested:
            return
        raise UsageError("standard input is empty: write the header with the names of the columns first")
    parse = _Parser(header, axis, dt)
    while line := stop.read(stream):
        if line.strip():
            yield parse(line)


class _Parser:
    def __init__(self, header: bytes, axis: Axis, dt: float) -> None:
        config = axis.record
        if isinstance(config.input_scale, str):
            raise UsageError(f"[record] input_scale = {config.input_scale!r} names a variable; a pipe needs a number")
        names = [name.strip().strip('"') for name in header.decode("utf-8-sig", "replace").split(",")]
        wanted = [config.input, config.output] + ([config.time] if config.time else [])
        for name in wanted:
            if name not in names:
                known = ", ".join(names[:30])
                raise UsageError(f"standard input has no column {name!r}; it has {known}{did_you_mean(name, names)}")
        self._columns, self._width = [names.index(name) for name in wanted], len(names)
        self._scale, self._dt = config.input_scale, dt
        self._unit = time_factor(config)
        self._step = axis.encoder.resolution if config.output_kind == "position" else None
        self._time, self._counts, self._first = -dt, 0, True

    def __call__(self, line: bytes) -> Sample:
        try:
            values = [float(cell) for cell in self._cells(line)]
            values[2:] = [self._unit * time for time in values[2:]]
            counts = self._count(values[1])
            if not all(math.isfinite(value) for value in values):
                raise ValueError("a value that is not finite")
            missing = self._advance(values)
        except (ValueError, OverflowError) as error:
            self._time += self._dt
            return Sample(self._time, math.nan, self._counts, 0, str(error))
        self._counts, self._first = counts, False
        return Sample(self._time, self._scale * values[0], counts, missing)

    def _cells(self, line: bytes) -> list[str]:
        cells = line.decode("utf-8", "replace").split(",")
        if len(cells) != self._width:
            raise ValueError(f"{len(cells)} cells in place of {self._width}")
        return [cells[column] for column in self._columns]

    def _count(self, value: float) -> int:
        """The count of an output; a position a hair below a step belongs to it, as in a record."""
        counts = math.floor(value / self._step + 1e-6) if self._step else round(value)
        if abs(counts) >= _MAX_COUNT or (self._step is None and abs(counts - value) > 1e-6):
            raise ValueError(f"counts must be whole numbers below 2**53, got {value:.9g}")
        return counts

    def _advance(self, values: list[float]) -> int:
        """Goes on to the time of the line; the samples that were left out."""
        if len(values) < 3 or self._first:
            self._time = values[2] if len(values) == 3 else self._time + self._dt
            return 0
        steps = (values[2] - self._time) / self._dt
        if steps < 0.5:
            raise ValueError(f"time does not increase: {values[2]:.9g} after {self._time:.9g}")
        self._time = values[2]
        return max(0, round(steps) - 1)

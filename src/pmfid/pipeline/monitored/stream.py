"""Samples from lines of CSV in a pipe or from a record, with an orderly end on signals."""

from __future__ import annotations

import math
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import FrameType
from typing import BinaryIO, NoReturn

from pmfid.config.axis import Axis
from pmfid.errors import UsageError
from pmfid.io.csv_text import is_data
from pmfid.pipeline.monitored.lines import LineParser, is_comment
from pmfid.pipeline.monitored.timeline import BAD, COMMENT, REPEATED, Found, Metronome, Sample, Skipped, Timeline
from pmfid.pipeline.tuning import TUNING
from pmfid.records.record import Record


class _InterruptedError(Exception):
    """The error of a signal that arrives while the run waits for input."""


@contextmanager
def catch_signals(handle: Callable[[int, FrameType | None], None], hangup: bool = True) -> Iterator[None]:
    """Pass SIGINT, SIGTERM and SIGHUP to a handler inside the block.

    SIGHUP is passed only if `hangup` is set and the system has the signal.
    """
    numbers = [signal.SIGINT, signal.SIGTERM]
    if hangup and hasattr(signal, "SIGHUP"):
        numbers.append(signal.SIGHUP)
    before = {number: signal.signal(number, handle) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@dataclass
class Stop:
    """A handler that ends a run on SIGINT, SIGTERM or SIGHUP.

    The run ends after the present sample, or at once if no sample is in progress. An ignored SIGHUP, as under nohup,
    remains ignored.
    """

    requested: bool = field(default=False, init=False)
    _waiting: bool = field(default=False, init=False)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self.requested = True
        if self._waiting:
            raise _InterruptedError

    @contextmanager
    def handling(self) -> Iterator[Stop]:
        """Handle signals with this object inside the block."""
        hangup = getattr(signal, "SIGHUP", None)
        ignored = hangup is not None and signal.getsignal(hangup) is signal.SIG_IGN
        with catch_signals(self._handle, hangup=not ignored):
            yield self

    def read(self, stream: BinaryIO) -> bytes:
        """Return the next line, or b"" at the end or on a signal."""
        try:
            self._waiting = True
            line = b"" if self.requested else stream.readline(TUNING.longest_line)
            self._waiting = False
        except _InterruptedError:
            return b""
        finally:
            self._waiting = False
        return line


def record_samples(record: Record, stop: Stop) -> Iterator[Sample]:
    """Yield the samples of a record, starting at time 0."""
    column = record.ages if record.temperature is None else record.temperature
    for k in range(record.u.size):
        if stop.requested:
            return
        further = math.nan if column is None else float(column[k])
        yield Sample(k * record.dt, float(record.u[k]), int(record.counts[k]), further=further)


def line_samples(stream: BinaryIO, axis: Axis, dt: float, stop: Stop) -> Iterator[Found]:
    """Yield the samples of the lines after the header, each as soon as possible, and the skipped lines.

    dt [s] is the sample period. Raises UsageError if the header does not have the columns of [record], or if the lines
    have another sample period than dt. The error also occurs without any line, or if the first lines or most of all
    lines are unusable.
    """
    parse = _read_header(stream, axis, stop)
    if parse is None:
        return
    timeline = Timeline(dt) if axis.record.time else Metronome(dt)
    tally = _Tally()
    while line := stop.read(stream):
        if not line.strip():
            continue
        parsed = parse(line)
        found = [Skipped(0.0, COMMENT, "")] if parsed is None else timeline.take(parsed)
        tally.count(found)
        yield from found
    yield from timeline.end()
    tally.check()


def _read_header(stream: BinaryIO, axis: Axis, stop: Stop) -> LineParser | None:
    """Return the parser with the header, or None if a signal comes before the header."""
    beginning = Beginning(axis)
    while line := stop.read(stream):
        parser = beginning.take(line)
        if parser is not None:
            return parser
    if stop.requested:
        return None
    raise beginning.problem


@dataclass
class Beginning:
    """The search for the header, which is the first line with the columns.

    Earlier lines, such as the name of the logger, are skipped. A line of data ends the search. `problem` says why no
    line so far is the header.
    """

    axis: Axis
    problem: UsageError = field(
        default_factory=lambda: UsageError(
            "standard input is empty: write the header with the names of the columns first"
        ),
        init=False,
    )
    _lines: int = field(default=0, init=False)

    def take(self, line: bytes) -> LineParser | None:
        """Return the parser for the next lines if this line is the header.

        Raises UsageError if no header can follow.
        """
        if is_comment(line):
            return None
        self._lines += 1
        data = is_data(line.decode("utf-8", "replace"))
        try:
            return LineParser(line, self.axis)
        except UsageError as error:
            self.problem = self.problem if data and self._lines > 1 else error
        if data or self._lines >= TUNING.first_lines:
            raise self.problem
        return None


@dataclass
class _Tally:
    """Totals of samples, bad lines, repeated lines and lines since the last sample. A run with too few samples ends
    with an error.
    """

    samples: int = 0
    bad: int = 0
    repeated: int = 0
    tail: int = 0
    problem: str = ""

    @property
    def lines(self) -> int:
        return self.samples + self.bad + self.repeated

    def count(self, found: Sequence[Found]) -> None:
        """Count the findings. Raises UsageError if the first lines are bad."""
        before = self.lines
        for one in found:
            if isinstance(one, Sample):
                self._sample(one)
            elif one.kind != COMMENT:
                self._count_skipped(one)
        if before < TUNING.first_lines <= self.lines and self.samples < TUNING.least_samples:
            self._refuse(self.lines - self.samples, self.lines)

    def _sample(self, sample: Sample) -> None:
        if math.isfinite(sample.u):
            self.samples += 1
            self.tail, self.problem = 0, ""

    def _count_skipped(self, line: Skipped) -> None:
        self.bad += line.kind == BAD
        self.repeated += line.kind == REPEATED
        self.tail += 1
        self.problem = self.problem or line.problem

    def check(self) -> None:
        """Raise UsageError if the last lines are bad, if bad lines are the majority, or if nearly all lines are
        repeated.
        """
        if self.tail >= TUNING.first_lines:
            self._refuse(self.tail, self.tail)
        if max(self.bad, self.repeated // TUNING.most_repeated) > self.samples:
            self._refuse(self.bad + self.repeated, self.lines)

    def _refuse(self, unusable: int, lines: int) -> NoReturn:
        which = f"{unusable} of {lines} lines" if lines > unusable else f"the last {lines} lines"
        problem = f", the first of them: {self.problem}" if self.problem else ""
        raise UsageError(f"{which} cannot be used{problem}; correct what the logger writes")

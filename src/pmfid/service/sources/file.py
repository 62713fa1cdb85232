"""Sources of samples from a record played at a given speed, a growing file, or standard input."""

from __future__ import annotations

import math
import os
import select
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event
from typing import Annotated, BinaryIO, Literal

from pydantic import AfterValidator, Field

from pmfid.config.axis import Axis
from pmfid.config.model import Name
from pmfid.errors import UsageError
from pmfid.pipeline.monitored.lines import LineParser
from pmfid.pipeline.monitored.stream import Beginning
from pmfid.pipeline.monitored.timeline import Line
from pmfid.pipeline.tuning import TUNING as PIPELINE_TUNING
from pmfid.records.record import Record, read_record
from pmfid.service.context import CHUNK, Context, ProblemReport, Source, SourceSection, Take
from pmfid.service.tuning import TUNING
from pmfid.stream.delivery import Block, Delivery, Lines, Mark


def _usable(value: float) -> float:
    if value != 0 and not TUNING.file_slowest <= value <= TUNING.file_fastest:
        raise ValueError(f"a speed must be 0, or from {TUNING.file_slowest} to {TUNING.file_fastest:g}")
    return value


Speed = Annotated[float, AfterValidator(_usable)]


class FileSource(SourceSection):
    """The keys of [sources.NAME] with kind = "file", for lines of a growing file or a played record."""

    kind: Literal["file"] = Field(description='"file"')
    path: Name = Field(description='the file to read, for example "logs/x1.csv"')
    axis: Name = Field(description="the name of the axis that the record belongs to")
    speed: Speed | None = Field(
        None,
        description=(
            "the speed of the replay: 1.0 is real time, 0.0 is as fast as possible; without it the file "
            "is followed as it grows"
        ),
    )

    def make(self, name: str, context: Context) -> Source:
        """Return the source. Raises UsageError for an axis that is not in the plant."""
        axis, path = _axis(context, self.axis), context.folder / self.path
        if self.speed is not None:
            return Player(name, self.axis, path, axis, self.speed)
        return Follower(name, self.axis, path, axis, context)


class StdinSource(SourceSection):
    """The keys of [sources.NAME] with kind = "stdin", for lines of CSV as in `pmfid monitor -`."""

    kind: Literal["stdin"] = Field(description='"stdin"')
    axis: Name = Field(description="the name of the axis that the lines belong to")

    def make(self, name: str, context: Context) -> Source:
        return Piped(name, self.axis, _axis(context, self.axis), sys.stdin.buffer)


def _axis(context: Context, name: str) -> Axis:
    axis = context.axis(name)
    if axis is None:
        raise UsageError(f"the plant has no axis {name!r}; give the name of a section [axes.NAME]")
    return axis


@dataclass
class Player:
    """A record in blocks, as if it were measured now.

    `speed` is a multiple of the machine's speed. 0 means as fast as possible.
    """

    name: str
    axis: str
    path: Path
    config: Axis
    speed: float
    record: Record | None = None
    _stop: Event = field(default_factory=Event, init=False)

    def run(self, take: Take, mark: Mark | None) -> None:
        """Hand over all samples, or the samples after the mark."""
        record = read_record(self.path, self.config) if self.record is None else self.record
        status = os.stat(self.path)
        version, epoch, start = f"{status.st_size} {status.st_mtime_ns}", 0, 0
        if mark is not None:
            same = mark.get("version") == version
            epoch, start = int(mark["epoch"]) + (not same), int(mark["sample"]) if same else 0
        size = min(TUNING.file_block, max(1, round(TUNING.block_time / record.dt)) if self.speed else TUNING.file_block)
        begun = time.monotonic() - (start * record.dt / self.speed if self.speed else 0.0)
        for first in range(start, record.u.size, size):
            end = min(first + size, record.u.size)
            if self.speed and self._stop.wait(max(0.0, begun + end * record.dt / self.speed - time.monotonic())):
                return
            u, counts = record.u[first:end], record.counts[first:end]
            ages = None if record.ages is None else record.ages[first:end]
            block = Block(self.axis, epoch, first, math.nan, record.dt, u, counts, ages)
            position: Mark = {"version": version, "epoch": epoch, "sample": end}
            if self._stop.is_set() or not take(Delivery(self.name, (block,), None, position, time.monotonic())):
                return

    def stop(self) -> None:
        self._stop.set()


@dataclass
class _Text:
    """The bytes of a stream as lines of one axis. `header` is the line with the names of the columns, once known."""

    source: str
    axis: str
    config: Axis
    header: bytes = b""
    _rest: bytes = field(default=b"", init=False)

    def __post_init__(self) -> None:
        self._beginning = Beginning(self.config)
        self._parse = LineParser(self.header, self.config) if self.header else None

    def take(self, chunk: bytes) -> list[Line]:
        """Return the samples of the lines that end in the chunk. An unfinished line waits for the next chunk.

        Raises UsageError without a header.
        """
        text = self._rest + chunk
        *whole, self._rest = text.split(b"\n")
        if len(self._rest) > PIPELINE_TUNING.longest_line:
            whole, self._rest = [*whole, self._rest], b""
        return list(self._lines(whole))

    def end(self) -> list[Line]:
        """Return the samples of the last line, which has no line feed."""
        rest, self._rest = self._rest, b""
        return list(self._lines([rest]))

    @property
    def unfinished(self) -> int:
        """Number of bytes of the line that waits for its end."""
        return len(self._rest)

    def _lines(self, whole: list[bytes]) -> Iterator[Line]:
        for line in whole:
            if self._parse is None:
                self._parse = self._beginning.take(line)
                self.header = line if self._parse is not None else b""
                continue
            parsed = self._parse(line) if line.strip() else None
            if parsed is not None:
                yield parsed


@dataclass
class Piped:
    """A source of the lines of a stream, until the stream ends."""

    name: str
    axis: str
    config: Axis
    stream: BinaryIO
    _stop: Event = field(default_factory=Event, init=False)

    def run(self, take: Take, mark: Mark | None) -> None:
        """Hand over the lines as they arrive.

        Lines cannot be read twice, so they have no mark. Raises UsageError for a stream without a header.
        """
        text = _Text(self.name, self.axis, self.config)
        while not self._stop.is_set():
            chunk = self._read()
            if chunk is None:
                continue
            lines = text.take(chunk) if chunk else text.end()
            if lines and not take(Delivery(self.name, (Lines(self.axis, lines),), received=time.monotonic())):
                return
            if not chunk:
                return

    def _read(self) -> bytes | None:
        """Return the next bytes, b"" at the end, or None after a pause without bytes, so that `stop` takes effect."""
        try:
            number = self.stream.fileno()
        except OSError:  # a stream in this process has no number
            return self.stream.read(CHUNK)
        if not select.select([number], [], [], 2 * TUNING.file_look)[0]:
            return None
        return os.read(number, CHUNK)

    def stop(self) -> None:
        self._stop.set()


@dataclass
class Follower:
    """The lines of a growing file, as `tail -F` follows it.

    A replaced or truncated file is read from its start.
    """

    name: str
    axis: str
    path: Path
    config: Axis
    context: Context
    _stop: Event = field(default_factory=Event, init=False)

    def __post_init__(self) -> None:
        self._report = ProblemReport(self.name, self.context.tell)

    def run(self, take: Take, mark: Mark | None) -> None:
        """Hand over the lines as they arrive. The first line is at the mark unless the file was replaced."""
        while not self._stop.is_set():
            try:
                with open(self.path, "rb", buffering=0) as file:
                    since, mark = mark, None
                    if not self._follow(file, take, since):
                        return
            except (OSError, UsageError) as error:
                problem = error.strerror or str(error) if isinstance(error, OSError) else str(error)
                self._report.say(f"{self.path.name}: {problem}")
            self._stop.wait(TUNING.file_look)

    def _follow(self, file: BinaryIO, take: Take, mark: Mark | None) -> bool:
        """Follow a file. Returns False once the service ends, and True if another file has replaced this one."""
        number, offset, header = os.fstat(file.fileno()).st_ino, 0, b""
        if mark is not None and mark["file"] == number and int(mark["offset"]) <= os.fstat(file.fileno()).st_size:
            offset, header = int(mark["offset"]), str(mark["header"]).encode("utf-8", "surrogateescape")
        text = _Text(self.name, self.axis, self.config, header)
        file.seek(offset)
        while not self._stop.is_set():
            chunk = file.read(CHUNK)
            if not chunk:
                if self._is_replaced(number, offset):
                    return True
                self._stop.wait(TUNING.file_look)
                continue
            offset += len(chunk)
            lines = text.take(chunk)
            self._report.say("")
            header_text = text.header.decode("utf-8", "surrogateescape")
            position: Mark = {"file": number, "offset": offset - text.unfinished, "header": header_text}
            if lines and not take(
                Delivery(self.name, (Lines(self.axis, lines),), mark=position, received=time.monotonic())
            ):
                return False
        return False

    def _is_replaced(self, number: int, offset: int) -> bool:
        try:
            status = os.stat(self.path)
        except OSError:
            return False  # the next file will come soon
        return status.st_ino != number or status.st_size < offset

    def stop(self) -> None:
        self._stop.set()

"""A serial port that receives CSV lines of one axis, or binary blocks of any axes."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from threading import Event
from typing import TYPE_CHECKING, Literal, Self

from pydantic import Field, model_validator

from pmfid.config.axis import Axis
from pmfid.errors import UsageError
from pmfid.pipeline.monitored.lines import LineParser, is_comment
from pmfid.pipeline.tuning import TUNING as PIPELINE_TUNING
from pmfid.service.broker import Text, pauses
from pmfid.service.context import CHUNK, Context, FindAxis, ProblemReport, SourceSection, Take, Tell
from pmfid.service.tuning import TUNING
from pmfid.service.wire.messages import LineSplitter
from pmfid.stream.blocks import BlockStream
from pmfid.stream.delivery import Delivery, Item, Lines, Mark, Unusable

if TYPE_CHECKING:
    from serial import Serial


class SerialSection(SourceSection):
    """[sources.NAME] of kind "serial"."""

    kind: Literal["serial"] = Field(description='"serial"')
    port: Text = Field(description='the port, for example "/dev/ttyUSB0"')
    baud: int = Field(115_200, ge=50, le=20_000_000, description="the bits per second, for example 115200")
    format: Literal["csv", "block"] = Field("csv", description='the format of the data: lines of "csv", or "block"')
    axis: Text | None = Field(None, description="the axis of the lines of csv; a block contains the name of its axis")
    header: Text | None = Field(
        None, description='the names of the columns, for example "t,u,x"; by default one of the first lines names them'
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if (self.format == "csv") != (self.axis is not None):
            raise ValueError(
                'axis is required for format = "csv", and is not allowed for another format; add or remove axis'
            )
        if self.header is not None and self.format != "csv":
            raise ValueError('header is only for format = "csv"; remove header')
        return self

    def make(self, name: str, context: Context) -> SerialSource:
        return SerialSource(name, self, context.axis, context.tell)


class _Csv:
    """A converter from bytes to items of the axis `name`. Raises UsageError for a header with missing columns."""

    def __init__(self, name: str, axis: Axis, header: str | None) -> None:
        self._name, self._axis, self._tried = name, axis, 0
        self._parser = None if header is None else LineParser(header.encode(), axis)
        self.begin()

    def begin(self) -> None:
        """Begin after the port has been opened, maybe in the middle of a line."""
        self._splitter = LineSplitter(cut=self._parser is not None)  # else the first line may be the header

    def feed(self, data: bytes) -> Sequence[Item]:
        items: list[Item] = []
        lines = []
        for text in self._splitter.feed(data):
            if self._parser is None:
                items += self._header(text)
            elif text.strip() and (line := self._parser(text)) is not None:
                lines.append(line)
        return [*items, Lines(self._name, lines)] if lines else items

    def _header(self, text: bytes) -> list[Unusable]:
        """Use a line as the header if valid, and report the reason after `first_lines` other lines."""
        if is_comment(text):
            return []
        try:
            self._parser = LineParser(text, self._axis)
        except UsageError as error:
            self._tried += 1
            if self._tried % PIPELINE_TUNING.first_lines == 0:
                problem = (
                    f"none of the last {PIPELINE_TUNING.first_lines} lines contains the names of the columns: "
                    f"give them in header ({error})"
                )
                return [Unusable("header", problem, self._name)]
        return []


@dataclass
class SerialSource:
    """A `Source` of a serial port. `opened` is true while the port is open."""

    name: str
    section: SerialSection
    axis: FindAxis
    tell: Tell
    opened: bool = field(default=False, init=False)
    _stopped: Event = field(default_factory=Event, init=False)

    def __post_init__(self) -> None:
        self._report = ProblemReport(self.name, self.tell)

    def run(self, take: Take, mark: Mark | None) -> None:
        """Read until `stop`. Raises UsageError for a section that cannot work, and without pyserial."""
        try:
            import serial
        except ImportError:
            raise UsageError("a serial port needs pyserial: pip install 'pmfid[serve]'") from None
        reader, waiting = self._reader(), pauses()
        while not self._stopped.is_set():
            try:
                with serial.Serial(self.section.port, self.section.baud, timeout=TUNING.serial_silence) as port:
                    self._report.say("")
                    waiting = pauses()
                    reader.begin()
                    self.opened = True
                    self._read(port, reader, take)
            except OSError as error:  # includes serial.SerialException
                self.opened = False
                self._report.say(f"the port {self.section.port} cannot be read: {error}")
                self._stopped.wait(next(waiting))

    def stop(self) -> None:
        self._stopped.set()

    def _reader(self) -> BlockStream | _Csv:
        section = self.section
        if section.axis is None:
            return BlockStream()
        axis = self.axis(section.axis)
        if axis is None:
            raise UsageError(
                f"[sources.{self.name}] axis = {section.axis!r}: the plant has no such axis; correct the name"
            )
        return _Csv(section.axis, axis, section.header)

    def _read(self, port: Serial, reader: BlockStream | _Csv, take: Take) -> None:
        while not self._stopped.is_set():
            data = port.read(min(CHUNK, max(1, port.in_waiting)))
            items = reader.feed(data) if data else ()
            if items and not take(Delivery(self.name, items, None, None, time.monotonic())):
                self.stop()

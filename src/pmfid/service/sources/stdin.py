"""Standard input as a source: lines of CSV of one axis, or lines of JSON of any axes.

A program such as Telegraf starts the service, and ends it by closing the pipe.
"""

from __future__ import annotations

import os
import select
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from threading import Event
from typing import BinaryIO, Literal

from pydantic import Field

from pmfid.config.axis import Axis
from pmfid.config.model import Name
from pmfid.errors import UsageError
from pmfid.service.context import Context, Source, SourceSection, Take
from pmfid.service.wire.messages import LineSplitter, Messages
from pmfid.stream.delivery import Delivery, Item, Lines
from pmfid.stream.lines import Beginning, LineParser
from pmfid.stream.timeline import Line
from pmfid.stream.tuning import TUNING


class StdinSource(SourceSection):
    """The keys of [sources.NAME] with kind = "stdin"."""

    kind: Literal["stdin"] = Field(description='"stdin"')
    axis: Name | None = Field(
        None,
        description=(
            "the name of the axis for lines of CSV; without it, each line is a JSON object that names its axis"
        ),
    )

    def make(self, name: str, context: Context) -> Source:
        """Return the source. Raises UsageError for a terminal, and for an axis that is not in the plant."""
        if sys.stdin.isatty():
            raise UsageError(
                "standard input is a terminal; pipe lines into the command, for example "
                "cat run.csv | pmfid serve AXIS.toml"
            )
        if self.axis is None:
            messages = Messages(context.axis)
            return Piped(name, lambda lines: messages.items(b"\n".join(lines)), sys.stdin.buffer)
        return Piped(name, CsvLines(self.axis, context.require(self.axis)), sys.stdin.buffer)


@dataclass
class CsvLines:
    """Lines of CSV as items of one axis. The first lines are a header. Raises UsageError without a header."""

    axis: str
    config: Axis
    _parse: LineParser | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self._beginning = Beginning(self.config)

    def __call__(self, texts: Sequence[bytes]) -> Sequence[Item]:
        """Return the samples of the lines."""
        lines = list(self._lines(texts))
        return [Lines(self.axis, lines)] if lines else []

    def _lines(self, texts: Sequence[bytes]) -> Iterator[Line]:
        for text in texts:
            if self._parse is None:
                self._parse = self._beginning.take(text)
            elif text.strip() and (line := self._parse(text)) is not None:
                yield line


@dataclass
class Piped:
    """A source of the lines of a stream, until the stream ends. `read` returns the items of whole lines."""

    name: str
    read: Callable[[Sequence[bytes]], Sequence[Item]]
    stream: BinaryIO
    _stop: Event = field(default_factory=Event, init=False)

    def run(self, take: Take) -> None:
        """Hand over the lines as they arrive. Raises UsageError for a stream without a header."""
        splitter = LineSplitter()
        while not self._stop.is_set():
            chunk = self._take_bytes()
            if chunk is None:
                continue
            texts = splitter.feed(chunk or b"\n")  # the last line may have no line feed
            items = self.read(texts) if texts else ()
            if items and not take(Delivery(self.name, items, received=time.monotonic())):
                return
            if not chunk:
                return

    def _take_bytes(self) -> bytes | None:
        """Return the next bytes, b"" at the end, or None after a pause without bytes, so that `stop` takes effect."""
        try:
            number = self.stream.fileno()
        except OSError:  # a stream in this process has no number
            return self.stream.read(TUNING.longest_line)
        if not select.select([number], [], [], TUNING.engine_idle)[0]:
            return None
        return os.read(number, TUNING.longest_line)

    def stop(self) -> None:
        self._stop.set()

"""Line protocol on standard input for Telegraf's execd, as an output or as a processor that passes every line on.

Telegraf starts the service, and ends it by closing the pipe.
"""

from __future__ import annotations

import os
import select
import time
from dataclasses import dataclass, field
from threading import Event
from typing import Literal

from pydantic import Field

from pmfid.service.broker import Text
from pmfid.service.context import CHUNK, Context, FindAxis, SourceSection, Take, Tell
from pmfid.service.tuning import TUNING
from pmfid.service.wire.messages import LineSplitter, Messages, Precision, Readers
from pmfid.stream.delivery import Delivery, Mark


class ExecdSection(SourceSection):
    """[sources.NAME] of kind "execd"."""

    kind: Literal["execd"] = Field(description='"execd"')
    pass_on: bool = Field(
        False, description="true if Telegraf runs pmfid as a processor: every line is also written to standard output"
    )
    axis_tag: Text = Field(
        "axis",
        description=(
            "the tag that contains the name of the axis; without tag, the name of the measurement is the "
            "name of the axis"
        ),
    )
    precision: Precision = Field("ns", description='the unit of the time stamps; Telegraf uses "ns"')

    def make(self, name: str, context: Context) -> ExecdSource:
        return ExecdSource(name, self, context.axis, context.tell)


@dataclass
class ExecdSource:
    """A `Source` of line protocol. `stdin` and `stdout` are file descriptors."""

    name: str
    section: ExecdSection
    axis: FindAxis
    tell: Tell
    stdin: int = 0
    stdout: int = 1
    _stopped: Event = field(default_factory=Event, init=False)

    def run(self, take: Take, mark: Mark | None) -> None:
        """Read until the pipe is closed or `stop` is called."""
        form = Messages(Readers(self.axis), "line", self.section.axis_tag, self.section.precision)
        splitter, passing = LineSplitter(), self.section.pass_on
        while not self._stopped.is_set():
            if not select.select([self.stdin], [], [], TUNING.execd_look)[0]:
                continue
            data = os.read(self.stdin, CHUNK)
            lines = splitter.feed(data or b"\n")  # the last line may have no line feed
            text = b"".join(line + b"\n" for line in lines if line.strip())
            passing = passing and self._pass_on(text)
            items = form.items(text)
            if items and not take(Delivery(self.name, items, None, None, time.monotonic())):
                return
            if not data:
                return

    def stop(self) -> None:
        self._stopped.set()

    def _pass_on(self, text: bytes) -> bool:
        """Write lines to standard output. Returns False once the output has no reader."""
        try:
            while text:
                text = text[os.write(self.stdout, text) :]
        except OSError as error:
            problem = f"lines cannot be passed on ({error.strerror}); the estimates continue"
            self.tell({"event": "source", "source": self.name, "problem": problem})
            return False
        return True

"""The log of the service: a line for each notice, never for a sample."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import IO

from pmfid.service.sinks.plain import as_json, notice_object
from pmfid.stream.outcome import EstimateRows, Notice

__all__ = ["NoticeLog", "json_line"]


def json_line(notice: Notice) -> str:
    """A notice as one line of JSON."""
    return as_json(notice_object(notice))


@dataclass
class NoticeLog:
    """A sink that writes lines to a stream; line: of a notice, "" to leave the notice out."""

    stream: IO[str]
    line: Callable[[Notice], str] = json_line
    name: str = "log"

    def open(self) -> None:
        """The stream is open."""

    def put(self, outcomes: list[EstimateRows | Notice]) -> None:
        """Writes them at once."""
        lines = [self.line(one) for one in outcomes if isinstance(one, Notice)]
        text = "".join(f"{line}\n" for line in lines if line)
        if text:
            self.stream.write(text)
            self.stream.flush()

    def close(self) -> None:
        """The stream stays open."""

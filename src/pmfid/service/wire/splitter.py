"""Lines out of bytes as they come."""

from __future__ import annotations

from dataclasses import dataclass, field

from pmfid.pipeline.tuning import TUNING as PIPELINE_TUNING

__all__ = ["LineSplitter"]


@dataclass
class LineSplitter:
    """Whole lines of a stream; one of more than longest_line bytes is left out.

    cut: the stream may begin in the middle of a line, so the first one is left out, too.
    """

    cut: bool = False
    _rest: bytes = field(default=b"", init=False)

    def feed(self, data: bytes) -> list[bytes]:
        """The lines that end in `data`, without their ends."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        if lines and self.cut:
            self.cut = False
            del lines[0]
        if len(self._rest) > PIPELINE_TUNING.longest_line:
            self._rest, self.cut = b"", True
        return [line for line in lines if len(line) <= PIPELINE_TUNING.longest_line]

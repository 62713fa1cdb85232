"""Messages of any form: binary blocks, JSON or line protocol, identified by their first bytes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from pmfid.service.wire import json_lines, line_protocol
from pmfid.service.wire.line_protocol import Precision
from pmfid.service.wire.points import Readers
from pmfid.stream import blocks
from pmfid.stream.blocks import MAGIC
from pmfid.stream.delivery import Block, Item, Lines, Unusable, split_tables

__all__ = ["LARGEST", "Form", "Messages"]

#: Bytes of a message, if nothing else is configured.
LARGEST = 2**20

Form = Literal["auto", "block", "json", "line"]


@dataclass(frozen=True)
class Messages:
    """Takes messages apart. readers: what fields mean; form: of all messages, "auto": each says it; tag: that names the
    axis in line protocol; precision: of its timestamps; largest: bytes of a message."""

    readers: Readers
    form: Form = "auto"
    tag: str = "axis"
    precision: Precision = "ns"
    largest: int = LARGEST

    def items(self, data: bytes, axis: str = "") -> Sequence[Item]:
        """The items of a message. axis: the only one that it may contain, "": any. Never raises."""
        if len(data) > self.largest:
            return [Unusable("oversized", f"a message of {len(data)} bytes, more than {self.largest}", axis[:64])]
        try:
            return self._items(data, axis)
        except Exception as error:  # not acknowledged, the message would come again and again
            return [Unusable("error", f"{type(error).__name__}: {str(error)[:200]}; it is left out", axis[:64])]

    def _items(self, data: bytes, axis: str) -> Sequence[Item]:
        form = self._form(data) if self.form == "auto" else self.form
        if form == "block":
            found = blocks.items(data)
            return [_check_axis(item, axis) for item in split_tables(found)] if axis else found
        if form == "json":
            return self.readers.items(json_lines.decode(data, axis))
        return self.readers.items(line_protocol.decode(data, axis, self.tag, self.precision))

    def _form(self, data: bytes) -> Form:
        if data.startswith(MAGIC):
            return "block"
        return "json" if data.lstrip()[:1] in (b"{", b"[") else "line"


def _check_axis(item: Block | Lines | Unusable, axis: str) -> Block | Lines | Unusable:
    """Refuses a block of another axis than its topic's: a sender may have rights for one topic only."""
    if isinstance(item, Block) and item.axis != axis:
        return Unusable("name", f"a block of {item.axis!r} that came as one of {axis[:64]!r}", axis[:64])
    return item

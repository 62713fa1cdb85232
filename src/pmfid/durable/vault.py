"""Checkpoints on disk: two generations, each whole or not there, none believed unread.

A checkpoint is written beside the older of the two, synced, and takes its place by a rename, after which the folder is
synced: whenever the power fails, one whole generation is there.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, TypeVar

from pmfid.durable.crash import crash_point
from pmfid.durable.envelope import Chunk, DamagedError, Found, Told, put, read, set_aside, sync_folder
from pmfid.durable.lock import held

__all__ = ["Vault"]

Content = TypeVar("Content")


@dataclass
class Vault:
    """folder: where the checkpoints lie, made if it is not there. One owner at a time: raises UsageError where another
    one has it, and where it cannot be made."""

    folder: Path
    sequence: int = 0

    #: What errors say: which setting names the folder, and who else may have it.
    setting: ClassVar[str] = "folder"
    other: ClassVar[str] = "another process"

    def __post_init__(self) -> None:
        self._lock = held(self.folder, self.setting, self.other)

    def load(self, read: Callable[[bytes], Content], tell: Callable[[Told], None]) -> Content | None:
        """What `read` makes of the newest checkpoint that is whole; None where there is none. What is damaged, or what
        `read` refuses with ValueError, is renamed and told, and the older one is taken."""
        for one in self.whole(tell):
            try:
                return read(bytes(one.body))
            except ValueError as error:
                set_aside(one.path, str(error), tell)
        return None

    def whole(self, tell: Callable[[Told], None]) -> list[Found]:
        """The checkpoints that are whole, the newest first; what is damaged is renamed and told."""
        found = []
        for path in self._places():
            try:
                found.append(read(path))
            except FileNotFoundError:
                continue
            except (OSError, DamagedError) as error:
                set_aside(path, str(error), tell)
        self.sequence = max([self.sequence, *(one.sequence for one in found)])
        return sorted(found, key=lambda one: one.sequence, reverse=True)

    def _places(self) -> tuple[Path, Path]:
        return self.folder / "checkpoint-0", self.folder / "checkpoint-1"

    def write(self, chunks: Sequence[Chunk]) -> None:
        """A new checkpoint in place of the older one; it is durable when this returns. Raises OSError."""
        sequence = self.sequence + 1
        part = self.folder / "checkpoint.part"
        try:
            with open(part, "wb") as file:
                put(file, sequence, chunks, "checkpoint.half")
                crash_point("checkpoint.written")
                file.flush()
                os.fsync(file.fileno())
            crash_point("checkpoint.synced")
            os.replace(part, self._places()[sequence % 2])
        except OSError:
            with suppress(OSError):
                part.unlink(missing_ok=True)
            raise
        self.sequence = sequence
        crash_point("checkpoint.renamed")
        sync_folder(self.folder)
        crash_point("checkpoint.durable")

    def close(self) -> None:
        """Another one may have the folder."""
        self._lock.close()

"""Checkpoints on disk: two generations, each whole or absent. Every checkpoint is validated on load.

A checkpoint is written to a new file, synced, and replaces the older of the two by a rename. Then the folder is synced.
So one whole generation exists at any time, also after a power failure.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, ClassVar, TypeVar

from pmfid.durable.crash import crash_point
from pmfid.durable.envelope import Chunk, DamagedError, Event, WholeFile, put, read, set_aside, sync_folder
from pmfid.durable.lock import hold

__all__ = ["CheckpointFolder"]

Content = TypeVar("Content")


@dataclass
class CheckpointFolder:
    """A folder with two generations of checkpoints; it is made if absent, and has one owner at a time.

    Raises UsageError if another owner has the folder, and if it cannot be made.
    """

    folder: Path
    sequence: int = 0

    #: Words of errors: the setting that names the folder, and the possible other owner.
    setting: ClassVar[str] = "folder"
    other: ClassVar[str] = "another process"

    def __post_init__(self) -> None:
        self._lock: IO[bytes] = hold(self.folder, self.setting, self.other)

    def load(self, read: Callable[[bytes], Content], tell: Callable[[Event], None]) -> Content | None:
        """Result of `read` for the newest whole checkpoint; None if there is none. A checkpoint that is damaged, or
        that `read` refuses with ValueError, is renamed and reported, and the older one is taken."""
        for one in self.whole(tell):
            try:
                return read(bytes(one.body))
            except ValueError as error:
                set_aside(one.path, str(error), tell)
        return None

    def whole(self, tell: Callable[[Event], None]) -> list[WholeFile]:
        """The whole checkpoints, the newest first; damaged ones are renamed and reported."""
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

"""Checkpoints on disk: two generations, each whole or not there, none believed unread.

A checkpoint is written beside the older of the two, synced, and takes its place by a rename, after which the folder is
synced: whenever the power fails, one whole generation is there. Layout, little endian: magic, version, CRC-32 of all
that follows, sequence number, length of the body in bytes, body.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, TypeVar

from pmfid.errors import UsageError
from pmfid.service.crash import crash_point

__all__ = ["Found", "Vault"]

MAGIC, VERSION = b"PMFIDCKP", 1
_HEAD, _REST = struct.Struct("<8sII"), struct.Struct("<QQ")
#: No checkpoint is longer [bytes]: what a head says is not believed beyond that.
_LONGEST = 2**36

Told = dict[str, Any]
Content = TypeVar("Content")


class _DamagedError(Exception):
    """Why a file is no checkpoint."""


@dataclass(frozen=True)
class Found:
    """A file that holds a whole checkpoint: its sequence number and its body."""

    path: Path
    sequence: int
    body: bytes


@dataclass
class Vault:
    """folder: where the checkpoints lie, made if it is not there. One service at a time: raises UsageError where
    another one has it, and where it cannot be made."""

    folder: Path
    sequence: int = 0

    def __post_init__(self) -> None:
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._lock: IO[bytes] = open(self.folder / "lock", "ab")  # noqa: SIM115
        except OSError as error:
            raise UsageError(
                f"[service] state: {error.filename}: {error.strerror}; choose a folder that can be written"
            ) from None
        self._hold()

    def _hold(self) -> None:
        try:
            import fcntl
        except ImportError:  # a system without such locks
            return
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._lock.close()
            raise UsageError(
                f"[service] state: another service works in {self.folder}; end that, or choose another folder"
            ) from None

    def load(self, read: Callable[[bytes], Content], tell: Callable[[Told], None]) -> Content | None:
        """What `read` makes of the newest checkpoint that is whole; None where there is none. What is damaged, or what
        `read` refuses with ValueError, is renamed and told, and the older one is taken."""
        found = []
        for path in self._places():
            try:
                found.append(_read(path))
            except FileNotFoundError:
                continue
            except (OSError, _DamagedError) as error:
                _set_aside(path, str(error), tell)
        for one in sorted(found, key=lambda one: one.sequence, reverse=True):
            self.sequence = max(self.sequence, one.sequence)
            try:
                return read(one.body)
            except ValueError as error:
                _set_aside(one.path, str(error), tell)
        return None

    def _places(self) -> tuple[Path, Path]:
        return self.folder / "checkpoint-0", self.folder / "checkpoint-1"

    def write(self, chunks: Sequence[bytes | memoryview]) -> None:
        """A new checkpoint in place of the older one; it is durable when this returns. Raises OSError."""
        sequence = self.sequence + 1
        part = self.folder / "checkpoint.part"
        try:
            with open(part, "wb") as file:
                _put(file, sequence, chunks)
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
        _sync(self.folder)
        crash_point("checkpoint.durable")

    def close(self) -> None:
        """Another service may have the folder."""
        self._lock.close()


def _put(file: IO[bytes], sequence: int, chunks: Sequence[bytes | memoryview]) -> None:
    rest = _REST.pack(sequence, sum(map(len, chunks)))
    checksum = zlib.crc32(rest)
    for chunk in chunks:
        checksum = zlib.crc32(chunk, checksum)
    file.write(_HEAD.pack(MAGIC, VERSION, checksum) + rest)
    for k, chunk in enumerate(chunks):
        if k == len(chunks) // 2:
            file.write(chunk[: len(chunk) // 2])
            file.flush()
            crash_point("checkpoint.half")
            chunk = chunk[len(chunk) // 2 :]
        file.write(chunk)


def _read(path: Path) -> Found:
    """Raises OSError, and _DamagedError for what is no whole checkpoint."""
    with open(path, "rb") as file:
        head = file.read(_HEAD.size + _REST.size)
        if len(head) < _HEAD.size + _REST.size:
            raise _DamagedError("it is shorter than the head of a checkpoint")
        magic, version, checksum = _HEAD.unpack_from(head)
        sequence, length = _REST.unpack_from(head, _HEAD.size)
        if magic != MAGIC or version != VERSION:
            raise _DamagedError("it is no checkpoint of this version")
        if length != os.fstat(file.fileno()).st_size - len(head) or length > _LONGEST:
            raise _DamagedError("it is cut short, or something stands behind its end")
        body = file.read(length)
    if zlib.crc32(body, zlib.crc32(head[_HEAD.size :])) != checksum:
        raise _DamagedError("its checksum is wrong")
    return Found(path, sequence, body)


def _set_aside(path: Path, problem: str, tell: Callable[[Told], None]) -> None:
    """Renames what cannot be used, so that people can look at it and nothing overwrites it."""
    place = next(p for k in range(1, 10**6) if not (p := path.with_name(f"{path.name}.damaged-{k}")).exists())
    try:
        path.rename(place)
    except OSError as error:
        place = path
        problem = f"{problem}; it cannot be set aside: {error.strerror}"
    tell({"event": "checkpoint", "damaged": place.name, "problem": problem})


def _sync(folder: Path) -> None:
    """The name of a new file is durable once its folder is."""
    if os.name != "posix":
        return
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)

"""Files with a checksum that shows whether they are whole.

Layout, little endian: magic, version, CRC-32 of all that follows, sequence number, length of the body in bytes, body.
"""

from __future__ import annotations

import mmap
import os
import struct
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from pmfid.durable.crash import crash_point

__all__ = ["Chunk", "DamagedError", "Event", "WholeFile", "map_file", "put", "read", "set_aside", "sync_folder"]

MAGIC, VERSION = b"PMFIDCKP", 1
_HEAD, _REST = struct.Struct("<8sII"), struct.Struct("<QQ")
#: Bytes before the body; a multiple of 8, so that float64 in a mapped body is aligned.
_BEFORE = _HEAD.size + _REST.size
#: Longest body [bytes]; a header with a longer one is refused.
_LONGEST = 2**36

Event = dict[str, Any]
#: Bytes without gaps, of which no copy is made.
Chunk = bytes | memoryview


class DamagedError(Exception):
    """Why a file is not whole."""


@dataclass(frozen=True)
class WholeFile:
    """A file that is whole: its sequence number and its body."""

    path: Path
    sequence: int
    body: Chunk


def put(file: IO[bytes], sequence: int, chunks: Sequence[Chunk], half: str) -> None:
    """Writes chunks of bytes (n,) where the file stands; half: the point of `crash` in their middle. Raises OSError."""
    rest = _REST.pack(sequence, sum(map(len, chunks)))
    checksum = zlib.crc32(rest)
    for chunk in chunks:
        checksum = zlib.crc32(chunk, checksum)
    file.write(_HEAD.pack(MAGIC, VERSION, checksum) + rest)
    for k, chunk in enumerate(chunks):
        if k == len(chunks) // 2:
            file.write(chunk[: len(chunk) // 2])
            file.flush()
            crash_point(half)
            chunk = chunk[len(chunk) // 2 :]
        file.write(chunk)


def read(path: Path) -> WholeFile:
    """A file in memory. Raises OSError, and DamagedError for what is not whole."""
    with open(path, "rb") as file:
        head = file.read(_BEFORE)
        length = _length(head, os.fstat(file.fileno()).st_size)
        return _check_body(path, head, file.read(length))


def map_file(path: Path) -> WholeFile:
    """A file mapped into memory; changes of the body stay in this process. The file must not be cut while it is in
    use. Raises like `read`."""
    with open(path, "rb") as file:
        head, size = file.read(_BEFORE), os.fstat(file.fileno()).st_size
        _length(head, size)
        pages = mmap.mmap(file.fileno(), size, access=mmap.ACCESS_COPY)
    return _check_body(path, head, memoryview(pages)[_BEFORE:])


def _length(head: bytes, size: int) -> int:
    if len(head) < _BEFORE:
        raise DamagedError("it is shorter than the head of a checkpoint")
    magic, version, _ = _HEAD.unpack_from(head)
    length = int(_REST.unpack_from(head, _HEAD.size)[1])
    if magic != MAGIC or version != VERSION:
        raise DamagedError("it is no checkpoint of this version")
    if length != size - _BEFORE or length > _LONGEST:
        raise DamagedError("it is cut short, or something follows its end")
    return length


def _check_body(path: Path, head: bytes, body: Chunk) -> WholeFile:
    checksum = int(_HEAD.unpack_from(head)[2])
    if zlib.crc32(body, zlib.crc32(head[_HEAD.size :])) != checksum:
        raise DamagedError("its checksum is wrong")
    return WholeFile(path, int(_REST.unpack_from(head, _HEAD.size)[0]), body)


def set_aside(path: Path, problem: str, tell: Callable[[Event], None]) -> None:
    """Renames what cannot be used, so that people can look at it and nothing overwrites it."""
    place = next(p for k in range(1, 10**6) if not (p := path.with_name(f"{path.name}.damaged-{k}")).exists())
    try:
        path.rename(place)
    except OSError as error:
        place = path
        problem = f"{problem}; it cannot be set aside: {error.strerror}"
    tell({"event": "checkpoint", "damaged": place.name, "problem": problem})


def sync_folder(folder: Path) -> None:
    """The name of a new file is durable once its folder is."""
    if os.name != "posix":
        return
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)

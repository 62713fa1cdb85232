"""Files that are either whole or absent: checksums, locks, two generations, and crash points for tests."""

from __future__ import annotations

import mmap
import os
import signal
import struct
import zlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, ClassVar, TypeVar

from pmfid.errors import UsageError

__all__ = ["CRASH_AT", "arm", "crash_point"]

#: Name of the environment variable that sets a crash point. Its value is a point and a count, as
#: "checkpoint.renamed:3": the process ends at the third pass.
CRASH_AT = "PMFID_CRASH_AT"


_left: dict[str, int] = {}


def arm(setting: str) -> None:
    """Set the crash point that ends the process. `setting` is a value of the environment variable; "" sets none."""
    _left.clear()
    if setting:
        name, _, times = setting.partition(":")
        _left[name] = int(times or 1)


def crash_point(name: str) -> None:
    """Kill the process if this point is set and the number of passes is reached."""
    if _left and name in _left:
        _left[name] -= 1
        if _left[name] == 0:
            os.kill(os.getpid(), signal.SIGKILL)


arm(os.environ.get(CRASH_AT, ""))

MAGIC, VERSION = b"PMFIDCKP", 1
_HEAD, _REST = struct.Struct("<8sII"), struct.Struct("<QQ")
#: Number of bytes before the body. The number is a multiple of 8, so that float64 values in a mapped body are aligned.
_BEFORE = _HEAD.size + _REST.size
#: Longest body [bytes]. A header that states a longer body is refused.
_LONGEST = 2**36

Event = dict[str, Any]
#: Contiguous bytes that are written without a copy.
Chunk = bytes | memoryview


class DamagedError(Exception):
    """Error with the reason why a file is not whole."""


@dataclass(frozen=True)
class WholeFile:
    """Sequence number and body of a file that is whole."""

    path: Path
    sequence: int
    body: Chunk


def put(file: IO[bytes], sequence: int, chunks: Sequence[Chunk], half: str) -> None:
    """Write the header and `chunks` at the current position of the file.

    `half` names the crash point in the middle of the chunks. Raises OSError if the file cannot be written.
    """
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
    """Return the content of a file in memory. Raises OSError, or DamagedError if the file is not whole."""
    with open(path, "rb") as file:
        head = file.read(_BEFORE)
        length = _length(head, os.fstat(file.fileno()).st_size)
        return _check_body(path, head, file.read(length))


def map_file(path: Path) -> WholeFile:
    """Return the content of a file that is mapped into memory. Changes of the body stay in this process.

    Nobody may truncate the file while it is mapped. Raises OSError, or DamagedError if the file is not whole.
    """
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
    """Rename a damaged file, so that people can examine it and no new file overwrites it."""
    place = next(p for k in range(1, 10**6) if not (p := path.with_name(f"{path.name}.damaged-{k}")).exists())
    try:
        path.rename(place)
    except OSError as error:
        place = path
        problem = f"{problem}; it cannot be set aside: {error.strerror}"
    tell({"event": "checkpoint", "damaged": place.name, "problem": problem})


def sync_folder(folder: Path) -> None:
    """Flush a folder to disk. Only then does the name of a new file survive a power failure."""
    if os.name != "posix":
        return
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)


#: Name of the lock file in a folder.
NAME = "lock"


def lock(file: int) -> bool:
    """Lock a file for this process until the process closes the file or ends. Return False if another process has the
    lock.

    The result is always True on systems without such locks.
    """
    try:
        import fcntl
    except ImportError:
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def hold(folder: Path, setting: str, other: str) -> IO[bytes]:
    """Make a folder and lock it until the returned file is closed.

    `setting` names the setting of the folder, and `other` the possible other owner, for messages. Raises UsageError if
    another owner has the folder, or if the folder cannot be made, locked or written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        held: IO[bytes] = open(folder / NAME, "ab")  # noqa: SIM115
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"{setting}: {folder}: {reason}; choose a folder that can be written") from None
    try:
        free = lock(held.fileno())
    except OSError as error:
        held.close()
        raise UsageError(f"{setting}: {folder}: {error.strerror}; choose a folder that can be locked") from None
    if not free:
        held.close()
        raise UsageError(f"{setting}: {other} already uses {folder}; stop it, or choose another folder")
    return held


Content = TypeVar("Content")


@dataclass
class CheckpointFolder:
    """Folder with two generations of checkpoints and one owner at a time. The folder is made if it is absent.

    Raises UsageError if another owner has the folder, or if the folder cannot be made.
    """

    folder: Path
    sequence: int = 0

    #: Words for error messages: the setting that names the folder, and the possible other owner.
    setting: ClassVar[str] = "folder"
    other: ClassVar[str] = "another process"

    def __post_init__(self) -> None:
        self._lock: IO[bytes] = hold(self.folder, self.setting, self.other)

    def load(self, read: Callable[[bytes], Content], tell: Callable[[Event], None]) -> Content | None:
        """Return the result of `read` for the newest whole checkpoint, or None if no checkpoint is whole.

        A checkpoint that is damaged, or that `read` refuses with ValueError, is renamed and reported. The older
        checkpoint takes its place.
        """
        for one in self.whole(tell):
            try:
                return read(bytes(one.body))
            except ValueError as error:
                set_aside(one.path, str(error), tell)
        return None

    def whole(self, tell: Callable[[Event], None]) -> list[WholeFile]:
        """Return the whole checkpoints, the newest first. Damaged checkpoints are renamed and reported."""
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
        """Replace the older checkpoint by a new one, which is on disk when this method returns. Raises OSError if
        it fails.
        """
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
        """Unlock the folder for other owners."""
        self._lock.close()

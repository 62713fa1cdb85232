"""A file that grows line by line, replaces no other file, and survives a full disk."""

from __future__ import annotations

import os
from collections.abc import Callable
from itertools import count
from pathlib import Path

Tell = Callable[[dict[str, object]], None]

#: Largest number of bytes that wait for space on the disk. If this space is full, further lines are lost.
MOST_WAITING = 1 << 20


def fresh(path: Path, also: Callable[[Path], Path] = lambda path: path) -> Path:
    """Return the first unused path among path, path-2, path-3 and so on, with its suffix.

    The path `also(path)` must also be unused.
    """
    for number in count(1):
        candidate = path if number == 1 else path.with_name(f"{path.stem}-{number}{path.suffix}")
        if not os.path.lexists(candidate) and not os.path.lexists(also(candidate)):
            return candidate
    raise AssertionError  # pragma: no cover - there is always another number


def is_stream(path: Path) -> bool:
    """Return whether the path is a named pipe or a device, to which lines can be appended without loss."""
    return path.exists() and not path.is_file()


class RowFile:
    """A new file of lines, each written at once.

    `tell` gets a write error. Unwritten bytes wait, so that the file continues without a break after space becomes
    available. `lost` is the number of lines without space. Raises OSError if the file cannot be made.
    """

    def __init__(self, path: Path, tell: Tell) -> None:
        new = 0 if is_stream(path) else os.O_CREAT | os.O_EXCL
        flags = os.O_WRONLY | new | getattr(os, "O_BINARY", 0)
        self.path, self.lost, self._tell = path, 0, tell
        self._file = os.open(path, flags, 0o666)
        self._waiting, self._failing = bytearray(), False
        self._size, self._whole = 0, 0

    def put(self, line: str) -> None:
        """Write a line, given without its end."""
        data = line.encode() + b"\n"
        if len(self._waiting) + len(data) > MOST_WAITING:
            self.lost += 1
        else:
            self._waiting += data
        self._write()

    def _write(self) -> None:
        try:
            while self._waiting:
                self._drop_written(os.write(self._file, self._waiting))
        except BrokenPipeError:
            raise
        except OSError as error:
            if not self._failing:
                self._tell({"event": "write error", "file": str(self.path), "problem": error.strerror or str(error)})
            self._failing = True
            return
        if self._failing:
            self._tell({"event": "written again", "file": str(self.path), "lost": self.lost})
        self._failing = False

    def _drop_written(self, size: int) -> None:
        end = self._waiting.rfind(b"\n", 0, size)
        self._whole = self._size + end + 1 if end >= 0 else self._whole
        self._size += size
        del self._waiting[:size]

    def close(self) -> None:
        """Close the file. Waiting lines are lost, and no part of a line remains."""
        self._write()
        self.lost += self._waiting.count(b"\n")
        if self._waiting and self._size > self._whole and self.path.is_file():
            os.ftruncate(self._file, self._whole)
        self._waiting.clear()
        os.close(self._file)

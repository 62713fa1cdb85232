"""Files that are there whole, or not at all, also after the power fails."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

__all__ = ["replace_durably", "sync_folder", "write_all"]


def write_all(file: int, data: bytes | memoryview) -> None:
    """Writes to the last byte; what is written when an OSError comes stays."""
    left = memoryview(data)
    while left:
        left = left[os.write(file, left) :]


def replace_durably(path: Path, data: bytes) -> None:
    """Makes the file, or puts it in the place of the one that is there: under another name first, and under its own
    when it is on the disk. Raises OSError; then what was there before is still there."""
    part = path.with_name(f"{path.name}.part")
    try:
        file = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | getattr(os, "O_BINARY", 0), 0o666)
        try:
            write_all(file, data)
            os.fsync(file)
        finally:
            os.close(file)
        os.replace(part, path)
    except OSError:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Makes names in a folder last; systems that cannot are left to themselves."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)

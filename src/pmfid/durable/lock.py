"""Locks of files and folders: one process holds a lock until it releases the lock or ends, however it ends."""

from __future__ import annotations

from pathlib import Path
from typing import IO

from pmfid.errors import UsageError

__all__ = ["NAME", "hold", "lock"]

#: Name of the lock file in a folder.
NAME = "lock"


def lock(file: int) -> bool:
    """Locks a file for this process until the process closes the file or ends; False if another process has the lock.
    Always True on systems without such locks."""
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
    """Makes a folder and locks it until the returned file is closed. setting: name of the folder's setting; other: the
    possible other owner. Raises UsageError if another owner has it, and if it cannot be made, locked or written."""
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
        raise UsageError(f"{setting}: {other} works in {folder}; end that, or choose another folder")
    return held

"""A folder has one owner at a time, until that process ends, however it does."""

from __future__ import annotations

from pathlib import Path
from typing import IO

from pmfid.errors import UsageError

__all__ = ["held"]


def held(folder: Path, setting: str, other: str) -> IO[bytes]:
    """The lock of a folder, which is made if it is not there; free when it is closed. setting, other: what errors say
    of the folder, and of who else may have it. Raises UsageError where another one has it, or it cannot be made."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = open(folder / "lock", "ab")  # noqa: SIM115
    except OSError as error:
        problem = f"{error.filename}: {error.strerror}"
        raise UsageError(f"{setting}: {problem}; choose a folder that can be written") from None
    try:
        import fcntl
    except ImportError:  # a system without such locks
        return lock
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        lock.close()
        raise UsageError(f"{setting}: {other} works in {folder}; end that, or choose another folder") from None
    return lock

"""Files and folders that one process has alone, until it lets them go or ends, however it ends."""

from __future__ import annotations

from pathlib import Path
from typing import IO

from pmfid.errors import UsageError

__all__ = ["NAME", "hold", "lock"]

#: Of the file in a folder by which it is taken.
NAME = "lock"


def lock(file: int) -> bool:
    """Takes a file for this process until it closes it or ends; False where another one has it. Systems without such
    locks always say True."""
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
    """Makes a folder and takes it, until the file that is given is closed. setting: that names the folder; other: who
    else may have it. Raises UsageError where another one has it, and where it cannot be made, locked or written."""
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

"""Files that are replaced as a whole, folders with one owner at a time, and crash points for tests."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import IO

from pmfid.errors import UsageError

#: Name of the environment variable that sets a crash point. Its value is a point and a count, as
#: "checkpoint.written:3": the process ends at the third pass.
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


def replace_file(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` make a file, which then takes the place of the file at `path`.

    A link is replaced, not followed. A device is written to. After an error of `write`, the file is unchanged.
    """
    if path.exists() and not path.is_file():
        write(path)
        return
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        write(part)
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise

"""Named points at which a test kills the process like a power failure: nothing is flushed, nothing is closed."""

from __future__ import annotations

import os
import signal

__all__ = ["CRASH_AT", "arm", "crash_point"]

#: The variable that names a point and the time of passing it that ends the process, as "checkpoint.renamed:3".
CRASH_AT = "PMFID_CRASH_AT"


_left: dict[str, int] = {}


def arm(setting: str) -> None:
    """Ends the process at a point, as in the variable; "" for none."""
    _left.clear()
    if setting:
        name, _, times = setting.partition(":")
        _left[name] = int(times or 1)


def crash_point(name: str) -> None:
    """Kills the process if this point is armed and its number of passes is reached."""
    if _left and name in _left:
        _left[name] -= 1
        if _left[name] == 0:
            os.kill(os.getpid(), signal.SIGKILL)


arm(os.environ.get(CRASH_AT, ""))

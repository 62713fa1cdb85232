"""Named points at which a test kills the process as the power does: nothing is flushed, nothing is closed."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable

__all__ = ["CRASH_AT", "POINTS", "crash_point"]

#: The variable that names a point and the time of passing it that ends the process, as "checkpoint.renamed:3".
CRASH_AT = "PMFID_CRASH_AT"
#: All points, in the order in which a block passes them.
POINTS = (
    "inbox.taken",
    "engine.ordered",
    "engine.stepped",
    "engine.told",
    "checkpoint.made",
    "checkpoint.half",
    "checkpoint.written",
    "checkpoint.synced",
    "checkpoint.renamed",
    "checkpoint.durable",
    "ack",
    "acked",
)


def _nothing(name: str) -> None:
    """Where no point is named, passing one costs a call."""


def _armed(setting: str) -> Callable[[str], None]:
    wanted, _, times = setting.partition(":")
    left = [int(times or 1)]

    def pass_by(name: str) -> None:
        if name != wanted:
            return
        left[0] -= 1
        if left[0] == 0:
            os.kill(os.getpid(), signal.SIGKILL)

    return pass_by


crash_point: Callable[[str], None] = _armed(os.environ[CRASH_AT]) if os.environ.get(CRASH_AT) else _nothing

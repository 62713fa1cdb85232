"""Is there motion enough to tell anything by?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pmfid.findings import Finding
from pmfid.session.checks.log import CheckedLog
from pmfid.session.checks.readings import is_exchanged
from pmfid.session.checks.view import MASS

__all__ = ["no_inertia", "no_motion"]

#: Counts of travel from one end to the other, at the least.
FEWEST = 8
#: Standard deviations by which a mass must be told from none.
TOLD = 2.0


def no_motion(log: CheckedLog) -> Iterator[Finding]:
    """An axis at rest, or one that hardly leaves its count."""
    travel = int(np.ptp(log.record.counts))
    if travel == 0:
        sentence = f"the output column {log.axis.record.output!r} never changes"
        yield Finding("little_motion", sentence, "record a motion, and check that this is the encoder", "wrong")
        return
    if not np.any(log.record.u):
        sentence = f"the input column {log.axis.record.input!r} is zero throughout"
        yield Finding("little_motion", sentence, "log what drives the axis", "wrong")
        return
    if travel < FEWEST and not is_exchanged(log):
        yield Finding(
            "little_motion",
            f"the axis moves by {travel} counts in all: the encoder's steps hide the motion",
            "record a longer stroke, or use a finer encoder",
            "wrong",
        )


def no_inertia(log: CheckedLog) -> Iterator[Finding]:
    """An axis that never changes its speed as the input asks."""
    view = log.view if log.is_machine else None
    if view is not None and abs(view.sure(np.eye(view.theta.size)[MASS])) < TOLD:
        yield Finding(
            "little_motion",
            "the acceleration says nothing of the input: this record cannot tell a mass",
            "record a motion with reversals and varying speed",
        )

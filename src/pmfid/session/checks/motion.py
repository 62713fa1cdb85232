"""Whether the record has enough motion for an estimate."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pmfid.findings import Finding
from pmfid.session.checks.log import CheckedLog
from pmfid.session.checks.readings import is_exchanged
from pmfid.session.checks.view import MASS

__all__ = ["no_inertia", "no_motion"]

#: Least travel from one end to the other [counts].
FEWEST = 8
#: Least mass, in its standard deviations.
DISTINCT = 2.0


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
    """An axis whose acceleration does not follow the input."""
    view = log.view if log.is_machine else None
    if view is not None and abs(view.sure(np.eye(view.theta.size)[MASS])) < DISTINCT:
        yield Finding(
            "little_motion",
            "the acceleration does not follow the input: this record cannot determine a mass",
            "record a motion with reversals and varying speed",
        )

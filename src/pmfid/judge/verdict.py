"""What the status says of a transfer function on its records."""

from __future__ import annotations

import numpy as np

from pmfid.judge.assess import Assessment
from pmfid.transfer.process import Process

#: A pole with a standard deviation of more than this part of its size is not known. A real one has at most half of it:
#: bars are measured over two standard deviations, and it does not move beyond 0.
UNKNOWN = 0.4


def flags_on(checks: Assessment, process: Process, referenced: bool = False, held: bool = False) -> tuple[str, ...]:
    """Names for the status. feedback: the input has the noise in it, unless the method uses a reference; unmodelled:
    the residual has the input in it, is less with the other hold, or repeats with the input; unstable: a pole in the
    right half-plane that no controller is known to hold (held); uncertain: a pole is not known to half its size, not
    needed, or elsewhere with the colour of the noise in mind; model_spread: the other hold explains the record as well,
    and moves a parameter beyond a standard error that is none of these."""
    unknown = np.any(np.hypot(*process.poles_std.T) > UNKNOWN * np.abs(process.poles))
    uncertain = checks.second.surplus or checks.second.moved or bool(unknown)
    found = {
        "feedback": checks.feedback and not referenced,
        "unmodelled": checks.unmodelled or checks.hold.better or checks.repeats,
        "model_spread": checks.hold.hidden and not uncertain,
        "unstable": bool(np.any(process.poles.real > 0)) and not held,
        "uncertain": uncertain,
    }
    return tuple(name for name, holds in found.items() if holds)

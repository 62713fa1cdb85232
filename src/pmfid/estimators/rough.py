"""Error bars where the sum of squares is rough.

A body with friction sticks and breaks away: the simulated motion jumps where a parameter crosses the value at which
one more stroke happens. A difference quotient across such a jump says that the parameter is known to the width of the
quotient, though a ten times larger one may explain the record as well. Where the motion depends smoothly on the
parameters, quotients of every width give the same error bars; where they do not, the longest bar counts.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pmfid.estimators.scatter import raise_variances
from pmfid.types import Floats

#: Width of the difference quotients that are compared with the fine ones, as a part of a parameter.
COARSE = 1e-2
#: Variances that differ by more than this factor are not those of a smooth dependence.
SMOOTH = 4.0
#: Further widths where it is not smooth.
WIDTHS = (1e-3, 3e-2, 0.1, 0.3)


def widen_covariance(covariance: Floats, at: Callable[[float], Floats]) -> Floats:
    """A covariance (p, p) of fine difference quotients, raised where it is shorter than with wider ones because the
    dependence is rough; `at` gives that of a width. Raises what `at` raises."""
    variances, coarse = np.diagonal(covariance), np.diagonal(at(COARSE))
    if np.all((coarse < SMOOTH * variances) & (variances < SMOOTH * coarse)):
        return covariance
    return raise_variances(covariance, np.max([coarse, *(np.diagonal(at(width)) for width in WIDTHS)], axis=0))

"""A column that changes at every k-th row and no other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["period_of"]

#: Rows between two changes, at the most; changes, at the least; the part of them that must be in step; the part of the
#: rows in step at which there is a change, at the least.
MOST, LEAST, IN_STEP, OFTEN = 50, 30, 0.98, 0.3


def period_of(changes: NDArray[np.intp]) -> int:
    """The largest k so that the changes (m,), numbers of rows, are all a multiple of k apart; 1 where there is none.

    By chance m changes are in step with probability k^(1 - m), and one column of many that is in step is still one with
    few changes: those of steps that last long are left to the input's own steps.
    """
    if changes.size < LEAST:
        return 1
    rows = int(changes[-1] - changes[0]) + 1
    for k in range(MOST, 1, -1):
        step = np.bincount(changes % k, minlength=k).max()
        if step >= IN_STEP * changes.size and step >= OFTEN * rows / k:
            return k
    return 1

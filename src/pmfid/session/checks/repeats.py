"""A column that changes at every k-th row and no other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["period_of"]

#: Most rows between two changes; fewest changes; least part of the changes in step; least part of the rows in step with
#: a change.
MOST, LEAST, IN_STEP, OFTEN = 50, 30, 0.98, 0.3


def period_of(changes: NDArray[np.intp]) -> int:
    """The largest k such that the changes (m,), numbers of rows, are multiples of k apart; 1 if there is none.

    By chance m changes are in step with probability k^(1 - m). A column with few changes may be in step by chance or by
    design, so a column of long steps is left out.
    """
    if changes.size < LEAST:
        return 1
    rows = int(changes[-1] - changes[0]) + 1
    for k in range(MOST, 1, -1):
        step = np.bincount(changes % k, minlength=k).max()
        if step >= IN_STEP * changes.size and step >= OFTEN * rows / k:
            return k
    return 1

"""Stretches of long records."""

from __future__ import annotations

import numpy as np

from pmfid.types import Counts, Floats


def liveliest(position: Counts | Floats, most: int) -> slice:
    """Return the `most` consecutive samples with the most motion, or all samples of a shorter record.

    `position` (n,) is the position at the samples in any unit.
    """
    if position.size <= most:
        return slice(0, position.size)
    travelled = np.r_[0, np.cumsum(np.abs(np.diff(position)))]
    start = int(np.argmax(travelled[most - 1 :] - travelled[: position.size - most + 1]))
    return slice(start, start + most)

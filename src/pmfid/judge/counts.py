"""What counts alone say of a record: how coarse they are, and whether one change of them is no motion."""

from __future__ import annotations

import numpy as np

from pmfid.types import Counts

#: A change of the counts that exceeds the usual ones by this factor is no motion.
JUMP = 30


def counts_per_sample(counts: Counts) -> float:
    """Mean over the samples that lie between the first and the last change of the counts; 0 without motion."""
    change = np.abs(np.diff(counts))
    moving = np.flatnonzero(change)
    if moving.size == 0:
        return 0.0
    return float(change[moving[0] : moving[-1] + 1].mean())


def count_jump(counts: Counts) -> str:
    """What to say of one change of the counts (n,) far beyond all others: a wrap that nobody has undone, or a lost
    position; empty where there is none."""
    change = np.abs(np.diff(counts))
    worst = int(np.argmax(change))
    usual = float(np.quantile(_motion(counts, change), 0.99))
    if not change[worst] > JUMP * (usual + 1):
        return ""
    return (
        f"the counts jump by {change[worst]} at row {worst + 2}, usually by {usual:.3g} at most: a counter that "
        "wraps needs [encoder] bits; for lost counts give max_speed"
    )


def _motion(counts: Counts, change: Counts) -> Counts:
    """Sizes (n - 1,) of the changes (n - 1,) of the counts (n,), without wrong readings, which come back at once: a few
    of a hundred would else be what is usual."""
    if change.size < 2:
        return change
    across = np.abs(counts[2:] - counts[:-2])
    return np.asarray(np.r_[np.minimum(np.minimum(change[:-1], change[1:]), across), change[-1:]])

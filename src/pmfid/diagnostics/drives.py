"""Facts about the record of a drive that no model explains."""

from __future__ import annotations

import numpy as np

from pmfid.diagnostics.tuning import TUNING
from pmfid.estimators.base import Estimator
from pmfid.types import Counts

#: Remedy for a jump of the counts.
JUMP_REMEDY = "give [encoder] bits if the counter wraps, or max_speed if counts were lost"
NOISE_SEEN = "the result of least squares may be the encoder's noise, because no other method confirms it"
NOISE_REMEDY = "move the axis more, or use a finer encoder"


def counts_per_sample(counts: Counts) -> float:
    """Return the mean change per sample between the first and the last change of the counts, or 0 without motion."""
    change = np.abs(np.diff(counts))
    moving = np.flatnonzero(change)
    if moving.size == 0:
        return 0.0
    return float(change[moving[0] : moving[-1] + 1].mean())


def count_jump(counts: Counts) -> str:
    """Describe one change of the counts (n,) that is far larger than all others, or return an empty text.

    The cause is a counter that wraps or a lost position.
    """
    change = np.abs(np.diff(counts))
    worst = int(np.argmax(change))
    usual = float(np.quantile(_motion(counts, change), 0.99))
    if not change[worst] > TUNING.drives_jump * (usual + 1):
        return ""
    return f"the counts jump by {change[worst]} at row {worst + 2}, elsewhere by at most {usual:.3g}"


def _motion(counts: Counts, change: Counts) -> Counts:
    """Return the sizes (n - 1,) of the changes of the counts (n,) without wrong readings.

    A wrong reading returns at once to the old position. A few wrong readings among a hundred samples would distort the
    usual change.
    """
    if change.size < 2:
        return change
    across = np.abs(counts[2:] - counts[:-2])
    return np.asarray(np.r_[np.minimum(np.minimum(change[:-1], change[1:]), across), change[-1:]])


def recent(estimator: Estimator, samples: int) -> slice:
    """Return the samples that determine an estimate: the last three memories of a record."""
    return slice(
        -round(min(samples, TUNING.drives_memories / max(1e-9, 1 - getattr(estimator, "forgetting", 1.0)))), None
    )

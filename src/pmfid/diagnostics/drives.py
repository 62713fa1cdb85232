"""Facts about the record of a drive that no model explains."""

from __future__ import annotations

import numpy as np

from pmfid.estimators.base import Estimator
from pmfid.types import Counts

#: Length of the judged part at the end of the record, in memories of an estimator with forgetting.
DRIVES_MEMORIES = 3.0

NOISE_SEEN = "the result of least squares may be the encoder's noise, because no other method confirms it"
NOISE_REMEDY = "move the axis more, or use a finer encoder"


def counts_per_sample(counts: Counts) -> float:
    """Return the mean change per sample between the first and the last change of the counts, or 0 without motion."""
    change = np.abs(np.diff(counts))
    moving = np.flatnonzero(change)
    if moving.size == 0:
        return 0.0
    return float(change[moving[0] : moving[-1] + 1].mean())


def recent(estimator: Estimator, samples: int) -> slice:
    """Return the samples that determine an estimate: the last three memories of a record."""
    return slice(-round(min(samples, DRIVES_MEMORIES / max(1e-9, 1 - getattr(estimator, "forgetting", 1.0)))), None)

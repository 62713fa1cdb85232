"""What an encoder does to the scores of a motion, wherever its lattice lies.

The error of a count is no random number: the same motion on the same lattice makes the same error again, in every
stroke. How far a sum of scores may be off for that alone is seen by shifting the lattice under the simulated motion.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmfid.estimators.interval import NOISE_FLOOR, cost
from pmfid.estimators.output_error import Difference
from pmfid.estimators.scatter import TINY, block_scatter, raised

Floats = NDArray[np.float64]

#: Places of the lattice that are tried.
PHASES = 32
#: Noise of the position beyond the floor by this factor is noise: then one stroke is not like the next.
CLEAN = 1.5


def phase_scatter(difference: Difference, q: Floats, sensitivity: Floats, noise: float | None) -> Floats:
    """Variances (p,) of sum sensitivity (n, p) * score over the places of the lattice, for counts of the motion
    simulated at q.

    noise: of the position [counts], of an interval likelihood; None: the score is the position's error itself. Zero
    where the position has noise of its own, which breaks every pattern.
    """
    if noise is not None and noise > CLEAN * NOISE_FLOOR:
        return np.zeros(sensitivity.shape[1])
    place = difference.motion(q)[0] / difference.resolution
    sums = []
    for k in range(PHASES):
        shifted = place + k / PHASES
        error = np.floor(shifted) + 0.5 - shifted
        slope = error if noise is None else cost(error, noise)[1]
        sums.append(sensitivity.T @ slope)
    return np.asarray(np.mean(np.square(sums), axis=0))


def score_covariance(
    difference: Difference, q: Floats, own: Floats, noise: float, information: Floats, scores: Floats
) -> Floats:
    """Covariance (p, p) of the sum of an interval likelihood's scores (n, p) for sensitivities `own` (n, p).

    The information (p, p) where the position has noise, and what the encoder does along the motion where it has none;
    or what the scores scatter over blocks, where that is more.
    """
    scattered = block_scatter(scores)
    if noise > CLEAN * NOISE_FLOOR:
        return raised(information, scattered)
    alone = np.maximum(phase_scatter(difference, q, own, noise), scattered)
    size = np.sqrt(alone / np.maximum(np.diagonal(information), TINY))
    return np.asarray(information * np.outer(size, size))

"""The posterior of parameters whose counts bound the motion: hit and run (Smith 1984).

Where a model explains every count, the errors are those of rounding alone. Each count then allows the motion an
interval, and the posterior is uniform on the parameters that all intervals allow. Its mean and covariance are exact for
rounding that is neither white nor independent of the motion.
"""

from __future__ import annotations

import math
import sys
from statistics import NormalDist

import numpy as np

from pmfid._body import walk
from pmfid.fit.solve import root_of
from pmfid.types import Floats

#: Steps of the last of four runs for up to five parameters; more parameters have more steps. The error of a standard
#: deviation is then about 3 %.
STEPS = 2000
#: Longest step in standard deviations, which only bounds directions without any count.
FAR = 30.0
#: Quantiles of the standard normal distribution.
QUANTILE = NormalDist().inv_cdf


#: Precisions (p,) of a Gaussian prior, and the distance (p,) from its mean.
Prior = tuple[Floats, Floats]


def allowed_region(
    e: Floats,
    J: Floats,
    bound: Floats,
    root: Floats,
    rng: np.random.Generator,
    prior: Prior,
    most: int = STEPS,
) -> tuple[Floats, Floats]:
    """Return mean (p,) and covariance (p, p) of the steps d with |e + J d| <= bound.

    e, bound: (n,); J: (n, p). The walk has the coordinates z of d = root z, for the root (p, p) of a covariance. The
    distance of the `prior` is that of no step. `most` is the number of steps.
    """
    precision, distance = prior
    J, scale, p = J @ root, np.sqrt(precision), J.shape[1]
    rows = scale[:, None] * root, scale * distance
    z, shape = np.zeros(p), np.eye(p)
    for run in range(4):
        steps = most * max(5, p) // 5 >> 3 - run
        reach = np.sqrt(np.sum((J @ shape) ** 2, axis=1))
        bound = np.maximum(bound, np.abs(e + J @ z) + 1e-9)
        near = bound - np.abs(e + J @ z) < 8.0 * reach
        ways = shape @ rng.standard_normal((p, steps))
        path = _walk(z, (e + J @ z)[near], J[near], bound[near], ways, rng, rows)
        if np.any(np.abs(e + path[:: 1 + steps // 8] @ J.T) > bound):  # a row far away bounds the walk, too
            path = _walk(z, e + J @ z, J, bound, ways, rng, rows)
        z, kept = path[-1], path[steps // 5 :]
        covariance = np.atleast_2d(np.cov(kept.T)) + 1e-3 * shape @ shape.T * (run < 3)
        mean, shape = np.mean(kept, axis=0), root_of(covariance)
    return root @ mean, root @ covariance @ root.T


def _walk(
    d: Floats, e: Floats, J: Floats, bound: Floats, ways: Floats, rng: np.random.Generator, prior: Prior
) -> Floats:
    """Return the path (steps, p) from d along the directions `ways` (p, steps). The `prior` has rows (k, p) and values
    (k,) at no step, whose sums have a normal distribution."""
    rows, values = prior
    along, bends = np.ascontiguousarray((J @ ways).T), np.ascontiguousarray((rows @ ways).T)
    chances = rng.random((ways.shape[1],)).tolist()
    lengths = walk(e.copy(), bound, along, values + rows @ d, bends, chances, FAR, _draw)
    return np.asarray(d + np.cumsum(lengths[:, None] * ways.T, axis=0))


def _draw(low: float, high: float, slope: float, curvature: float, chance: float) -> float:
    """Return the place of a step between `low` and `high` with a share `chance` of the probability below it. Minus the
    log density has a slope and a curvature at 0."""
    size = math.sqrt(curvature)
    if (size * (high - low)) ** 2 < sys.float_info.epsilon:  # flat up to rounding
        return low + chance * (high - low)
    middle = -slope / curvature
    if middle < (low + high) / 2:  # the lower tail keeps its digits
        return -_draw(-high, -low, -slope, curvature, 1 - chance)
    first, last = size * (low - middle), size * (high - middle)
    share = 0.5 * ((1 - chance) * math.erfc(-first / math.sqrt(2)) + chance * math.erfc(-last / math.sqrt(2)))
    if sys.float_info.min < share < 1.0:
        place = QUANTILE(share)
    else:
        from scipy.special import log_ndtr, ndtri_exp

        logs = float(log_ndtr(first)) + math.log1p(-chance), float(log_ndtr(last)) + math.log(max(chance, 1e-300))
        place = float(ndtri_exp(np.logaddexp(*logs)))
    return min(max(middle + place / size, low), high)

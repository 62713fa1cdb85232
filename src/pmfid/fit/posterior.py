"""The posterior of parameters whose counts bound the motion: hit and run (Smith 1984).

Where a model explains every count, the errors are those of rounding alone. Each count then allows the motion an
interval, and the posterior is uniform on the parameters that all intervals allow. Its mean and covariance are exact for
rounding that is neither white nor independent of the motion.
"""

from __future__ import annotations

import numpy as np

from pmfid.fit.solve import root_of
from pmfid.types import Floats

#: Steps of the last of four runs for up to five parameters; more parameters have more steps. The error of a standard
#: deviation is then about 3 %.
STEPS = 2000
#: Longest step in standard deviations, which only bounds directions without any count.
FAR = 30.0


def allowed_region(
    e: Floats, J: Floats, bound: Floats, covariance: Floats, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Return mean (p,) and covariance (p, p) of the steps d with |e + J d| <= bound, from a `covariance` of their size.

    e, bound: (n,); J: (n, p). The covariance only shapes the directions of the walk.
    """
    d, p = np.zeros(J.shape[1]), J.shape[1]
    mean = np.zeros(p)
    for run in range(4):
        steps = STEPS * max(5, p) // 5 >> 3 - run
        root = root_of(covariance)
        reach = np.sqrt(np.sum((J @ root) ** 2, axis=1))
        bound = np.maximum(bound, np.abs(e + J @ d) + 1e-9)
        near = bound - np.abs(e + J @ d) < 8.0 * reach
        path = _walk(d, (e + J @ d)[near], J[near], bound[near], root @ rng.standard_normal((p, steps)), rng)
        d, kept = path[-1], path[steps // 5 :]
        mean, covariance = np.mean(kept, axis=0), np.atleast_2d(np.cov(kept.T)) + 1e-3 * covariance * (run < 3)
    return mean, covariance


def _walk(d: Floats, e: Floats, J: Floats, bound: Floats, ways: Floats, rng: np.random.Generator) -> Floats:
    """Return the path (steps, p) from d along the directions `ways` (p, steps)."""
    along, path = np.ascontiguousarray((J @ ways).T), np.empty((ways.shape[1], d.size))
    chance = rng.random((ways.shape[1],))
    for k in range(path.shape[0]):
        slope: Floats = along[k]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            reach = bound / np.abs(slope)
            middle = -e / slope
        low = float(np.fmax.reduce(middle - reach, initial=-FAR))
        high = float(np.fmin.reduce(middle + reach, initial=FAR))
        if high > low:
            step = low + chance[k] * (high - low)
            e, d = e + step * slope, d + step * ways[:, k]
        path[k] = d
    return path

"""Does a parameter step or drift, or does it wander, as friction does with the temperature? A step or a line has to
explain more than the random walk that the same series would be without it.

The series is taken as a local level: a random walk seen through white noise (Harvey, Forecasting, Structural Time
Series Models and the Kalman Filter, 1989, section 4.1), once alone, once with a step and once with a line, each with
the walk and the noise that make it most likely.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pmfid.fleet.series import Series
from pmfid.types import Floats

#: Noise of the segments, in standard errors; steps of the walk from one segment to the next, in root mean square
#: differences of neighbours.
NOISE = np.geomspace(1, 100, 9)
WALK = np.r_[0.0, np.geomspace(1e-3, 2, 16)]
#: Greatest number of segments: more are averaged in groups.
MOST = 128


@dataclass(frozen=True)
class Beyond:
    """By how much a step and a line explain a series better than its wandering, as Student's t; size: (p,) relative,
    root mean square about the mean."""

    step: float
    line: float
    size: Floats


def compare_with_wander(series: Series, since: float) -> Beyond:
    """Evidence of step and trend beyond wandering, from a series (n, p) of at least three usable segments; since: start
    of the first segment after the step [s]."""
    place = int(np.searchsorted(series.start, since))
    theta, std, time = _together(series, place)
    n = len(theta)
    mean = np.average(theta, axis=0, weights=std**-2.0)
    size = np.sqrt(np.mean((theta - mean) ** 2, axis=0)) / np.maximum(np.abs(mean), np.finfo(float).tiny)
    unit = np.maximum(np.sqrt(np.mean(np.diff(theta, axis=0) ** 2, axis=0)), np.finfo(float).tiny)
    shapes = np.stack([time >= since, (time - time[0]) / (time[-1] - time[0])], axis=1).astype(np.float64)
    alone, *with_shape = _likelihoods((theta - mean) / unit, std / unit, shapes)
    gains = [np.max(one - alone) for one in with_shape]
    free = max(n - 2, 1)
    step, line = (float(np.sqrt(free * np.expm1(min(2 * gain / n, 100.0)))) for gain in gains)
    return Beyond(step, line, size)


def _together(series: Series, place: int) -> tuple[Floats, Floats, Floats]:
    """Means of neighbours (m, p) with their standard errors and middle times (m,), never across a place."""
    n = series.start.size
    many = -(-n // MOST)
    starts = np.r_[np.arange(place % many, place, many), np.arange(place, n, many)].astype(int)
    starts = np.unique(np.r_[0, starts])
    weight = series.std**-2.0
    total = np.add.reduceat(weight, starts, axis=0)
    theta = np.add.reduceat(weight * series.theta, starts, axis=0) / total
    time = np.add.reduceat((series.start + series.end) / 2, starts) / np.diff(np.r_[starts, n])
    return theta, total**-0.5, time


def _likelihoods(theta: Floats, std: Floats, shapes: Floats) -> tuple[Floats, ...]:
    """(p,) largest logarithm of the likelihood of theta (n, p) with errors std (n, p), of the walk alone and with a
    multiple of each shape (n, k); by a Kalman filter for all noises and walks at once."""
    n, p = theta.shape
    seen = np.concatenate([theta[:, None, :], np.broadcast_to(shapes[:, :, None], (n, shapes.shape[1], p))], axis=1)
    noise, walk = (NOISE[:, None, None] * std[:, None, None, :]) ** 2, (WALK**2)[None, :, None]
    level = np.broadcast_to(seen[0][:, None, None, :], (seen.shape[1], NOISE.size, WALK.size, p))
    variance = np.broadcast_to(noise[0], (NOISE.size, WALK.size, p))
    logs = np.zeros(variance.shape)
    products = np.zeros((seen.shape[1], *variance.shape))  # of the innovations with those of theta
    squares = np.zeros((seen.shape[1], *variance.shape))
    for now, error in zip(seen[1:], noise[1:], strict=True):
        variance = variance + walk
        total = variance + error
        innovation = now[:, None, None, :] - level
        logs += np.log(total)
        products += innovation * innovation[0] / total
        squares += innovation**2 / total
        gain = variance / total
        level, variance = level + gain * innovation, variance * (1 - gain)
    taken = products[1:] ** 2 / np.maximum(squares[1:], np.finfo(float).tiny)
    whole = [squares[0], *(squares[0] - one for one in taken)]
    return tuple(np.max(-(logs + one) / 2, axis=(0, 1)) for one in whole)

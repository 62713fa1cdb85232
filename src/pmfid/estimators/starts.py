"""Where a simulated motion starts: the position and velocity with which it follows the first samples best."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pmfid.estimators.difference import WHITE, Difference, first_speed, rms
from pmfid.types import Floats

#: Time constants of the filters over which the start of a free run is read.
READ = 5.0
#: Speeds to begin with are read over so many time constants.
WITHIN = (1.0, READ)
#: Passes of Gauss and Newton's method; a stop that comes and goes may keep it from settling.
PASSES = 8
SETTLED = 1e-12
#: A step too far is tried once more as this part of itself.
SHORTER = 0.25


def start_samples(dt: float, cutoff: float) -> int:
    """How many samples the start of a free run is read from; dt [s], cutoff [rad/s]."""
    return max(2, math.ceil(READ / (cutoff * dt)))


def begun(difference: Difference, theta: Floats, cutoff: float, speeds: Sequence[float] = ()) -> Floats:
    """q (q,) at scaled parameters (p,), with a start to improve: that whose motion is the nearest, of the speeds that
    the counts show within 1 / cutoff [s] and within several times that, and of further ones.

    From a speed within stiction, where the axis was moving, there is no way to a better one.
    """
    shown = [first_speed(difference.y, difference.dt, cutoff / part, difference.resolution) for part in WITHIN]
    places = [np.array([difference.y[0], speed]) / difference.scale[-2:] for speed in dict.fromkeys((*shown, *speeds))]
    starts: list[Floats] = [np.concatenate([theta, place]) for place in places]
    return min(starts, key=lambda q: rms(difference(q)))


def started(difference: Difference, q: Floats) -> Floats:
    """q (q,) with the start of least squares, its parameters as they are.

    From rest within stiction a velocity moves nothing: it is taken for that of q to a few counts in a filter time
    constant, as in every error bar.
    """
    prior = np.array([0.0, 1 / difference.start_velocity_std])
    speed, left = q[-1], _left(difference, q, q[-1])
    for _ in range(PASSES):
        slope = np.r_[WHITE * difference.jacobian(q, first=q.size - 2), prior[None]]
        if not (np.all(np.isfinite(slope)) and np.all(np.isfinite(left))):
            break  # parameters that nothing can be simulated with
        step = np.r_[np.zeros(q.size - 2), np.linalg.lstsq(slope, -left)[0]]
        before = float(left @ left)
        for part in (1.0, SHORTER):
            trial = q + part * step
            found = _left(difference, trial, speed)
            if float(found @ found) < before:
                q, left = trial, found
                break
        if not float(left @ left) < (1 - SETTLED) * before:
            break
    return q


def _left(difference: Difference, q: Floats, speed: float) -> Floats:
    """(n + 1,) what is left of the position and of the start velocity `speed`, in their standard deviations."""
    return np.append(WHITE * difference(q), (q[-1] - speed) / difference.start_velocity_std)

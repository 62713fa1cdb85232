"""The deviation of the counts from a simulated motion, smoothed between events.

Between events a deviation of the velocity decays with the machine's own damping. At an event (a gap in which the input
may have changed, or a reversal) the velocity steps by an amount of known variance. The smoother (Rauch, Tung and
Striebel 1965) is solved as the least squares problem of all deviations and steps: a banded system with two unknowns for
each event.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded

from pmfid.types import Flags, Floats

#: Variance of a count [counts^2].
COUNT = 1 / 12
#: Information on position and velocity before the record [1/counts^2, s^2/counts^2]: practically none.
NOTHING = 1e-12
#: Right-hand sides that are solved at once.
CHUNK = 256


@dataclass(frozen=True)
class Steps:
    """start: deviation of the velocity at the first sample [counts/s]; size, variance: (g,) of the velocity's steps at
    the events, 0 at the first; deviation: (n,) [counts]."""

    start: float
    size: Floats
    variance: Floats
    deviation: Floats


def smooth_deviation(
    deviation: Floats, there: Flags, events: NDArray[np.intp], steps: Floats, moves: Floats, decay: float, dt: float
) -> Steps:
    """The smoothed deviation (n,) [counts] and its steps, from the samples that are there. events: (g,) samples, the
    first is 0; steps, moves: (g,) variances of the changes of velocity and position at the events; decay [1/s]."""
    n, g = deviation.size, events.size
    segment = np.repeat(np.arange(g), np.diff(np.r_[events, n]))
    response = _travel(np.asarray((np.arange(n) - events[segment]) * dt, np.float64), decay)
    weight = there / COUNT
    one, first, second, right, right_first = (
        np.add.reduceat(weight * part, events)
        for part in (np.ones(n), response, response**2, deviation, response * deviation)
    )
    lasting = np.diff(events) * dt
    along, kept, free, still = _travel(lasting, decay), np.exp(-decay * lasting), 1 / steps[1:], 1 / moves[1:]
    band = np.zeros((4, 2 * g))  # of the lower triangle; position and velocity in turn
    band[0, 0::2] = one + np.r_[still, NOTHING] + np.r_[NOTHING, still]
    band[0, 1::2] = second + np.r_[still * along**2 + free * kept**2, NOTHING] + np.r_[NOTHING, free]
    band[1, 0::2] = first + np.r_[still * along, 0.0]
    band[1, 1:-1:2] = -still * along
    band[2, 0:-2:2], band[2, 1:-2:2] = -still, -free * kept
    factor = cholesky_banded(band, lower=True)
    found = cho_solve_banded((factor, True), np.column_stack([right, right_first]).ravel())
    position, velocity = found[0::2], found[1::2]
    size = np.r_[0.0, velocity[1:] - kept * velocity[:-1]]
    variance = np.r_[0.0, _variances(factor, kept)]
    return Steps(float(velocity[0]), size, variance, position[segment] + response * velocity[segment])


def _travel(time: Floats, decay: float) -> Floats:
    """The change of the position within a time by a unit deviation of the velocity at its start."""
    return np.asarray(-np.expm1(-decay * time) / decay if decay > 0 else time)


def _variances(factor: Floats, kept: Floats) -> Floats:
    """(g - 1,) posterior variances of the steps velocity - kept * velocity before."""
    variances = np.empty(kept.size)
    for first in range(0, kept.size, CHUNK):
        own = np.arange(first, min(first + CHUNK, kept.size))
        sides = np.zeros((factor.shape[1], own.size))
        columns = np.arange(own.size)
        sides[2 * own + 3, columns], sides[2 * own + 1, columns] = 1.0, -kept[own]
        variances[own] = np.sum(sides * cho_solve_banded((factor, True), sides), axis=0)
    return variances

"""What an encoder does to an estimate with instruments, wherever its lattice lies under this very motion.

The same motion on the same lattice makes the same error again, in every stroke: such an error does not average out,
and the blocks of a record do not show it. How far it moves the estimate is seen by reading the simulated motion on a
lattice that is shifted under it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import NotIdentifiableError
from pmfid.estimators.arguments import hold_last_input
from pmfid.estimators.base import Estimator
from pmfid.estimators.difference import first_speed
from pmfid.estimators.motion import mean_velocity
from pmfid.estimators.results import Columns
from pmfid.types import Floats

#: Places of the lattice that are tried: their mean square is exact for the harmonics that hold nine tenths of it.
PLACES = 8
#: A simulated motion that goes further runs away [counts].
MOST_COUNTS = 2.0**53


def lattice_scatter(
    estimator: Estimator,
    theta: Floats,
    u: Floats,
    counts: NDArray[np.int64],
    columns_of: Callable[[NDArray[np.int64]], Columns],
    gain: Floats,
) -> Floats:
    """Variances (p,) of the parameters over the places of the lattice, for counts of the motion simulated at theta (p,)
    under u (n,). columns_of: the estimator's columns for counts (n,); gain (p, p): by how much a sum moves theta."""
    place, sums = _simulate_position(estimator, theta, u, counts), []
    for k in range(PLACES):
        read = columns_of(np.floor(place + k / PLACES).astype(np.int64))
        sums.append(read.zeta.T @ (read.z - read.phi @ theta))
    return np.asarray(np.mean(np.square(np.array(sums) @ gain.T), axis=0))


def _simulate_position(estimator: Estimator, theta: Floats, u: Floats, counts: NDArray[np.int64]) -> Floats:
    """The simulated position (n,) [counts], with the start velocity of the counts."""
    start = first_speed(counts, estimator.dt, estimator.cutoff, 1.0)
    step = estimator.encoder.resolution
    velocity = mean_velocity(estimator.equation, theta, estimator.dt, hold_last_input(u), start * step)
    place = np.asarray(np.r_[0.0, np.cumsum(velocity[:-1])] * estimator.dt / step)
    if not np.max(np.abs(place)) < MOST_COUNTS:
        values = ", ".join(f"{name} {value:.3g}" for name, value in zip(estimator.names, theta.tolist(), strict=False))
        raise NotIdentifiableError(
            f"the motion simulated with the estimate ({values}) runs away: check the model and the signs of input and "
            "output, or record a livelier motion"
        )
    return place

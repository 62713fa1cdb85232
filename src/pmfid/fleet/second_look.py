"""Do unmodelled effects move the estimate of a segment? A second look at some segments.

The mean square of the residual says little: friction that grows with the square of the speed is nearly a combination of
viscous and Coulomb friction, and moves both. The second look therefore tests candidate forces, after instrumental
variables (compare `estimators/candidate_forces.py`). The shift of a parameter is compared with its standard error. A
force has the size that the segment asks for, or a plausible size if the segment cannot determine it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import NotIdentifiableError
from pmfid.estimators.adequacy import MISSED, filter_forces
from pmfid.estimators.candidate_forces import CURVED
from pmfid.estimators.configuration import like
from pmfid.estimators.difference import rms
from pmfid.estimators.instruments import LASTING
from pmfid.estimators.iv import IV, RIV
from pmfid.estimators.least_squares import solve_with_instruments
from pmfid.estimators.scatter import block_scatter
from pmfid.fleet.series import LOOKED_AT, MOVED, UNUSABLE
from pmfid.fleet.stretch import Stretch
from pmfid.judge.matter import NOISE_LIMIT
from pmfid.judge.spread import believed_square
from pmfid.models.equation import VISCOUS_BACKWARD, VISCOUS_FORWARD, Equation
from pmfid.models.shapes import Square
from pmfid.status import Status
from pmfid.types import Counts, Floats

if TYPE_CHECKING:
    from pmfid.estimators.recursive import RecursiveEstimator

#: Part of its size that a parameter may be moved by: forces that are not there seem to move it by up to 2 % where a
#: controller feeds the encoder's error back.
TOLERANCE = 0.02
#: Counts that a velocity is taken over, at least, at the usual speed.
COUNTS = 4.0
#: Estimates with one of these are not looked at again.
SEEN = UNUSABLE | int(Status.UNMODELLED | Status.FALLBACK | Status.DEAD_TIME)
#: Greatest number of samples for a second look: they show what matters, and the look takes longer than the estimate.
MOST = 2**15


def second_looks(
    stretches: Sequence[Stretch],
    estimator: RecursiveEstimator,
    theta: Floats,
    std: Floats,
    status: NDArray[np.uint32],
) -> NDArray[np.uint32]:
    """The status (m,) of stretches with estimates theta and standard deviations std (m, p), and what a second look at
    some says, at those that seem to be good."""
    if not isinstance(estimator, RIV):
        return status
    found, method = status.copy(), like(IV, estimator, prefilter_zeros=None)
    for k, stretch in enumerate(stretches):
        if stretch.looked_at and not status[k] & SEEN and np.all(np.isfinite(std[k])):
            found[k] |= LOOKED_AT | (MOVED if is_moved(stretch, method, theta[k], std[k]) else 0)
    return found


def is_moved(stretch: Stretch, method: IV, theta: Floats, std: Floats) -> bool:
    """May unmodelled effects move a parameter of theta (p,) by more than its standard deviation std (p,) and the
    tolerance allow?"""
    allowed = np.maximum(NOISE_LIMIT * std, TOLERANCE * np.abs(theta))
    with np.errstate(all="ignore"):  # of a motion beyond numbers nothing is known
        try:
            moves = _moves(stretch, method, theta)
        except NotIdentifiableError:
            return False
    return bool(np.any(moves > allowed[:, None]))


def _moves(stretch: Stretch, method: IV, theta: Floats) -> Floats:
    """(p, k) by how much each of k forces may move the parameters."""
    u, counts = stretch.u[:MOST], stretch.counts[:MOST]
    columns = method.columns_at(theta, u, counts)
    speed = velocity(counts) * (stretch.resolution / stretch.dt)
    forces, plausible = _forces(method.equation, theta, speed, u)
    filtered = filter_forces(forces, method)[:, columns.used].T
    found, inverse = solve_with_instruments(columns)
    moves = -inverse @ (columns.zeta.T @ filtered)
    score = filtered - columns.zeta @ np.linalg.lstsq(columns.zeta.T @ columns.zeta, columns.zeta.T @ filtered)[0]
    scores = score * (columns.z - columns.phi @ found)[:, None]
    information = np.sum(score * (filtered + columns.phi @ moves), axis=0)
    variance = block_scatter(scores, LASTING * method.settle_samples) * stretch.repeats
    size, size_std = scores.sum(axis=0) / information, np.sqrt(variance) / np.abs(information)
    asked = np.abs(size) > MISSED * size_std
    sizes = np.where(asked, np.abs(size), np.sqrt(believed_square(size, size_std, plausible)))
    return np.asarray(np.abs(moves) * sizes)


def _forces(equation: Equation, theta: Floats, speed: Floats, u: Floats) -> tuple[Floats, Floats]:
    """(k, n) forces per unit of their coefficients, and the coefficients (k,) that machines well may have: an input
    that does not act in proportion, and where the model has none, friction that is not linear."""
    bent, usual = -equation.input_gain * u * np.abs(u) / rms(u), rms(speed[speed != 0])
    if any(isinstance(term.shape, Square) for term in equation.shaped):
        return bent[None], np.zeros(1)
    values = equation.role_values(theta)
    viscous = (values[VISCOUS_FORWARD] + values[VISCOUS_BACKWARD]) / 2
    return np.stack([bent, speed * np.abs(speed) / usual**2]), np.array([0.0, CURVED * viscous * usual])


def velocity(counts: Counts) -> Floats:
    """(n,) counts per sample, each the mean over as many samples as a few counts take at the usual speed."""
    change = np.diff(counts, append=counts[-1]).astype(np.float64)
    width = 2 * math.ceil(COUNTS / max(rms(change), 1e-3) / 2) - 1
    if width < 3:
        return change
    total = np.cumsum(np.r_[np.zeros(width // 2 + 1), change, np.zeros(width // 2)])
    return np.asarray((total[width:] - total[:-width]) / width)

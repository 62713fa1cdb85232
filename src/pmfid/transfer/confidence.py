"""Covariance of an estimate from instruments that know nothing of the noise, for noise of any colour.

theta solves sum zeta error = 0, so theta - truth = (zeta^T phi)^-1 zeta^T v with the noise v. As zeta is given, the
covariance of zeta^T v is zeta^T R zeta with the noise's covariance matrix R: from an autoregressive model of the
residual (`noise.py`), which needs no window and, unlike products of the scores, has nothing of the scores' own chance.
Of an input that repeats, what the residual does again in every period adds up over the periods (`periods.py`).
"""

from __future__ import annotations

import numpy as np

from pmfid.transfer.noise import Noise, fit_noise
from pmfid.transfer.periods import phases_of, repeats, split
from pmfid.transfer.solve import ProcessPoint, ProcessProblem
from pmfid.types import Floats, Places

#: Steps between the stretches on the line of all samples: more than what a noise usually remembers.
APART = 100
#: Degrees of freedom, at least: the effective number of samples bounds how well the power of the noise is known, and
#: Student's t has a larger variance than a normal deviate.
LEAST_FREE = 4.0


def places(problem: ProcessProblem) -> Places:
    """(N,) where each measured sample of all stretches lies on a line of even steps."""
    found, start = [], 0
    for stretch in problem.stretches:
        found.append(start + stretch.rows)
        start += stretch.grid.size + APART
    return np.concatenate(found).astype(np.int64)


def residual_noise(problem: ProcessProblem, point: ProcessPoint) -> Noise:
    """The colour of what a point of the iteration leaves."""
    size = np.linalg.norm(point.zeta, axis=0)
    Q = np.linalg.qr(point.zeta / np.where(size > 0, size, 1.0))[0]
    return fit_noise(point.error, places(problem), Q)


def score_covariance(zeta: Floats, error: Floats, place: Places | None = None) -> Floats:
    """(p, p) of sum zeta v; zeta (N, p) of about one size, error (N,) with what the fit along zeta left of v, at places
    (N,); None: one after the other."""
    place = np.arange(error.size) if place is None else place
    Q, R = np.linalg.qr(zeta)
    noise = fit_noise(error, place, Q)
    free = max(noise.effective(error.size) - zeta.shape[1], LEAST_FREE)
    return np.asarray(free / (free - 2) * (R.T @ noise.covariance(Q, place) @ R))


def covariance(point: ProcessPoint, problem: ProcessProblem) -> Floats:
    """(p, p) of theta at a point where the iteration has settled, in the problem's units."""
    size = np.linalg.norm(point.zeta, axis=0)
    zeta = point.zeta / size
    inverse = np.linalg.inv(zeta.T @ (point.phi / size))
    spread = _spread(zeta, point.error, problem)
    return np.asarray(inverse @ spread @ inverse.T / np.outer(size, size))


def residual_repeats(problem: ProcessProblem, point: ProcessPoint) -> bool:
    """Is some of what a point leaves the same in every period of the input, by more than chance?"""
    unknowns = point.zeta.shape[1]
    phases = phases_of(problem.stretches, unknowns)
    return phases is not None and repeats(point.error, point.zeta, problem.stretches, phases, places(problem))


def _spread(zeta: Floats, error: Floats, problem: ProcessProblem) -> Floats:
    """(p, p) of the scores, of what repeats apart from what does not, where it does."""
    place, unknowns = places(problem), zeta.shape[1]
    phases = phases_of(problem.stretches, unknowns)
    if phases is None or not repeats(error, zeta, problem.stretches, phases, place):
        return score_covariance(zeta, error, place)
    again, rest = split(error, phases)
    return score_covariance(zeta, rest, place) + score_covariance(phases.sum(zeta), again)

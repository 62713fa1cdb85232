"""What an encoder does to the scores of a motion, wherever its lattice lies.

The error of a count is no random number: the same motion on the same lattice makes the same error again, in every
stroke. How far a sum of scores may be off for that alone is seen by shifting the lattice under the simulated motion.
"""

from __future__ import annotations

import numpy as np

from pmfid.estimators.difference import Difference
from pmfid.estimators.likelihood import GIVEN_AWAY, NOISE_FLOOR, Best, cost
from pmfid.estimators.scatter import TINY, block_scatter
from pmfid.types import Floats

#: Places of the lattice that are tried.
PHASES = 32
#: Places of the lattice at which the top of the likelihood is looked for, steps to it, and what one gains at the top.
TOPS, MOST_STEPS, SETTLED = 16, 30, 1e-3
#: Standard deviations of the noise from an edge on beyond which it does not matter.
REACH = 8.0


def phase_scatter(difference: Difference, q: Floats, sensitivity: Floats, noise: float | None) -> Floats:
    """Variances (p,) of sum sensitivity (n, p) * score over the places of the lattice, for counts of the motion
    simulated at q.

    noise: of the position [counts], of an interval likelihood; None: the score is the position's error itself. Zero
    where the position has noise of its own, which breaks every pattern.
    """
    if noise is not None and noise > GIVEN_AWAY * NOISE_FLOOR:
        return np.zeros(sensitivity.shape[1])
    place = difference.motion(q)[0] / difference.resolution
    sums = []
    for k in range(PHASES):
        shifted = place + k / PHASES
        error = np.floor(shifted) + 0.5 - shifted
        slope = error if noise is None else cost(error, noise)[1]
        sums.append(sensitivity.T @ slope)
    return np.asarray(np.mean(np.square(sums), axis=0))


def likelihood_covariance(best: Best, weighted: Floats, scores: Floats) -> Floats:
    """Covariance (p, p) of the parameters of largest likelihood; weighted (n, p): sensitivities times the roots of the
    samples' information, scores (n, p): of the likelihood.

    That of the information where the position has noise. Where it has none the likelihood is all but a box, in which
    the score at the true parameters says little on where its top lies: an axis that is parked near the edge of a count
    has a large score, and is known all the better. So there the tops themselves are looked for, over the places of the
    lattice. Or what the scores scatter over blocks, where that is more.
    """
    inverse = np.linalg.inv(weighted.T @ weighted)
    alone = np.diagonal(inverse)
    if best.clean:
        alone = np.mean(_tops(best)[:, : alone.size] ** 2, axis=0)
    alone = np.maximum(alone, block_scatter(scores @ inverse))
    size = np.sqrt(alone / np.diagonal(inverse))
    return np.asarray(inverse * np.outer(size, size))


def _tops(best: Best) -> Floats:
    """(places, q): by how much the place of the largest likelihood differs from q, for counts of the motion simulated
    at q on lattices that are shifted under it."""
    difference, noise = best.difference, best.noise or NOISE_FLOOR
    place, jacobian = difference.motion(best.q)[0] / difference.resolution, difference.jacobian(best.q)
    errors = [np.floor(place + k / TOPS) + 0.5 - (place + k / TOPS) for k in range(TOPS)]
    return np.array([_top(error, jacobian, noise) for error in errors])


def _top(error: Floats, jacobian: Floats, noise: float) -> Floats:
    """Step (q,) to the largest likelihood of differences error (n,) + jacobian (n, q) @ step [counts]."""
    step, damping = np.zeros(jacobian.shape[1]), 1e-3
    now, slope, hessian = _compute_edge_cost(error, jacobian, noise)
    for _ in range(MOST_STEPS):
        damped = hessian + damping * np.diag(np.maximum(np.diagonal(hessian), TINY))
        trial = step - np.linalg.lstsq(damped, slope)[0]
        found = _compute_edge_cost(error + jacobian @ trial, jacobian, noise)
        if found[0] < now:
            gain, step, damping = now - found[0], trial, damping / 10
            now, slope, hessian = found
            if gain < SETTLED:
                break
        else:
            damping *= 10
    return step


def _compute_edge_cost(error: Floats, jacobian: Floats, noise: float) -> tuple[float, Floats, Floats]:
    """Negative log-likelihood, gradient (q,) and curvature (q, q): of the counts whose edges are near enough to matter,
    for all others it is zero in floating point."""
    near = np.abs(error) > 0.5 - REACH * noise
    rows = jacobian[near]
    now, slope, curvature = cost(error[near], noise)
    return now, rows.T @ slope, rows.T @ (curvature[:, None] * rows)

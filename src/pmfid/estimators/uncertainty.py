"""Error bars from the scatter of scores and from the unknown place of the encoder's lattice."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pmfid.estimators.likelihood import Best, cost, top
from pmfid.estimators.motion import Difference
from pmfid.estimators.tuning import TUNING
from pmfid.types import Floats

if TYPE_CHECKING:
    from scipy.sparse import csr_array


def block_scatter(scores: Floats, shortest: int = 1) -> Floats:
    """Return variances (p,) of the sum of scores (n, p) by the scatter of block sums.

    The blocks are tapered segments that overlap by half (Welch 1967). The result is the largest variance over block
    lengths of `shortest` and its doublings that leave at least 24 blocks. `shortest` is the number of samples over
    which scores cancel each other, as the differences of a coarse count do.
    """
    n = scores.shape[0]
    length = max(1, min(shortest, n // TUNING.uncertainty_fewest))
    largest = np.zeros(scores.shape[1])
    while length == 1 or n // length >= TUNING.uncertainty_fewest:
        largest = np.maximum(largest, np.mean(_blocks(scores, length) ** 2, axis=0) * (n**2 / (n - length)))
        length *= 2
    return largest


def scatter(scores: Floats, shortest: int = 1) -> Floats:
    """Return the covariance (p, p) of the sum of scores (n, p). The variances are those of `block_scatter`, and the
    correlations are those of the middle block length."""
    n = scores.shape[0]
    length = max(1, min(shortest, n // TUNING.uncertainty_fewest), round(np.sqrt(n / TUNING.uncertainty_fewest)))
    sums = _blocks(scores, length)
    covariance = sums.T @ sums * (n / sums.shape[0])
    diagonal = np.maximum(np.diagonal(covariance), TUNING.tiny)
    factor = np.sqrt(block_scatter(scores, shortest) / diagonal)
    return np.asarray(covariance * np.outer(factor, factor))


def _blocks(scores: Floats, length: int) -> Floats:
    """Return the sums (count, p) of centred scores over blocks of `length` samples. Neighbouring blocks overlap by
    half. The weights are zero at the ends of a block, and their squares add up to 1."""
    weight = np.sin(np.pi * (np.arange(length) + 0.5) / length) ** 2
    weight /= np.linalg.norm(weight)
    around = scores - scores.mean(axis=0)
    windows = np.lib.stride_tricks.sliding_window_view(around, length, axis=0)[:: max(1, length // 2)]
    return np.asarray(windows @ weight)


def raise_variances(covariance: Floats, variances: Floats) -> Floats:
    """Return a covariance (p, p) with variances of at least `variances` (p,) and unchanged correlations."""
    diagonal = np.maximum(np.diagonal(covariance), TUNING.tiny)
    factor = np.sqrt(np.maximum(variances / diagonal, 1.0))
    return np.asarray(covariance * np.outer(factor, factor))


def widen_covariance(covariance: Floats, at: Callable[[float], Floats]) -> Floats:
    """Raise the variances of fine difference quotients (p, p) to those of wider quotients if these are larger.

    A body with friction sticks and breaks away. The simulated motion jumps at parameter values at which one more stroke
    happens. A fine quotient across such a jump makes the parameter seem known to the quotient's width. A ten times
    larger change may explain the record as well. A smooth dependence gives the same variances at every width, and a
    rough dependence gets the largest variances. `at` returns the covariance at a width. Raises the errors of `at`.
    """
    variances, coarse = np.diagonal(covariance), np.diagonal(at(TUNING.uncertainty_coarse))
    if np.all((coarse < TUNING.uncertainty_smooth * variances) & (variances < TUNING.uncertainty_smooth * coarse)):
        return covariance
    return raise_variances(
        covariance, np.max([coarse, *(np.diagonal(at(width)) for width in TUNING.uncertainty_widths)], axis=0)
    )


def phase_scatter(
    difference: Difference, q: Floats, sensitivity: Floats, noise: float | None, slopes: csr_array | None = None
) -> Floats:
    """Return the variances (p,) of sum sensitivity (n, p) * score over the places of the lattice.

    The counts are those of the motion simulated at q. `noise` is the position's noise [counts] in an interval
    likelihood; None takes the position's error itself as score. A noise above the floor gives zero, because noise
    breaks every pattern of the counts. `slopes` is the result of `sparse_phase_slopes`; None computes the scores here.
    """
    if noise is not None and noise > TUNING.given_away * TUNING.noise_floor:
        return np.zeros(sensitivity.shape[1])
    if slopes is not None:
        return np.asarray(np.mean(np.square(slopes @ sensitivity), axis=0))
    errors = _phase_errors(difference, q)
    sums = [sensitivity.T @ (error if noise is None else cost(error, noise)[1]) for error in errors]
    return np.asarray(np.mean(np.square(sums), axis=0))


def sparse_phase_slopes(difference: Difference, q: Floats, noise: float) -> csr_array:
    """Return the scores (places, n) of `phase_scatter` at the counts whose edges are near, for several calls.

    For all other counts the scores are zero in floating point.
    """
    from scipy.sparse import csr_array  # slow to import, and only long records need it

    values, places, ends = list[Floats](), list[NDArray[np.int32]](), [0]
    for error in _phase_errors(difference, q):
        near = np.flatnonzero(np.abs(error) > 0.5 - TUNING.likelihood_reach * noise)
        values.append(cost(error[near], noise)[1])
        places.append(near.astype(np.int32))
        ends.append(ends[-1] + near.size)
    return csr_array((np.concatenate(values), np.concatenate(places), ends), shape=(len(values), difference.rows))


def _phase_errors(difference: Difference, q: Floats) -> Iterator[Floats]:
    """Yield the encoder's error (n,) of the motion simulated at q for each place of the lattice."""
    place = difference.motion(q)[0] / difference.resolution
    for k in range(TUNING.uncertainty_phases):
        shifted = place + k / TUNING.uncertainty_phases
        yield np.floor(shifted) + 0.5 - shifted


def likelihood_covariance(best: Best, weighted: Floats, scores: Floats) -> Floats:
    """Return the covariance (p, p) of the parameters of largest likelihood.

    `weighted` (n, p) are the sensitivities times the square roots of the samples' information, and `scores` (n, p) are
    those of the likelihood. For a noisy position, the covariance is the inverse information.

    Without noise the likelihood is almost a box, and the score at the true parameters says little about its top. An
    axis parked near the edge of a count, for example, has a large score and is known all the better. Without noise the
    variances come from the tops themselves, over the places of the lattice. A larger scatter of the scores over blocks
    always prevails.
    """
    inverse = np.linalg.inv(weighted.T @ weighted)
    alone = np.diagonal(inverse)
    if best.clean:
        alone = np.mean(_tops(best)[:, : alone.size] ** 2, axis=0)
    alone = np.maximum(alone, block_scatter(scores @ inverse))
    size = np.sqrt(alone / np.diagonal(inverse))
    return np.asarray(inverse * np.outer(size, size))


def _tops(best: Best) -> Floats:
    """Return the shifts (places, q) of the largest likelihood against q. The counts are those of the motion simulated
    at q on shifted lattices."""
    difference, noise = best.difference, best.noise or TUNING.noise_floor
    place, jacobian = difference.motion(best.q)[0] / difference.resolution, difference.jacobian(best.q)
    errors = [
        np.floor(place + k / TUNING.uncertainty_tops) + 0.5 - (place + k / TUNING.uncertainty_tops)
        for k in range(TUNING.uncertainty_tops)
    ]
    return np.array([top(error, jacobian, noise) for error in errors])

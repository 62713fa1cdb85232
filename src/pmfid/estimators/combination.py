"""An estimate combined with prior information on its parameters: one map for every method.

An equation sum theta_i w_i = gain u is homogeneous: with another gain the same motion has all forces theta in
proportion. So an estimate a with any gain determines all ratios, and a known force gives the gain. The prior
information, h = m with covariance S, or without error for given values, is a measurement in addition to the estimate:
h_k is b a_k for a force, a_k for any other parameter and b for the gain itself. b is the gain over the gain of the
estimate; nothing else is known of b. The estimate's covariance C weighs the estimate: generalised least squares, as a
Kalman filter's update. One step is exact for a linear h; an unknown gain takes Gauss-Newton steps. Errors da of the
estimate and dm of the prior information move the result by T da + U dm, so its covariance is T C T^T + U S U^T.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmfid.types import Floats

#: Steps. One step is enough for one given force; only facts that contradict each other take more.
MOST_STEPS, CONVERGED = 30, 1e-13
#: A fact that the others leave this part of its variance is tested by nothing.
UNTESTED = 1e-9


@dataclass(frozen=True)
class Facts:
    """k facts on p parameters and the gain: index (k,) of the parameter, p: of the gain; value, std (k,); forces (p,):
    which parameters go with the gain; free: is the gain to be found?"""

    index: NDArray[np.intp]
    value: Floats
    std: Floats
    forces: NDArray[np.bool_]
    free: bool


@dataclass(frozen=True)
class Combined:
    """theta (n, p + 1), the last one the gain over the estimate's gain; noise (n, p + 1, p + 1): its covariance;
    moves (n, p + 1, p): by how much it moves for an error of the estimate; apart (n, k): by how many standard
    deviations each fact differs from what all others say."""

    theta: Floats
    noise: Floats
    moves: Floats
    apart: Floats


def combine(estimate: Floats, covariance: Floats, further: Floats, facts: Facts) -> Combined:
    """Combine estimates (n, p) with covariances (n, p, p) and the same facts. further (n, p): variances in addition to
    noise, which count in the weights and stay out of the returned covariance. NaN if an estimate does not determine the
    gain.
    """
    total = covariance + further[..., None] * np.eye(estimate.shape[1])
    with np.errstate(all="ignore"):  # what comes of a parameter that is zero, or of nothing known, is NaN
        a, b = estimate, _start(estimate, total, facts)
        for _ in range(MOST_STEPS):
            step = _linear(a, b, total, facts)
            rest = facts.value - step.h + _times(step.by_a, a - estimate)
            change = np.sum(step.gain_b * rest, axis=1)
            a, b, before = estimate + _times(step.gain_a, rest), b + change, b
            if not np.any(np.abs(b - before) > CONVERGED * np.abs(b)):
                break
        return _make_combined(estimate, covariance, a, b, _linear(a, b, total, facts), facts)


@dataclass(frozen=True)
class _Linear:
    """h (n, k) and its derivatives by_a (n, k, p), by_b (n, k) at a place; gain_a (n, p, k), gain_b (n, k): by how much
    a rest of the facts moves a and b; left (n, k): variances of the rests, without what b takes up; total (n, k): with
    it."""

    h: Floats
    by_a: Floats
    gain_a: Floats
    gain_b: Floats
    left: Floats
    total: Floats


def _linear(a: Floats, b: Floats, total: Floats, facts: Facts) -> _Linear:
    n, p = a.shape
    k = facts.index.size
    of_gain, index = facts.index == p, np.minimum(facts.index, p - 1)
    force = facts.forces[index] & ~of_gain
    h = np.where(of_gain, b[:, None], np.where(force, b[:, None] * a[:, index], a[:, index]))
    by_a = np.zeros((n, k, p))
    by_a[:, np.arange(k), index] = np.where(of_gain, 0.0, np.where(force, b[:, None], 1.0))
    by_b = np.where(of_gain, 1.0, np.where(force, a[:, index], 0.0)) * facts.free
    spread = np.einsum("nki,nij,nlj->nkl", by_a, total, by_a) + np.diag(facts.std**2)
    size = np.sqrt(np.einsum("nkk->nk", spread))
    inverse = np.linalg.inv(spread / (size[:, :, None] * size[:, None, :])) / (size[:, :, None] * size[:, None, :])
    weighted = np.einsum("nkl,nl->nk", inverse, by_b)
    known = np.sum(by_b * weighted, axis=1)[:, None]
    gain_b = weighted / known if facts.free else np.zeros((n, k))
    reach = np.einsum("nij,nkj,nkl->nil", total, by_a, inverse)
    gain_a = reach - np.einsum("nil,nl,nk->nik", reach, by_b, gain_b)
    taken = by_b**2 / known if facts.free else np.zeros((n, k))
    return _Linear(h, by_a, gain_a, gain_b, size**2 - taken, size**2)


def _times(matrix: Floats, vector: Floats) -> Floats:
    return np.asarray(np.einsum("...ij,...j->...i", matrix, vector))


def _start(estimate: Floats, total: Floats, facts: Facts) -> Floats:
    """The gain (n,) that the fact which knows it best gives alone."""
    n, p = estimate.shape
    if not facts.free:
        return np.ones(n)
    of_gain, index = facts.index == p, np.minimum(facts.index, p - 1)
    own, variance = estimate[:, index], np.einsum("nii->ni", total)[:, index]
    gains = np.where(of_gain, facts.value, facts.value / own)
    unsure = np.where(of_gain, 0.0, variance / own**2) + (facts.std / facts.value) ** 2
    usable = of_gain | (facts.forces[index] & (facts.value != 0))
    best = np.argmin(np.where(usable & np.isfinite(unsure), unsure, np.inf), axis=1)
    return np.asarray(np.take_along_axis(gains, best[:, None], axis=1)[:, 0])


def _make_combined(estimate: Floats, covariance: Floats, a: Floats, b: Floats, last: _Linear, facts: Facts) -> Combined:
    p = a.shape[1]
    moves_a = np.eye(p) - last.gain_a @ last.by_a
    moves_b = -np.einsum("nk,nkp->np", last.gain_b, last.by_a)
    own = np.where(facts.forces, b[:, None], 1.0)
    with_b = np.where(facts.forces, a, 0.0)
    moves = np.concatenate(
        [own[:, :, None] * moves_a + with_b[:, :, None] * moves_b[:, None], moves_b[:, None]], axis=1
    )
    pull = np.concatenate(
        [own[:, :, None] * last.gain_a + with_b[:, :, None] * last.gain_b[:, None], last.gain_b[:, None]], axis=1
    )
    noise = np.einsum("nij,njk,nlk->nil", moves, covariance, moves) + np.einsum(
        "nik,k,nlk->nil", pull, facts.std**2, pull
    )
    rest = facts.value - last.h + _times(last.by_a, a - estimate)
    tested = last.left > UNTESTED * last.total
    apart = np.where(tested, rest / np.sqrt(np.where(tested, last.left, 1.0)), 0.0)
    return Combined(np.concatenate([own * a, b[:, None]], axis=1), noise, moves, apart)

"""Likelihood of the counts. A count states only between which two positions the axis is."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from pmfid.estimators.motion import Difference, bounded_step, rms
from pmfid.estimators.tuning import TUNING
from pmfid.types import Floats

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    #: A matrix (n, q), dense or sparse.
    Rows: TypeAlias = Floats | csr_array
HALF_LOG_2_PI = 0.5 * math.log(2 * math.pi)


@dataclass(frozen=True)
class Best:
    """The motion of a model that fits a record best. Every method that simulates the whole record starts from its best
    motion.

    `least` (q,) has the parameters and the start at the least squares of the difference. `q` (q,) has the values of the
    largest likelihood if the difference is within the counts, and equals `least` otherwise. `noise` is the standard
    deviation of the difference [counts], or None outside the counts. `status` has the status bits of the record.
    """

    difference: Difference
    least: Floats
    q: Floats
    noise: float | None
    status: int = 0

    @property
    def clean(self) -> bool:
        """Whether the model and the encoder explain the whole position."""
        return self.noise is not None and self.noise <= TUNING.given_away * TUNING.noise_floor


def best_of(difference: Difference, least: Floats, status: int = 0) -> Best:
    """Return the best motion from the least squares (q,) of a difference."""
    if difference.pole > 0 or rms(difference(least)) > difference.explained:
        return Best(difference, least, least, None, status)
    return Best(difference, least, *likeliest(difference, least), status)


def log_likelihood(best: Best, cutoff: float) -> float:
    """Return the log-likelihood of the counts under the better of two error models, in natural units.

    One error model is a noise within the counts. The other error model is unmodelled friction, which adds up to a
    random walk of the position. The high-pass of the random walk, at `cutoff` [rad/s], has a determinant of 1, so both
    likelihoods are probabilities of the same counts.
    """
    high_passed = replace(best.difference, pole=cutoff)
    error = high_passed(best.q)
    walking = -error.size / 2 * (math.log(2 * math.pi * float(np.mean(error**2))) + 1)
    if best.noise is None:
        return walking
    return max(walking, -cost(best.difference(best.q), best.noise)[0])


def likeliest_of(found: Iterable[Best], cutoff: float) -> Best:
    """Return the largest maximum from several starts. A maximum that explains every count ends the search."""
    kept = list[Best]()
    for one in found:
        kept.append(one)
        if one.clean:
            return one
    return max(kept, key=lambda one: log_likelihood(one, cutoff))


def likeliest(difference: Difference, q: Floats) -> tuple[Floats, float]:
    """Return q (q,) and the noise [counts] of the largest likelihood, from the least squares q.

    A record with few counts has local maxima. A noise above the floor reveals a local maximum. The search then starts
    again from several points around q, with a noise that shrinks step by step, and returns the best result. The search
    ends early if the first starts all find the same maximum.
    """
    best = climb(difference, q, None)
    if (
        best[2] <= TUNING.given_away * TUNING.noise_floor or difference.restarts
    ):  # least squares found the starts after gaps
        return best[1], best[2]
    costs = [best[0]]
    for start in (q, *_list_starts(difference, q)):
        place = start
        for noise in TUNING.likelihood_shrinking:
            place = climb(difference, place, noise)[1]
        found = climb(difference, place, None)
        costs.append(found[0])
        best = min(best, found, key=lambda one: one[0])
        if best[2] <= TUNING.given_away * TUNING.noise_floor or (
            len(costs) > TUNING.likelihood_agreeing and max(costs) - min(costs) < TUNING.likelihood_same
        ):
            break
    return best[1], best[2]


def _list_starts(difference: Difference, q: Floats) -> list[Floats]:
    """Return start values (q,) at 1.5 standard deviations of least squares on both sides of q, along its main axes."""
    jacobian = difference.jacobian(q)
    _, size, axes = np.linalg.svd(jacobian, full_matrices=False)
    spread = np.sqrt(np.mean(difference(q) ** 2)) / np.maximum(size, 1e-6 * size[0])
    steps = [
        TUNING.likelihood_around * side * length * axis
        for length, axis in zip(spread, axes, strict=True)
        for side in (1.0, -1.0)
    ]
    return [np.maximum(q + step, difference.lower) for step in steps]


def climb(
    difference: Difference, q: Floats, fixed: float | None, settled: float = TUNING.settled_step**2 / 2
) -> tuple[float, Floats, float]:
    """Return the negative log-likelihood, q (q,) and the noise [counts] at a maximum near q.

    The noise is the likeliest noise or the value `fixed`. Each step leads to the top of the likelihood of linearised
    differences. The first steps may increase the cost if the motion bends. The search accepts steps that increase the
    cost, because such steps converge fast, and undoes them if no top follows. After an undone step, the search tries a
    part of the step. A step that gains less than `settled` is the last one; the default corresponds to `settled_step`
    standard errors.
    """
    best, down = _evaluate(difference, q, fixed), 0
    place, widths = best, np.full(q.size, TUNING.likelihood_quotient)
    for _ in range(TUNING.likelihood_max_iterations):
        step, promised = _aim(difference, place, widths)
        higher = best.cost - promised >= settled
        if place is best and not higher:
            break
        found = _evaluate(difference, np.maximum(place.q + step, difference.lower), fixed) if higher else best
        if found.cost < best.cost:
            gain, best, place, down = best.cost - found.cost, found, found, 0
        elif higher and down < TUNING.likelihood_downward and found.cost < np.inf:
            gain, place, down = np.inf, found, down + 1
        else:
            found = _search_near(difference, best, fixed)
            gain, best, place, down = best.cost - found.cost, found, found, TUNING.likelihood_downward
        if gain < settled:
            break
        widths = _widths(difference, place.q, step)
    return best.cost, best.q, best.noise


def _widths(difference: Difference, q: Floats, step: Floats) -> Floats:
    """Return the widths of the difference quotients at q (q,). The quotients have the length and the direction of the
    last step (q,), because a start from rest has a different effect in each direction."""
    widths = np.clip(np.abs(step), TUNING.least_quotient, TUNING.likelihood_quotient)
    return np.asarray(np.where((step < 0) & (q - widths >= difference.lower), -widths, widths))


def _aim(difference: Difference, place: _Place, widths: Floats) -> tuple[Floats, float]:
    """Return the step (q,) to the top of the linearised differences, and the negative log-likelihood there."""
    jacobian = difference.forward_jacobian(place.q, place.e, widths)
    step = top(place.e, jacobian, place.noise, difference.lower - place.q)
    return step, cost(place.e + jacobian @ step, place.noise)[0]


@dataclass(frozen=True, eq=False)
class _Place:
    """A point of the search: q (q,), its differences e (n,) [counts], their noise, and the negative log-likelihood."""

    q: Floats
    e: Floats
    noise: float
    cost: float


def _evaluate(difference: Difference, q: Floats, fixed: float | None, e: Floats | None = None) -> _Place:
    e = difference(q) if e is None else e
    if not np.max(np.abs(e)) < TUNING.likelihood_lost:  # no likelihood leads back from a place so far away
        return _Place(q, e, np.inf, np.inf)
    noise = fixed or likeliest_noise(e)
    return _Place(q, e, noise, cost(e, noise)[0])


def _search_near(difference: Difference, best: _Place, fixed: float | None) -> _Place:
    """Return the likeliest of the tops at which the differences change little, or the place itself."""
    jacobian = difference.forward_jacobian(best.q, best.e, TUNING.likelihood_quotient)
    low = difference.lower - best.q
    steps = [top(best.e, jacobian, best.noise, low, tied) for tied in TUNING.likelihood_ties]
    trials = np.maximum(best.q + np.array(steps), difference.lower)
    found = [_evaluate(difference, q, fixed, e) for q, e in zip(trials, difference.differences(trials), strict=True)]
    return min([best, *found], key=lambda place: place.cost)


def top(error: Floats, jacobian: Floats, noise: float, lower: Floats | None = None, tied: float = 0.0) -> Floats:
    """Return the step (q,), at least `lower`, to the largest likelihood of the linearised differences.

    The differences are error (n,) + jacobian (n, q) @ step [counts], and the search uses damped Newton steps. `tied` /
    2 is the cost of the summed squares of the step's effect on the differences.
    """
    step, damping = np.zeros(jacobian.shape[1]), TUNING.first_damping
    if step.size > TUNING.dense_columns:  # each window has its own start
        from scipy.sparse import csr_array  # the import is slow, and only windows need it

        jacobian = csr_array(jacobian)
    tie = tied * _square(jacobian, jacobian)
    low = np.full(step.size, -np.inf) if lower is None else lower
    now, slope, hessian = _edge_cost(error, jacobian, noise)
    for _ in range(TUNING.top_steps):
        damped = hessian + tie + damping * np.diag(np.maximum(np.diagonal(hessian), TUNING.tiny))
        trial = np.maximum(step - bounded_step(damped, slope + tie @ step, step > low), low)
        found = _edge_cost(error + jacobian @ trial, jacobian, noise)
        gain = now - found[0] + (step @ tie @ step - trial @ tie @ trial) / 2
        if gain > 0:
            step, damping = trial, damping / 10
            now, slope, hessian = found
            if gain < TUNING.top_settled:
                break
        else:
            damping *= 10
    return step


def _edge_cost(error: Floats, jacobian: Rows, noise: float) -> tuple[float, Floats, Floats]:
    """Return the negative log-likelihood, gradient (q,) and curvature (q, q) of those counts whose edges are near. The
    contribution of all other counts is zero in floating point."""
    near = np.abs(error) > 0.5 - TUNING.likelihood_reach * noise
    rows = jacobian[near]
    now, slope, curvature = cost(error[near], noise)
    return now, rows.T @ slope, _square(rows, rows * curvature[:, None])


def _square(rows: Rows, weighted: Rows) -> Floats:
    """Return the product rows^T weighted (q, q) of two matrices (n, q)."""
    product = rows.T @ weighted
    return product if isinstance(product, np.ndarray) else np.asarray(product.toarray())


def likeliest_noise(e: Floats) -> float:
    """Return the likeliest noise [counts] for the differences e (n,) [counts], at least noise_floor."""
    apart = np.abs(e)

    def slope(log: float) -> float:
        """Return the derivative of the mean log-likelihood by the logarithm of the noise."""
        noise = math.exp(log)
        return -float(np.mean(count_likelihood(apart, noise)[2])) * noise**2

    low, high = math.log(TUNING.noise_floor), math.log(1 + 2 * float(np.max(apart)))
    if slope(low) <= 0:
        return TUNING.noise_floor
    from scipy.optimize import brentq  # the import is slow, and a record within its counts never needs it

    return math.exp(brentq(slope, low, high, xtol=TUNING.noise_tolerance))


def cost(e: Floats, noise: float) -> tuple[float, Floats, Floats]:
    """Return the negative log-likelihood with its first and second derivatives by the differences e (n,) [counts]."""
    log_p, slope, bend = count_likelihood(np.abs(e), noise)
    return -float(np.sum(log_p)), np.sign(e) * slope, np.maximum(slope**2 + bend, 0.0)


def expected_information(e: Floats, noise: float) -> Floats:
    """Return the expected Fisher information (n,) on the position [counts] at the differences e (n,)."""
    if noise > TUNING.likelihood_wide:
        return np.full(e.size, 1 / (noise**2 + 1 / 12))  # Sheppard's correction
    reach, total = math.ceil(6 * noise), np.zeros(e.size)
    for count in range(-reach, reach + 1):
        log_p, slope, _ = count_likelihood(np.abs(e - np.round(e) + count), noise)
        total += np.exp(log_p) * slope**2
    return total


def count_likelihood(apart: Floats, noise: float) -> tuple[Floats, Floats, Floats]:
    """Return the logarithm of a count's probability P, -P'/P, and the negative of P''/P.

    The middle of the count is `apart` >= 0 (n,) [counts] from the position. The function computes with logarithms,
    because P itself is zero in floating point far outside the count.
    """
    log_p = log_probability(apart, noise)
    inner, outer = (0.5 - apart) / noise, (-0.5 - apart) / noise
    at_inner, at_outer = (np.exp(-0.5 * edge**2 - HALF_LOG_2_PI - log_p) for edge in (inner, outer))
    return log_p, (at_inner - at_outer) / noise, (inner * at_inner - outer * at_outer) / noise**2


def log_probability(apart: Floats, noise: float) -> Floats:
    """Return the log-probability of a count whose middle is `apart` >= 0 (n,) [counts] from the position."""
    from scipy.special import log_ndtr  # slow to import

    log_inner = log_ndtr((0.5 - apart) / noise)
    log_outer = log_ndtr((-0.5 - apart) / noise)
    return np.asarray(log_inner + np.log(-np.expm1(np.minimum(log_outer - log_inner, -TUNING.tiny))))

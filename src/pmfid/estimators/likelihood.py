"""The likelihood of counts: each says between which two positions the axis is, and nothing more."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from scipy.special import log_ndtr

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
    """The motion of a model that fits a record best: what every method that simulates the whole of it starts from.

    least (q,): parameters and start of the least squares of the difference; q (q,): of the largest likelihood, where
    the difference is within the counts, else `least`; noise: its standard deviation [counts], None: not within the
    counts; status: bits of the record.
    """

    difference: Difference
    least: Floats
    q: Floats
    noise: float | None
    status: int = 0

    @property
    def clean(self) -> bool:
        """Is there no more in the position than the model and the encoder explain? Then one stroke is like the next."""
        return self.noise is not None and self.noise <= TUNING.given_away * TUNING.noise_floor


def best_of(difference: Difference, least: Floats, status: int = 0) -> Best:
    """The same for the least squares (q,) of a difference."""
    if difference.pole > 0 or rms(difference(least)) > difference.explained:
        return Best(difference, least, least, None, status)
    return Best(difference, least, *likeliest(difference, least), status)


def log_likelihood(best: Best, cutoff: float) -> float:
    """Of the counts, in natural units, under the error that explains them better: a noise within the counts, or
    unmodelled friction, which adds up in the position to a random walk. The high-pass of the random walk, at cutoff
    [rad/s], has a determinant of 1, so both likelihoods are probabilities of the same counts."""
    high_passed = replace(best.difference, pole=cutoff)
    error = high_passed(best.q)
    walking = -error.size / 2 * (math.log(2 * math.pi * float(np.mean(error**2))) + 1)
    if best.noise is None:
        return walking
    return max(walking, -cost(best.difference(best.q), best.noise)[0])


def likeliest_of(found: Iterable[Best], cutoff: float) -> Best:
    """The largest of several maxima that were climbed from different starts; one that explains every count ends the
    search."""
    kept = list[Best]()
    for one in found:
        kept.append(one)
        if one.clean:
            return one
    return max(kept, key=lambda one: log_likelihood(one, cutoff))


def likeliest(difference: Difference, q: Floats) -> tuple[Floats, float]:
    """q (q,) and noise [counts] of the largest likelihood, from the least squares q.

    With few counts there are local maxima, and a noise beyond the floor gives them away: then the search starts again
    from around q, with a noise that shrinks step by step, and the best counts. It ends early if the first starts all
    find the same maximum.
    """
    best = climb(difference, q, None)
    if (
        best[2] <= TUNING.given_away * TUNING.noise_floor or difference.restarts
    ):  # the starts after gaps are those of least squares
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
    """Starts (q,) one and a half standard deviations of least squares to either side of q, along its main axes."""
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
    """Negative log-likelihood, q (q,) and noise [counts] at a maximum near q, with the best noise or a fixed one.

    Each step leads to the top of the likelihood of differences that are linear in q. Where the motion bends, the first
    such steps may lead down: they are taken, as they converge fast, and taken back if no top follows. From there a part
    of the way is tried. settled: a step that gains less is the last one; by default one of settled_step of a standard
    error."""
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
    """Of the difference quotients at q (q,): as long as the last step (q,) and in its direction, for a start from rest
    has another effect on either side."""
    widths = np.clip(np.abs(step), TUNING.least_quotient, TUNING.likelihood_quotient)
    return np.asarray(np.where((step < 0) & (q - widths >= difference.lower), -widths, widths))


def _aim(difference: Difference, place: _Place, widths: Floats) -> tuple[Floats, float]:
    """The step (q,) to the top of differences that are linear in q, and their negative log-likelihood there."""
    jacobian = difference.forward_jacobian(place.q, place.e, widths)
    step = top(place.e, jacobian, place.noise, difference.lower - place.q)
    return step, cost(place.e + jacobian @ step, place.noise)[0]


@dataclass(frozen=True, eq=False)
class _Place:
    """q (q,), its differences e (n,) [counts] and their noise, and the negative log-likelihood."""

    q: Floats
    e: Floats
    noise: float
    cost: float


def _evaluate(difference: Difference, q: Floats, fixed: float | None, e: Floats | None = None) -> _Place:
    e = difference(q) if e is None else e
    if not np.max(np.abs(e)) < TUNING.likelihood_lost:  # no likelihood leads back from there
        return _Place(q, e, np.inf, np.inf)
    noise = fixed or likeliest_noise(e)
    return _Place(q, e, noise, cost(e, noise)[0])


def _search_near(difference: Difference, best: _Place, fixed: float | None) -> _Place:
    """The likeliest of the tops where the differences move little, or the place itself."""
    jacobian = difference.forward_jacobian(best.q, best.e, TUNING.likelihood_quotient)
    low = difference.lower - best.q
    steps = [top(best.e, jacobian, best.noise, low, tied) for tied in TUNING.likelihood_ties]
    trials = np.maximum(best.q + np.array(steps), difference.lower)
    found = [_evaluate(difference, q, fixed, e) for q, e in zip(trials, difference.differences(trials), strict=True)]
    return min([best, *found], key=lambda place: place.cost)


def top(error: Floats, jacobian: Floats, noise: float, lower: Floats | None = None, tied: float = 0.0) -> Floats:
    """Step (q,), at least `lower`, to the largest likelihood of differences error (n,) + jacobian (n, q) @ step
    [counts]: damped steps of Newton. tied: a cost of that times half the sum of squares of what the step changes."""
    step, damping = np.zeros(jacobian.shape[1]), TUNING.first_damping
    if step.size > TUNING.dense_columns:  # of windows, each with a start of its own
        from scipy.sparse import csr_array  # slow to import, and only windows need it

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
    """Negative log-likelihood, gradient (q,) and curvature (q, q): of the counts whose edges are near enough to matter,
    for all others it is zero in floating point."""
    near = np.abs(error) > 0.5 - TUNING.likelihood_reach * noise
    rows = jacobian[near]
    now, slope, curvature = cost(error[near], noise)
    return now, rows.T @ slope, _square(rows, rows * curvature[:, None])


def _square(rows: Rows, weighted: Rows) -> Floats:
    """rows^T weighted (q, q) of two matrices (n, q)."""
    product = rows.T @ weighted
    return product if isinstance(product, np.ndarray) else np.asarray(product.toarray())


def likeliest_noise(e: Floats) -> float:
    """Noise [counts] of the largest likelihood for the differences e (n,) [counts], at least noise_floor."""
    apart = np.abs(e)

    def slope(log: float) -> float:
        """The derivative of the log-likelihood by the logarithm of the noise, for a sample."""
        noise = math.exp(log)
        return -float(np.mean(count_likelihood(apart, noise)[2])) * noise**2

    low, high = math.log(TUNING.noise_floor), math.log(1 + 2 * float(np.max(apart)))
    if slope(low) <= 0:
        return TUNING.noise_floor
    from scipy.optimize import brentq  # slow to import, and a record within its counts never needs it

    return math.exp(brentq(slope, low, high, xtol=TUNING.noise_tolerance))


def cost(e: Floats, noise: float) -> tuple[float, Floats, Floats]:
    """Negative log-likelihood, and its first and second derivative by each of the differences e (n,) [counts]."""
    log_p, slope, bend = count_likelihood(np.abs(e), noise)
    return -float(np.sum(log_p)), np.sign(e) * slope, np.maximum(slope**2 + bend, 0.0)


def expected_information(e: Floats, noise: float) -> Floats:
    """Fisher information (n,) on the position [counts] at differences e (n,), mean over the counts that may come."""
    if noise > TUNING.likelihood_wide:
        return np.full(e.size, 1 / (noise**2 + 1 / 12))  # Sheppard's correction
    reach, total = math.ceil(6 * noise), np.zeros(e.size)
    for count in range(-reach, reach + 1):
        log_p, slope, _ = count_likelihood(np.abs(e - np.round(e) + count), noise)
        total += np.exp(log_p) * slope**2
    return total


def count_likelihood(apart: Floats, noise: float) -> tuple[Floats, Floats, Floats]:
    """Logarithm of the probability P of a count whose middle is `apart` >= 0 (n,) [counts] from the position, with
    -P'/P and P''/P negative. All from logarithms: far outside the count P itself is zero in floating point."""
    log_p = log_probability(apart, noise)
    inner, outer = (0.5 - apart) / noise, (-0.5 - apart) / noise
    at_inner, at_outer = (np.exp(-0.5 * edge**2 - HALF_LOG_2_PI - log_p) for edge in (inner, outer))
    return log_p, (at_inner - at_outer) / noise, (inner * at_inner - outer * at_outer) / noise**2


def log_probability(apart: Floats, noise: float) -> Floats:
    """Logarithm of the probability of a count whose middle is `apart` >= 0 (n,) [counts] from the position."""
    log_inner = log_ndtr((0.5 - apart) / noise)
    log_outer = log_ndtr((-0.5 - apart) / noise)
    return np.asarray(log_inner + np.log(-np.expm1(np.minimum(log_outer - log_inner, -TUNING.tiny))))

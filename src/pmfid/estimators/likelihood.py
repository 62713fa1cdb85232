"""The likelihood of counts: each says between which two positions the axis is, and nothing more."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_ndtr

from pmfid.estimators.motion import Difference, bounded_step, rms, try_step
from pmfid.estimators.tuning import TUNING
from pmfid.types import Floats

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
        best[2] <= TUNING.given_away * TUNING.noise_floor or difference.breaks
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
    """Negative log-likelihood, q (q,) and noise [counts] at a maximum near q: damped Newton steps, with the best noise
    after each or a fixed one. settled: a step that gains less is the last one; by default one of settled_step of a
    standard error."""
    damping, step, gain = TUNING.first_damping, np.inf, np.inf
    e = difference(q)
    jacobian = difference.forward_jacobian(q, e)
    noise = fixed or likeliest_noise(e)
    for _ in range(TUNING.likelihood_max_iterations):
        now, slope, curvature = cost(e, noise)
        hessian = jacobian.T @ (curvature[:, None] * jacobian)
        # counts far from their edges have no curvature: without the last term a step would leave them
        hessian += damping * (np.diag(np.diagonal(hessian)) + jacobian.T @ jacobian)
        step_back = bounded_step(hessian, jacobian.T @ slope, q > difference.lower)
        trial = np.maximum(q - step_back, difference.lower)
        e_trial = try_step(difference, q, trial)
        gain = now - cost(e_trial, noise)[0] if np.all(np.isfinite(e_trial)) else -np.inf
        if gain > 0:
            step, q, e, damping = float(np.max(np.abs(trial - q))), trial, e_trial, damping / 10
            noise = fixed or likeliest_noise(e)
        else:
            damping *= 10
        if step < TUNING.likelihood_tolerance or damping > TUNING.max_damping or 0 < gain < settled:
            break
        if gain > 0:
            jacobian = difference.forward_jacobian(q, e)
    return cost(e, noise)[0], q, noise


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

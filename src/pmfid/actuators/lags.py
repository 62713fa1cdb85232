"""The posterior over the lag of the velocity in the loop of a servo, which is no normal distribution.

A derivative gain kd on a velocity with the lag tau hides a part kd tau of the inertia. Where a log shows neither, both
are at their lower bound or far from it. At each lag the fit is a normal distribution without the negative sizes, and
the lags have the weights of their evidence (Rue, Martino and Chopin 2009). Between half a period of the loop and the
slowest filters, the prior of the lag is that of a scale (Jeffreys 1946).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from pmfid.actuators.bounded import cut_below
from pmfid.actuators.search import ServoSearch
from pmfid.actuators.tuning import TUNING
from pmfid.fit.solve import inverse
from pmfid.types import Floats


@dataclass(frozen=True, eq=False)
class LagFit:
    """The fit at a lag [s]: log evidence, mean (p,) and covariance (p, p) of the coordinates, and the search there.
    `scatter` is the change of the log evidence from one motion in ticks to the next, and `weight` the probability."""

    lag: float
    value: float
    scatter: float
    mean: Floats
    covariance: Floats
    search: ServoSearch
    weight: float


def take_lag(search: ServoSearch, lags: Sequence[float]) -> ServoSearch:
    """Return the search at the best of some lags [s]. A delay of the loop, too, may mimic a lag."""
    fits = _fit_lags(search, lags, 1) if search.kept else []
    if not fits:
        return search
    best = max(fits, key=lambda fit: fit.value)
    best.search.tried = {fit.lag: fit.search for fit in fits}
    near = [k for k, fit in enumerate(fits) if fit.value > best.value - 8 * TUNING.lag_drop]
    best.search.lags = tuple(fit.lag for fit in fits[max(near[0] - 1, 0) : near[-1] + 2])
    return best.search


def profile_lags(search: ServoSearch) -> list[LagFit]:
    """Return the fits at lags close enough to each other near the best one, in rising order, with their weights."""
    fits = _fit_lags(search, search.lags, 2)
    for _ in range(TUNING.halvings if fits else 0):
        even = [fit.value for fit in _weigh(fits)]
        best = int(np.argmax(even))
        wide = [k for k in (best - 1, best + 1) if 0 <= k < len(fits) and even[best] - even[k] > TUNING.lag_drop]
        more = [_fit_at(fits[best].search, 0.5 * (fits[k].lag + fits[best].lag), 2) for k in wide]
        fits = _sort([*fits, *more])
    return _weigh(fits)


def _fit_lags(search: ServoSearch, lags: Sequence[float], motions: int) -> list[LagFit]:
    """Return the fits at some lags in rising order, each from the nearest one."""
    fits = [_fit_at(search, search.lag, motions)]
    for lag in sorted({*lags} - {search.lag}, key=lambda lag: abs(lag - search.lag)):
        fits.append(_fit_at(min(fits, key=lambda fit: abs(fit.lag - lag)).search, lag, motions))
    return _sort(fits)


def _sort(fits: Sequence[LagFit]) -> list[LagFit]:
    """Return the fits whose motion does not overflow, in rising order of the lag."""
    return sorted((fit for fit in fits if math.isfinite(fit.value + fit.scatter)), key=lambda fit: fit.lag)


def _move_to(search: ServoSearch, lag: float) -> ServoSearch:
    """Return the search at a lag from its last fit there or, before the first one, the better of two. The second begins
    with half of the viscous friction in the loop: below the limit of the torque only ticks tell it from the joint's."""
    starts, tried = [at := copy(search), other := copy(search)], search.tried.get(lag)
    at.set_lag(lag)
    other.set_lag(lag, half=True)
    if tried and (tried.chosen, tried.q.size, tried.plain.rows) == (at.chosen, at.q.size, at.plain.rows):
        at.q, at.starts = tried.q, tried.starts
        starts = [at]
    for one in starts:
        one.apply_ticks()
    return min(starts, key=lambda one: one.solve(one.noise, 15).cost)


def _fit_at(search: ServoSearch, lag: float, motions: int) -> LagFit:
    """Return the fit at a lag, with the mean evidence of one or two motions in ticks."""
    at, values = _move_to(search, lag), list[float]()
    for _ in range(motions):
        at.apply_ticks()
        optimum, lowest = at.solve(at.noise, 5), at.problem.clip_to_bounds(np.full(at.q.size, -np.inf))
        prior = at.prior(at.problem)
        covariance = inverse(optimum.normal.A + np.diag(prior))
        g = np.maximum(optimum.normal.g + prior * optimum.q, 0.0) * (optimum.q <= lowest)  # better beyond a bound
        value = -optimum.cost + 0.5 * float(g @ covariance @ g) + 0.5 * float(np.linalg.slogdet(covariance)[1])
        part, mean, covariance = cut_below(optimum.q - covariance @ g, covariance, lowest)
        values.append(value + part - 0.5 * (lag / TUNING.lag) ** 2 - math.log(lag / at.task.servo.loop_period + 0.5))
    change = values[-1] - values[0]
    return LagFit(lag, float(np.mean(values)), change, np.maximum(mean, lowest), covariance, at, 1.0)


def _weigh(fits: Sequence[LagFit]) -> list[LagFit]:
    """Return the fits with their weights, and with log evidence that is free of the scatter by motions in ticks.

    The evidence is a smooth function of the logarithm of the lag, over the length that makes it likeliest. The weights
    are means over draws of this function (Rasmussen and Williams 2006, equations 2.25, 2.26 and 2.30).
    """
    if len(fits) < 2:
        return list(fits)
    values, at = np.array([fit.value for fit in fits]), np.log([fit.lag + 0.5e-3 for fit in fits])
    noise = 0.5 * np.median(np.square([fit.scatter for fit in fits]))  # of the mean of two
    shape = np.square(at[:, None] - at) / 4.0 ** np.arange(-3, 2)[:, None, None]
    kernels, apart = (np.var(values) + 1e-9) * np.exp(-0.5 * shape), values - values.mean()
    inverses = np.linalg.inv(kernels + (noise + 1e-6 * np.trace(kernels[0])) * np.eye(at.size))
    best = np.argmax(np.linalg.slogdet(inverses)[1] - np.einsum("i,kij,j->k", apart, inverses, apart))
    gain, kernel = kernels[best] @ inverses[best], kernels[best]
    mean, rng = values.mean() + gain @ apart, np.random.default_rng(0)
    draws = rng.multivariate_normal(mean, kernel - gain @ kernel, TUNING.draws, method="eigh")
    weights = np.exp(draws - draws.max(axis=1, keepdims=True)) * np.gradient([fit.lag for fit in fits])
    weights = np.mean(weights / weights.sum(axis=1, keepdims=True), axis=0)
    return [replace(fit, value=v, weight=w) for fit, v, w in zip(fits, mean.tolist(), weights.tolist(), strict=True)]


def mix(fits: Sequence[LagFit]) -> tuple[Floats, Floats]:
    """Return mean (p + 1,) and covariance (p + 1, p + 1) of the coordinates and the lag over all lags."""
    lags, weights = np.array([[fit.lag, fit.weight] for fit in fits]).T
    means = np.array([[*fit.mean, fit.lag] for fit in fits])
    mean = weights @ means
    apart = means - mean
    covariance = (apart * weights[:, None]).T @ apart
    covariance[:-1, :-1] += np.einsum("i,ijk->jk", weights, np.array([fit.covariance for fit in fits]))
    # within the distance of two lags their evidence is as good as constant
    covariance[-1, -1] += float(weights @ np.square(np.gradient(lags))) / 12 if lags.size > 1 else 0.0
    return mean, covariance

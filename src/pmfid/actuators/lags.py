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
from dataclasses import dataclass

import numpy as np

from pmfid.actuators.bounded import cut_below
from pmfid.actuators.search import ServoSearch
from pmfid.actuators.tuning import TUNING
from pmfid.fit.solve import inverse
from pmfid.types import Floats


@dataclass(frozen=True, eq=False)
class LagFit:
    """The fit at a lag [s]: log evidence, mean (p,) and covariance (p, p) of the coordinates, and the search there."""

    lag: float
    value: float
    mean: Floats
    covariance: Floats
    search: ServoSearch


def profile_lags(search: ServoSearch) -> list[LagFit]:
    """Return the fits at lags that are close enough to each other near the best one, in rising order. A motion that
    overflows has no fit."""
    fits = [fit for fit in fit_lags(search) if math.isfinite(fit.value)]
    for _ in range(TUNING.halvings):
        best = max(range(len(fits)), key=lambda k: fits[k].value, default=0)
        sides = [k for k in (best - 1, best + 1) if 0 <= k < len(fits)]
        wide = [k for k in sides if fits[best].value - fits[k].value > TUNING.lag_drop]
        more = [_fit_at(fits[best].search, 0.5 * (fits[k].lag + fits[best].lag)) for k in wide]
        fits = sorted([*fits, *(fit for fit in more if math.isfinite(fit.value))], key=lambda fit: fit.lag)
    return fits


def fit_lags(search: ServoSearch) -> list[LagFit]:
    """Return the fits at the first lags, each from the nearest one. A delay of the loop, too, may mimic a lag."""
    fits = [_fit_at(search, search.lag)]
    for lag in sorted({*TUNING.lags} - {search.lag}, key=lambda lag: abs(lag - search.lag)):
        nearest = min(fits, key=lambda fit: abs(fit.lag - lag))
        fits.append(_fit_at(nearest.search, lag))
    return sorted(fits, key=lambda fit: fit.lag)


def _fit_at(search: ServoSearch, lag: float) -> LagFit:
    """Return the fit at a lag."""
    at = copy(search)
    at.set_lag(lag)
    at.apply_ticks()
    at.solve(at.noise, 15)
    at.apply_ticks()
    optimum, lowest = at.solve(at.noise, 15), at.problem.clip_to_bounds(np.full(at.q.size, -np.inf))
    prior = at.prior(at.problem)
    covariance = inverse(optimum.normal.A + np.diag(prior))
    g = optimum.normal.g + prior * optimum.q  # the fit may be better beyond a bound
    value = -optimum.cost + 0.5 * float(g @ covariance @ g) + 0.5 * float(np.linalg.slogdet(covariance)[1])
    part, mean, covariance = cut_below(optimum.q - covariance @ g, covariance, lowest)
    value += part - 0.5 * (lag / TUNING.lag) ** 2 - math.log(lag / search.task.servo.loop_period + 0.5)
    return LagFit(lag, value, np.maximum(mean, lowest), covariance, at)


def mix(fits: Sequence[LagFit]) -> tuple[Floats, Floats]:
    """Return mean (p + 1,) and covariance (p + 1, p + 1) of the coordinates and the lag over all lags."""
    lags = np.array([fit.lag for fit in fits])
    values = np.array([fit.value for fit in fits])
    weights = np.exp(values - values.max()) * np.gradient(lags) if lags.size > 1 else np.ones(1)
    weights /= weights.sum()
    means = np.array([[*fit.mean, fit.lag] for fit in fits])
    mean = weights @ means
    apart = means - mean
    covariance = (apart * weights[:, None]).T @ apart
    covariance[:-1, :-1] += np.einsum("i,ijk->jk", weights, np.array([fit.covariance for fit in fits]))
    # within the distance of two lags their evidence is as good as constant
    covariance[-1, -1] += float(weights @ np.square(np.gradient(lags))) / 12 if lags.size > 1 else 0.0
    return mean, covariance


def has_gain(search: ServoSearch) -> bool:
    """Return whether the log shows that the loop has a derivative gain."""
    local = search.local(search.noise)
    return local.evidence(search.chosen)[0] > local.evidence([i for i in search.chosen if i not in search.kept])[0]

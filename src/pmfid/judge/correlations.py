"""From an estimate to its force balance, and the correlations of what the balance leaves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pmfid.estimators.arguments import hold_last_input
from pmfid.estimators.base import Estimator
from pmfid.estimators.configuration import like
from pmfid.estimators.iv import IV
from pmfid.estimators.motion import mean_velocity
from pmfid.estimators.output_error import OE
from pmfid.judge.balance import FEWEST_BINS, Balance, encoder_response, low_pass
from pmfid.judge.drive import recent
from pmfid.models.drive import EquationModel
from pmfid.types import Floats

#: Filter time constants over which correlations are shown.
SHOWN_LAGS = 10.0


def make_balance(estimator: Estimator, u: ArrayLike, counts: ArrayLike, theta: ArrayLike) -> Balance | None:
    """The record u, counts (n,) at theta (p,), with a memory its last three; None where it cannot be simulated.

    Raises PmfidError as `IV` does."""
    if estimator.equation.without_simulation:
        return None
    equation, p = estimator.equation, len(estimator.equation.names)
    known = {"model": EquationModel(equation.known_at(np.asarray(theta, float)[p:]))} if equation.further else {}
    twin = like(IV, estimator, prefilter_zeros=None, precision="float64", **known)
    at = np.asarray(theta, float)[: len(twin.names)]
    if not (np.all(np.isfinite(at)) and at[twin.equation.leading] > 0):
        return None
    # a body pushed by its friction has no motion to compare with
    plausible = np.where(twin.equation.positive, np.maximum(at, 0.0), at)
    u, counts, dt = hold_last_input(np.asarray(u, float)), np.asarray(counts), twin.dt
    y = like(OE, twin).position(counts)
    speed = simulated_velocity(twin, plausible, u)
    columns = twin.columns_at(plausible, u, counts)
    used = np.flatnonzero(columns.used)
    chosen = used[recent(estimator, used.size)]
    if not (np.all(np.isfinite(speed)) and chosen.size > 4 * FEWEST_BINS):
        return None
    measured, x = np.diff(y, append=y[-1]) / dt, np.r_[0.0, np.cumsum(speed[:-1])] * dt
    drift = (y - x)[chosen]
    rows = slice(columns.z.size - chosen.size, None)
    late = chosen - 2  # a sample ends the interval before it, and the columns of the kernel are one sample late
    slow, modelled, way = (low_pass(twin, signal)[-1][late] for signal in (measured, speed, y - y[0]))
    t, target, phi = np.asarray(chosen * dt, float), columns.z[rows], columns.phi[rows]
    return Balance(twin, at, t, slow, modelled, y[0] + way, drift - drift[0], target, phi)


def simulated_velocity(estimator: IV, theta: Floats, u: Floats) -> Floats:
    """Mean velocity (n,) [m/s] of every interval, from rest, under the input u (n,) alone."""
    return mean_velocity(estimator.equation, theta, estimator.dt, u)


@dataclass(frozen=True)
class Correlations:
    """Of the residual with itself, own (lags + 1,), and of the input force with the residual `lag` samples later,
    cross (2 lags + 1,); encoder (lags + 1,): of the residual if only the encoder's error were in it; own_error,
    cross_error: standard deviations of either for nothing but the encoder's error (Bartlett 1935)."""

    own: Floats
    cross: Floats
    encoder: Floats
    own_error: float
    cross_error: float


def correlations(balance: Balance) -> Correlations:
    """Over 10 filter time constants, or a quarter of a short record."""
    n = balance.t.size
    lags = max(2, min(round(SHOWN_LAGS / (balance.estimator.cutoff * balance.estimator.dt)), n // 4))
    response = encoder_response(balance)[1]
    reach = response.size - 1
    power = np.correlate(response, response, "full")[reach:] / float(response @ response)
    encoder = np.r_[power, np.zeros(lags)][: lags + 1]
    memory = min(n // 4, 10 * lags)
    own, force = (_correlation(s, s, memory)[memory:] for s in (balance.residual, balance.target))
    cross_variance = (1 + 2 * float(np.sum(own[1:] * force[1:]))) / n
    own_variance = (1 + 2 * float(np.sum(power[1:] ** 2))) / n
    cross = _correlation(balance.target, balance.residual, lags)
    return Correlations(
        own[: lags + 1], cross, encoder, float(np.sqrt(own_variance)), float(np.sqrt(max(cross_variance, 0.2 / n)))
    )


def _correlation(a: Floats, b: Floats, lags: int) -> Floats:
    """Correlation (2 lags + 1,) of a(k) with b(k + lag), lag = -lags ... lags; a, b: (n,)."""
    a, b = a - a.mean(), b - b.mean()
    size = 2 ** int(np.ceil(np.log2(a.size + lags + 1)))
    cross = np.fft.irfft(np.fft.rfft(a, size).conj() * np.fft.rfft(b, size), size)
    power = max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-300)
    return np.asarray(np.r_[cross[-lags:], cross[: lags + 1]] / power)

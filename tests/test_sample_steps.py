"""Records with uneven steps, for which every method uses the time since the last sample."""

from __future__ import annotations

import numpy as np
import pytest

from pmfid import BCRLS, IV, RIV, RLS, Drive, Encoder, MotionFit
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, quantize, simulate_drive
from pmfid.status import Status
from pmfid.types import Counts, Floats
from tests.conftest import TRUTH

#: Parts of a period in the simulation, and samples.
PARTS, SAMPLES = 50, 1500


def jittered(spread: float, seed: int = 3) -> tuple[Floats, Counts, Floats]:
    """Return input, counts and steps of the cart, sampled at the instants of a polling host."""
    rng = np.random.default_rng(seed)
    parts = np.rint(PARTS * rng.uniform(1 - spread, 1 + spread, SAMPLES)).astype(int)
    u = prbs(SAMPLES, clock=8, amplitude=4.0, rng=rng)
    x = simulate_drive(CART, np.repeat(u, parts), CART_DT / PARTS).x[np.r_[0, np.cumsum(parts)[:-1]]]
    return u, quantize(x, CART_RESOLUTION), np.r_[PARTS, parts[:-1]] * CART_DT / PARTS


def arguments() -> tuple[Drive, Encoder, float, float]:
    return Drive(CART.input_gain), Encoder(CART_RESOLUTION), CART_DT, 20.0


@pytest.mark.parametrize("method", [IV, MotionFit])
def test_off_line_methods_that_simulate_are_exact(method: type[IV | MotionFit]) -> None:
    u, counts, steps = jittered(0.5)
    fit = method(*arguments(), steps=steps).fit(u, counts)
    np.testing.assert_allclose(fit.theta, TRUTH, rtol=1e-3)
    assert np.all(np.abs(fit.theta - TRUTH) < 4 * fit.theta_std)
    with np.testing.assert_raises(AssertionError):  # an even clock with the same mean gives another record
        np.testing.assert_allclose(method(*arguments()).fit(u, counts).theta, TRUTH, rtol=1e-3)


@pytest.mark.parametrize(("method", "within"), [(RIV, 2e-3), (BCRLS, 0.05), (RLS, 0.05)])
def test_on_line_methods_take_the_step_that_was(method: type[RecursiveEstimator], within: float) -> None:
    u, counts, steps = jittered(0.5)
    estimator = method(*arguments(), steps="given")
    track = estimator.run(u, counts, steps)
    np.testing.assert_allclose(track.theta[-1], TRUTH, rtol=within)
    one = estimator.start()
    for sample in zip(u[:200], counts[:200].tolist(), steps[:200], strict=True):
        estimate = one.step(*sample)
    np.testing.assert_array_equal(estimate.theta, track.theta[199])


def test_samples_of_a_burst_count_as_the_time_that_they_stand_for() -> None:
    """The record has each sample of the second half four times at nearly the same instant. Repeats add no
    information.
    """
    u, counts, _ = jittered(0.0)
    resolution, half = 8 * CART_RESOLUTION, SAMPLES // 2
    often = np.r_[np.ones(half, int), np.full(SAMPLES - half, 4)]
    after = np.r_[np.ones(half), np.tile([1e-5, 1e-5, 1e-5, 1 - 3e-5], SAMPLES - half)] * CART_DT
    setup = Drive(CART.input_gain), Encoder(resolution), CART_DT, 20.0
    even = IV(*setup).fit(u, counts // 8)
    fit = IV(*setup, steps=np.r_[CART_DT, after[:-1]]).fit(np.repeat(u, often), np.repeat(counts // 8, often))
    np.testing.assert_array_less(np.abs(fit.theta - even.theta), 0.1 * even.theta_std)


@pytest.mark.parametrize("wrong", [0.0, -0.01, np.nan, np.inf, 1e9])
def test_a_step_that_cannot_be_is_flagged(wrong: float) -> None:
    estimator = RLS(*arguments(), steps="given")
    u, counts, steps = jittered(0.2)
    estimator.run(u[:500], counts[:500], steps[:500])
    estimate = estimator.step(1.0, int(counts[500]), wrong)
    assert estimate.status & Status.INVALID_INPUT
    assert np.all(np.isfinite(estimate.theta))

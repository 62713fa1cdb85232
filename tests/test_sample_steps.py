"""Records with uneven steps, for which every method uses the time since the last sample."""

from __future__ import annotations

import numpy as np
import pytest

from pmfid import BCRLS, IV, RIV, RLS, Drive, Encoder, Fleet, MotionFit, TransferFunction
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, quantize, simulate_drive
from pmfid.status import Status
from pmfid.types import Counts, Floats
from tests.refusals import refused

#: Parts of a period in the simulation, and samples.
PARTS, SAMPLES = 50, 1500
TRUTH = np.array([CART.mass, CART.viscous_friction, CART.coulomb_friction])


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


@pytest.mark.parametrize("method", [RIV, BCRLS, RLS])
def test_even_steps_are_nearly_an_even_clock(method: type[RecursiveEstimator]) -> None:
    """With steps, the direction is corrected for reversals inside an interval."""
    u, counts, _ = jittered(0.0)
    encoder = Encoder(CART_RESOLUTION, guard=False)
    even = method(Drive(CART.input_gain), encoder, CART_DT, 20.0).run(u, counts)
    given = method(Drive(CART.input_gain), encoder, CART_DT, 20.0, steps="given")
    track = given.run(u, counts, np.full(u.size, CART_DT))
    np.testing.assert_allclose(track.theta[600:], even.theta[600:], rtol=0.01)
    np.testing.assert_array_equal(track.status[600:], even.status[600:])


@pytest.mark.parametrize("method", [BCRLS, RLS])
def test_direct_methods_stand_bursts_and_say_so(method: type[RecursiveEstimator]) -> None:
    """The second difference is weighted by the mean square of the step over time, and reversals keep their place."""
    parts = np.tile([2, 2, 2, 14], SAMPLES // 4)
    u = prbs(SAMPLES, clock=8, amplitude=4.0, rng=np.random.default_rng(3))
    x = simulate_drive(CART, np.repeat(u, parts), CART_DT / 5).x[np.r_[0, np.cumsum(parts)[:-1]]]
    steps = np.r_[5, parts[:-1]] * CART_DT / 5
    track = method(*arguments(), steps="given").run(u, quantize(x, CART_RESOLUTION), steps)
    np.testing.assert_allclose(track.theta[-1], TRUTH, rtol=0.1)
    assert track.status[-1] & Status.UNMODELLED


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


def test_what_takes_no_steps_says_so() -> None:
    u, counts, steps = jittered(0.2)
    late, encoder = Drive(CART.input_gain, dead_time=0.01), Encoder(CART_RESOLUTION)
    refused(
        ("resample", lambda: RIV(late, encoder, CART_DT, 20.0, steps="given")),
        ("Experiment", lambda: RLS(TransferFunction(2, 0), Encoder(1e-3), 0.01, 5.0, steps="given")),
        ("evenly spaced samples", lambda: RLS(*arguments(), discretization="paper", steps="given")),
        ("run each axis on its own", lambda: Fleet(RLS(*arguments(), steps="given"), 3)),
        ("positive", lambda: IV(*arguments(), steps=np.zeros(5))),
        ("give one step for each sample", lambda: IV(*arguments(), steps=steps[1:]).fit(u, counts)),
        ("steps", lambda: RLS(*arguments(), steps="given").run(u, counts)),
        ("steps", lambda: RLS(*arguments()).run(u, counts, steps)),
    )

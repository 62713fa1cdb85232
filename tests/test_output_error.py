"""Output error and interval likelihood: right estimates, better than the filtered methods; bad data are reported."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

import pmfid
from pmfid import _kernel64
from pmfid.estimators.likelihood import cost, expected_information
from pmfid.estimators.output_error import OE, IntervalML
from pmfid.simulation import control_machine, stop_and_go
from pmfid.simulation.drive import DriveParameters, Machine, quantize, simulate_drive
from pmfid.simulation.scenarios import CART, CART_DT, make_scenario, resolution_of
from pmfid.status import Status
from tests.conftest import TRUTH, Run, cart_run

CUTOFF = 20.0
SEEDS = 20
SAMPLES = 2000
START = {"mass": 1.0, "viscous_friction": 10.0, "coulomb_friction": 1.0}
METHODS = {"iv": pmfid.IV, "oe": OE, "interval": IntervalML}


def fitted(cls, drive, run: Run, **options) -> pmfid.Fit:
    return cls(drive, run.encoder, CART_DT, CUTOFF, **options).fit(run.u, run.counts)


def scenario_run(name: str, increments: int, seed: int = 0) -> Run:
    scenario = make_scenario(name, seed=seed, increments=increments, duration=15.0)
    return Run(scenario.motion.u, scenario.counts, pmfid.Encoder(scenario.resolution))


@cache
def relative_errors(method: str, increments: int) -> NDArray[np.float64]:
    """Return the relative errors (SEEDS, 3) under the PRBS."""
    drive = pmfid.Drive(CART.input_gain)
    runs = (cart_run(seed, increments=increments, samples=SAMPLES) for seed in range(SEEDS))
    return np.array([fitted(METHODS[method], drive, run).theta / TRUTH - 1 for run in runs])


def mass_std(method: str, increments: int) -> float:
    return float(np.std(relative_errors(method, increments)[:, 0], ddof=1))


@cache
def white_noise_bound(increments: int) -> float:
    """Return the relative Cramer-Rao bound of the mass, mean over the seeds, for white noise of variance
    resolution^2/12.
    """

    def position(q):
        velocity, *_ = _kernel64.simulate((q[0], q[1], q[1], q[2], q[2], 0.0, 0.0), CART.input_gain, CART_DT, u, q[4])
        return q[3] + np.r_[0.0, np.cumsum(velocity[:-1])] * CART_DT

    variances, steps = [], np.diag(1e-4 * np.r_[TRUTH, 0.01, 0.01])
    for seed in range(SEEDS):
        u, q = cart_run(seed, increments=increments, samples=SAMPLES).u, np.r_[TRUTH, 0.0, 0.0]
        jacobian = np.array([(position(q + step) - position(q - step)) / (2 * step.sum()) for step in steps])
        variances.append(np.linalg.inv(jacobian @ jacobian.T)[0, 0] * resolution_of(increments) ** 2 / 12)
    return math.sqrt(np.mean(variances)) / CART.mass


@pytest.mark.parametrize("cls", [OE, IntervalML])
@pytest.mark.parametrize("drift_cutoff", [None, 0.0, 5.0])
def test_a_fine_encoder_gives_the_truth(cls, drift_cutoff, drive):
    for run in (cart_run(1, increments=None), scenario_run("stop-and-go", 2**24)):
        fit = fitted(cls, drive, run, drift_cutoff=drift_cutoff)
        np.testing.assert_allclose(fit.theta, TRUTH, rtol=1e-4)
        assert fit.relative_error < 1e-5
        assert fit.samples == fit.residual.size == run.u.size


@pytest.mark.parametrize("cls", [OE, IntervalML])
@pytest.mark.parametrize("offset", [0.0, 0.15])
def test_directional_friction_and_offset(cls, offset):
    """The offset appears as half the difference of the directional Coulomb frictions."""
    rng = np.random.default_rng(3)
    u = np.repeat(rng.uniform(-3, 3, 300), 10)
    motion = simulate_drive(DriveParameters(1.07, 12.8, 0.8, 2.0, offset=offset), u, CART_DT, v0=0.2)
    run = Run(u, quantize(motion.x, 1e-6), pmfid.Encoder(1e-6))
    fit = fitted(cls, pmfid.Drive(2.0, friction="directional"), run)
    np.testing.assert_allclose(fit.theta, [1.07, 12.8, 12.8, 0.8 + offset, 0.8 - offset], rtol=1e-3)
    fit = fitted(cls, pmfid.Drive(2.0, offset=True), run)
    np.testing.assert_allclose(fit.theta, [1.07, 12.8, 0.8, offset], rtol=1e-3, atol=1e-3)
    assert fit.units == ("kg", "N s/m", "N", "N")


@pytest.mark.long
def test_output_error_is_no_worse_than_instrumental_variables():
    assert mass_std("oe", 256) <= 1.1 * mass_std("iv", 256)


@pytest.mark.parametrize("increments", [128])
@pytest.mark.long
def test_the_likelihood_of_the_counts_beats_every_method_for_white_noise(increments):
    """The deviation is even half of the bound for white noise, because counts carry more information than the model."""
    iv, oe, interval = (mass_std(method, increments) for method in METHODS)
    bound = white_noise_bound(increments)
    text = f"std of the mass: IV {iv:.2e}, OE {oe:.2e}, interval {interval:.2e}, white-noise bound {bound:.2e}"
    print(increments, "increments,", text)
    assert interval < 0.5 * bound, text
    assert interval < 0.5 * oe, text
    assert oe < iv, text
    assert oe == pytest.approx(bound, rel=0.5), text


@pytest.mark.long
@pytest.mark.parametrize("method", ["oe", "interval"])
def test_no_bias_beyond_chance(method):
    errors = relative_errors(method, 128)
    assert np.all(np.abs(errors.mean(axis=0)) < 3.5 * errors.std(axis=0, ddof=1) / math.sqrt(SEEDS))


@pytest.mark.parametrize(("cls", "method", "low", "high"), [(OE, "oe", 0.5, 2.0), (IntervalML, "interval", 0.7, 3.0)])
@pytest.mark.long
def test_reported_deviations_are_those_over_the_seeds(cls, method, low, high, drive):
    """The likelihood's deviations are conservative: counts have more information than the least noise assumes."""
    fit = fitted(cls, drive, cart_run(5, increments=128, samples=SAMPLES))
    ratio = fit.theta_std / TRUTH / np.std(relative_errors(method, 128), axis=0, ddof=1)
    assert np.all((low < ratio) & (ratio < high)), ratio


def test_closed_loop_with_stiction_at_64_increments(drive):
    """The record has 20 dwells and reversals under position control, with counts of 1.5 mm."""
    run = scenario_run("stop-and-go", 64)
    np.testing.assert_allclose(fitted(OE, drive, run).theta, TRUTH, rtol=0.02)
    np.testing.assert_allclose(fitted(IntervalML, drive, run).theta, TRUTH, rtol=0.003)


def drifting_run(seed: int) -> Run:
    """Simulate friction that drifts by some hundredths of a newton, which no model includes."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-3.0, 3.0], 200), 10)
    wander = np.cumsum(rng.normal(0.0, 0.001, u.size))
    motion = simulate_drive(CART, u + wander / CART.input_gain, CART_DT)
    return Run(u, quantize(motion.x, resolution_of(1024)), pmfid.Encoder(resolution_of(1024)))


def test_drift_is_kept_out_by_the_high_pass(drive):
    """Over ten runs, the high-pass reduces the error of the estimate to a third, and to within the reported
    deviations.
    """
    errors, reported = {None: [], 0.0: []}, []
    for seed in range(10):
        for drift_cutoff, found in errors.items():
            fit = fitted(OE, drive, drifting_run(seed), drift_cutoff=drift_cutoff)
            found.append(fit.theta - TRUTH)
            reported += [fit.theta_std] if drift_cutoff is None else []
    chosen, position = (np.sqrt(np.mean(np.square(found), axis=0)) for found in errors.values())
    print(chosen / TRUTH, position / TRUTH, np.median(reported, axis=0) / TRUTH)
    assert np.all(chosen < position / 3)
    assert np.all(chosen < 2 * np.median(reported, axis=0))


@pytest.mark.parametrize("drift_cutoff", [None, 0.0, 5.0])
def test_the_likelihood_steps_back_where_there_is_drift(drift_cutoff, drive):
    squares, interval = (fitted(cls, drive, drifting_run(0), drift_cutoff=drift_cutoff) for cls in (OE, IntervalML))
    np.testing.assert_array_equal(interval.theta, squares.theta)
    np.testing.assert_array_equal(interval.theta_cov, squares.theta_cov)
    assert interval.status == squares.status | Status.FALLBACK


@pytest.mark.parametrize("cls", [OE, IntervalML])
def test_a_wrapping_counter_and_a_second_fit_change_nothing(cls, drive):
    run = cart_run(2, increments=256)
    before = run.u.copy(), run.counts.copy()
    fit = fitted(cls, drive, run)
    wrapped = Run(run.u, run.counts % 64, pmfid.Encoder(run.encoder.resolution, bits=6))
    np.testing.assert_allclose(fitted(cls, drive, wrapped).theta, fit.theta, rtol=1e-6)
    np.testing.assert_array_equal(fitted(cls, drive, run).theta, fit.theta)
    np.testing.assert_array_equal(before, (run.u, run.counts))


@pytest.mark.parametrize("cls", [OE, IntervalML])
def test_a_gap_in_the_input_and_a_jump_of_the_counts_are_flagged(cls, drive):
    run = cart_run(2, increments=256)
    run.u[500] = np.nan
    fit = fitted(cls, drive, run)
    assert fit.status & Status.INVALID_INPUT
    np.testing.assert_allclose(fit.theta, TRUTH, rtol=0.1)
    run = cart_run(2, increments=256)
    run.counts[1000:] += 5000
    jumped = Run(run.u, run.counts, pmfid.Encoder(run.encoder.resolution, max_speed=1.0))
    fit = fitted(cls, drive, jumped)
    assert fit.status & Status.COUNT_JUMP
    np.testing.assert_allclose(fit.theta, TRUTH, rtol=0.1)


@pytest.mark.parametrize("cls", [OE, IntervalML])
def test_a_start_from_far_away_comes_to_the_same(cls, drive):
    run = cart_run(2, increments=256)
    far = {"mass": 5.0, "viscous_friction": 30.0, "coulomb_friction": 0.0}
    np.testing.assert_allclose(fitted(cls, drive, run, initial=far).theta, fitted(cls, drive, run).theta, rtol=1e-5)


def bad_runs() -> dict[str, Run]:
    run, rng = cart_run(1, increments=256), np.random.default_rng(0)
    n, encoder = run.u.size, run.encoder
    cruise = np.floor(np.arange(n) * 0.35 * CART_DT / encoder.resolution).astype(int)
    return {
        "still": Run(run.u, 0 * run.counts, encoder),
        "no input": Run(0 * run.u, run.counts, encoder),
        "wrong sign": Run(-run.u, run.counts, encoder),
        "short": Run(run.u[:30], run.counts[:30], encoder),
        "empty": Run(run.u[:0], run.counts[:0], encoder),
        "noise": Run(run.u, rng.integers(-50, 50, n), encoder),
        "foreign walk": Run(run.u, np.cumsum(rng.integers(-5, 6, n)), encoder),
        "one speed": Run(np.full(n, 3.0), cruise, encoder),
        "lost counts": Run(run.u, run.counts + 5000 * (np.arange(n) > 1000), encoder),
    }


@pytest.mark.parametrize(("cls", "initial"), [(OE, None), (OE, START), (IntervalML, None)])
@pytest.mark.parametrize("kind", bad_runs())
def test_bad_records_are_refused(cls, initial, kind, drive):
    with pytest.raises(pmfid.NotIdentifiableError, match=r"[;:] "):
        fitted(cls, drive, bad_runs()[kind], initial=initial)


@pytest.mark.parametrize("drift_cutoff", [-1.0, 201.0, math.nan, math.inf])
def test_wrong_drift_cutoff(drift_cutoff, drive):
    with pytest.raises(pmfid.UsageError, match="0 to 2/dt = 200"):
        OE(drive, pmfid.Encoder(1e-5), CART_DT, CUTOFF, drift_cutoff=drift_cutoff)


def test_arrays_that_do_not_fit_each_other(drive):
    with pytest.raises(pmfid.UsageError, match="same length"):
        OE(drive, pmfid.Encoder(1e-5), CART_DT, CUTOFF).fit(np.zeros(3), np.zeros(4, int))


@pytest.mark.parametrize("noise", [0.02, 0.3, 5.0])
def test_derivatives_of_the_likelihood(noise):
    e, h = np.array([-3.0, -0.55, -0.4999, -0.1, 0.2, 0.48, 0.51, 0.7, 6.0]), 1e-5 * noise
    for x in e:
        (up, slope_up, _), (down, slope_down, _) = (cost(np.array([x + sign * h]), noise) for sign in (1, -1))
        _, slope, curvature = cost(np.array([x]), noise)
        assert slope[0] == pytest.approx((up - down) / (2 * h), rel=1e-5, abs=1e-7)
        assert curvature[0] == pytest.approx((slope_up[0] - slope_down[0]) / (2 * h), rel=1e-4, abs=1e-4)


def test_likelihood_far_outside_and_information_of_white_noise():
    """At a distance of 1000 counts the likelihood is that of the normal density. Large noise hides the edges of the
    counts.
    """
    negative, slope, curvature = cost(np.array([1e3]), 0.02)
    assert negative == pytest.approx(0.5 * ((1e3 - 0.5) / 0.02) ** 2, rel=1e-7)
    assert slope[0] == pytest.approx((1e3 - 0.5) / 0.02**2, rel=1e-6)
    assert curvature[0] >= 0
    phases = np.linspace(-0.5, 0.5, 101)
    for noise in (1.0, 2.9, 3.1):
        np.testing.assert_allclose(expected_information(phases, noise), 1 / (noise**2 + 1 / 12), rtol=1e-3)
    assert np.mean(expected_information(phases, 0.02)) > 5 * 12


def test_a_spring_is_found_where_the_counts_alone_make_the_motion_unstable() -> None:
    """Least squares of the counts gives a negative stiffness here, and instrumental variables do not converge."""
    machine = Machine(DriveParameters(1.7, 1.0, 4.4, 0.12), stiffness=0.2)
    reference = stop_and_go(2500, 0.01, 3.9, 1.2, 0.6)
    run = control_machine(machine, reference, 0.01, 0.013, kp=900.0, kd=160.0, u_max=200.0, phase=0.004, steps=10)
    model, encoder = pmfid.Drive(0.12, spring=True, offset=True), pmfid.Encoder(0.013)
    with pytest.raises(pmfid.NotIdentifiableError):
        pmfid.IV(model, encoder, 0.01, 1.0).fit(run.u, run.counts)
    fit = IntervalML(model, encoder, 0.01, 1.0).fit(run.u, run.counts)
    assert abs(fit["stiffness"] - 0.2) < 4 * fit.theta_std[-1] < 0.1

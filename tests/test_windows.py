"""Output error over windows: right parameters and bars for a right model, longer predictions for a wrong one."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import pmfid
from pmfid.estimators.motion import Difference, rms
from pmfid.estimators.output_error import OE
from pmfid.estimators.search import Windows, choose_start, choose_window, descend, fit_start, free_run, start_samples
from pmfid.simulation import DriveParameters, Machine, drive_machine, prbs, quantize, simulate_drive
from tests.conftest import Run, cart_run

#: An axis that only this file uses.
AXIS = DriveParameters(mass=3.2, viscous_friction=21.0, coulomb_friction=2.6, input_gain=5.0)
KNOWN = np.array([AXIS.mass, AXIS.viscous_friction, AXIS.coulomb_friction])
DT, CUTOFF, STEP = 0.004, 60.0, 1e-4


def moved(seed: int, step: float = STEP, samples: int = 2500, machine: Machine | None = None) -> Run:
    rng = np.random.default_rng([seed, 31])
    u = (
        prbs(samples, clock=18, amplitude=2.5, rng=rng)
        * np.repeat(rng.uniform(0.5, 1.0, samples // 100 + 1), 100)[:samples]
    )
    if machine is not None:
        return Run(u, drive_machine(machine, u, DT, step, phase=step * rng.random()).counts, pmfid.Encoder(step))
    return Run(u, quantize(simulate_drive(AXIS, u, DT).x, step, phase=step * rng.random()), pmfid.Encoder(step))


def method(run: Run, **options: object) -> OE:
    return OE(pmfid.Drive(AXIS.input_gain), run.encoder, DT, CUTOFF, **options)


def prepared(run: Run) -> tuple[Difference, np.ndarray]:
    """Return the difference without a high-pass, and scaled start parameters with an error of a tenth."""
    difference, q = method(run)._prepare_difference(1.1 * KNOWN, run.u, method(run).position(run.counts))
    return replace(difference, pole=0.0), q[:3]


@pytest.mark.parametrize("window", [0.4, 1.3, 100.0, "auto"])
def test_a_fine_encoder_gives_the_truth(window: float | str) -> None:
    run = moved(1, step=1e-9, samples=800)
    fit = method(run, window=window).fit(run.u, run.counts)
    np.testing.assert_allclose(fit.theta, KNOWN, rtol=1e-4)
    assert fit.samples == fit.residual.size == run.u.size
    assert rms(fit.residual) < 1e-7


@cache
def off_by(window: float | str) -> np.ndarray:
    """Return the ratios (runs, 3) of errors to bars, for coarse and fine encoders."""
    found = []
    for seed in range(8):
        run = moved(100 + seed, step=(3e-4, 4e-5)[seed % 2], samples=1200)
        fit = method(run, window=window).fit(run.u, run.counts)
        found.append((fit.theta - KNOWN) / fit.theta_std)
    return np.array(found)


@pytest.mark.parametrize("window", [pytest.param(0.5, marks=pytest.mark.long), 2.0])
def test_bars_hold_where_the_model_is_right(window: float) -> None:
    z = np.abs(off_by(window))
    assert np.mean(z < 2) > 0.85, z
    assert np.max(z) < 4, z
    assert np.mean(z) > 0.2, z  # the error bars are also not too wide


def test_without_a_window_nothing_is_new() -> None:
    """The default of `window` changes no bit, and a window over the whole record has the start of `OE`."""
    run = moved(3)
    plain, whole = (method(run, **options).fit(run.u, run.counts) for options in ({}, {"window": 1e3}))
    assert plain.notes == whole.notes == ()
    np.testing.assert_allclose(whole.theta, plain.theta, rtol=1e-6)
    np.testing.assert_allclose(whole.theta_std, plain.theta_std, rtol=0.3)


def test_a_window_starts_where_the_motion_is() -> None:
    """The axis brakes hard with a force near zero. A search from a start within stiction would never find the
    velocity.
    """
    run = moved(4, step=2e-3)
    difference, theta = prepared(run)
    theta = KNOWN / difference.scale[:3]
    windows = Windows.cover_stretches(difference, [(0, run.u.size)], 100)
    q = windows.start_windows(theta, CUTOFF)
    assert rms(windows(q)) < 0.5  # counts
    for part, own in windows.split_windows(q):
        assert rms(part(own)) < 0.8


def test_windows_cover_the_record_and_stay_within_stretches() -> None:
    difference, _ = prepared(moved(5, samples=1000))
    windows = Windows.cover_stretches(difference, [(0, 300), (700, 1000)], 90)
    covered = windows.sum_by_sample(np.ones(sum(part.y.size for part in windows.pieces)))
    assert np.all(covered[:300] >= 1)
    assert np.all(covered[300:700] == 0)
    assert np.all(covered[700:] >= 1)
    assert covered.max() <= 3


def test_descent_ends_at_the_least_squares() -> None:
    """No change of a parameter or of a start lowers the sum of squares."""
    run = moved(6, samples=800)
    difference, theta = prepared(run)
    windows = Windows.cover_stretches(difference, [(0, 800)], 200)
    q = descend(windows, windows.start_windows(theta, CUTOFF))
    here = rms(windows(q))
    for step in 1e-3 * np.eye(q.size):
        assert min(rms(windows(q + step)), rms(windows(q - step))) > here * (1 - 1e-6)


def test_a_free_run_reads_nothing_after_its_start() -> None:
    run = moved(7)
    difference, theta = prepared(run)
    read = start_samples(DT, CUTOFF)
    before = difference.y - free_run(difference, theta, CUTOFF) * difference.resolution
    spoilt = replace(difference, y=np.r_[difference.y[:read], np.zeros(difference.y.size - read)])
    after = spoilt.y - free_run(spoilt, theta, CUTOFF) * difference.resolution
    np.testing.assert_allclose(after, before, atol=1e-12)


def test_a_moving_start_is_found() -> None:
    run = moved(8)
    difference, _ = prepared(run)
    part = difference.part(777, 1500)
    theta = KNOWN / difference.scale[:3]
    start = fit_start(part.part(0, 21), choose_start(part.part(0, 21), theta, CUTOFF))
    speed = simulate_drive(AXIS, run.u, DT).v[777]
    assert start[-1] * difference.scale[-1] == pytest.approx(speed, abs=3e-3)


def test_windows_predict_longer_where_friction_is_richer() -> None:
    """The machine has unmodelled Stribeck and quadratic friction. On average over unused records, the chosen windows
    predict better than the force balance of `iv`."""
    machine = Machine(AXIS, stribeck=1.2, stribeck_speed=0.03, quadratic=25.0)
    gains = []
    for seed in range(2):
        train, test = (moved(first + seed, samples=1200, machine=machine) for first in (200, 300))
        errors = []
        for estimator in (method(train, window="auto"), pmfid.IV(pmfid.Drive(5.0), train.encoder, DT, CUTOFF)):
            fit = estimator.fit(train.u, train.counts)
            other, _ = prepared(test)
            errors.append(rms(free_run(other, fit.theta / other.scale[:3], CUTOFF)))
        gains.append(np.log(errors[1] / errors[0]))
    assert np.mean(gains) > 0.05, gains


def test_the_choice_says_what_it_found() -> None:
    run = moved(9, machine=Machine(AXIS, quadratic=40.0), samples=900)
    fit = method(run, window="auto").fit(run.u, run.counts)
    (note,) = fit.notes
    assert "chosen on this record" in note
    difference, theta = prepared(run)
    choice = choose_window(difference, theta, CUTOFF)
    assert choice.errors[choice.seconds] <= 1.05 * min(choice.errors.values())
    assert all(
        choice.errors[longer] > 1.05 * min(choice.errors.values())
        for longer in choice.errors
        if longer > choice.seconds
    )


@pytest.mark.long
def test_windows_so_long_that_the_motion_is_lost_are_not_chosen() -> None:
    """A symmetric model of directional friction drifts away and does not fit the whole record."""
    run = moved(11, machine=Machine(AXIS, asymmetry=0.2), samples=1500)
    with pytest.raises(pmfid.NotIdentifiableError, match="does not follow"):
        method(run, window=1e3).fit(run.u, run.counts)
    fit = method(run, window="auto").fit(run.u, run.counts)
    assert fit.notes[0].startswith("windows of")
    assert fit.relative_error < 0.5


def test_too_short_a_record_has_one_window() -> None:
    run = moved(10, samples=150)
    fit = method(run, window="auto").fit(run.u, run.counts)
    assert fit.notes[0].startswith("one window over the whole record")


@pytest.mark.parametrize("window", [0.0, -1.0, 0.01, np.nan, np.inf, "long", True, None])
def test_wrong_windows(window: object) -> None:
    if window is None:
        with pytest.raises(pmfid.UsageError, match="drift_cutoff"):
            method(moved(1), window=1.0, drift_cutoff=2.0)
        return
    with pytest.raises(pmfid.UsageError, match=r"at least .* \(40 samples\)"):
        method(moved(1), window=window)


def test_a_transfer_function_has_no_windows() -> None:
    with pytest.raises(pmfid.UsageError, match="transfer function"):
        OE(pmfid.TransferFunction(1, 0), pmfid.Encoder(1e-4), DT, CUTOFF, window=1.0)
    with pytest.raises(pmfid.UsageError, match="window"):
        pmfid.identify(np.ones(50), np.ones(50), model=pmfid.TransferFunction(1, 0), dt=DT, cutoff=5.0, window=1.0)


def test_identify_takes_windows_and_says_where_they_are_not_used() -> None:
    run = cart_run(3, samples=1500)
    settings = {"model": pmfid.Drive(2.0), "encoder": run.encoder, "dt": 0.01, "cutoff": 20.0, "window": 3.0}
    found = pmfid.identify(run.u, run.counts, method="output-error", **settings)
    np.testing.assert_allclose(found.theta, [1.07, 12.8, 0.8], rtol=0.01)
    other = pmfid.identify(run.u, run.counts, method="ls", **settings)
    assert any("does not use window" in note for note in other.notes)


@pytest.mark.parametrize("bad", [np.zeros(400, int), np.arange(400)])
def test_records_that_say_nothing_are_refused(bad: np.ndarray) -> None:
    with pytest.raises(pmfid.NotIdentifiableError):
        method(moved(1), window=0.5).fit(np.ones(400), bad)

"""What every estimator owes: all that exist are found, and run through every check."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from itertools import pairwise

import numpy as np
import pytest

import pmfid
from pmfid import Status, estimators
from pmfid.estimators.base import Estimator
from pmfid.estimators.batch import BatchEstimator
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.registry import ESTIMATORS
from tests.conftest import TRUTH, assert_near, cart_run

DT, CUTOFF = 0.01, 100 / 3
DRIVE = [cls for cls in ESTIMATORS.values() if not cls.process_only]
BATCH = [cls for cls in DRIVE if issubclass(cls, BatchEstimator)]
RECURSIVE = [cls for cls in DRIVE if issubclass(cls, RecursiveEstimator)]


def concrete() -> set[type[Estimator]]:
    """Every class below `Estimator` that has a method's name, wherever in the room it is defined."""
    found = set()
    for module in pkgutil.iter_modules(estimators.__path__, "pmfid.estimators."):
        for _, cls in inspect.getmembers(importlib.import_module(module.name), inspect.isclass):
            if issubclass(cls, Estimator) and cls.__module__.startswith("pmfid") and cls.method:
                found.add(cls)
    return found


def test_no_estimator_hides():
    assert concrete() == set(ESTIMATORS.values())
    assert set(BATCH) | set(RECURSIVE) == set(DRIVE)
    assert set(estimators.METHODS) == {"auto", *ESTIMATORS}


def final(cls, drive, run, **options):
    """The estimate at the end of a run, and the estimator."""
    estimator = cls(drive, run.encoder, DT, CUTOFF, **options)
    if isinstance(estimator, BatchEstimator):
        return estimator.fit(run.u, run.counts).theta, estimator
    return estimator.run(run.u, run.counts).theta[-1], estimator


@pytest.mark.parametrize("cls", DRIVE)
def test_finds_the_truth(cls, drive):
    theta, estimator = final(cls, drive, cart_run(1, increments=1024))
    assert_near(theta, TRUTH, [0.005, 0.01, 0.05])
    assert estimator.names == ("mass", "viscous_friction", "coulomb_friction")


@pytest.mark.parametrize("cls", DRIVE)
def test_inputs_stay_untouched_and_lists_will_do(cls, drive):
    run = cart_run(2, samples=1500)
    u, counts = run.u.copy(), run.counts.copy()
    theta, _ = final(cls, drive, run)
    assert np.array_equal(u, run.u)
    assert np.array_equal(counts, run.counts)
    estimator = cls(drive, run.encoder, DT, CUTOFF)
    call = estimator.fit if isinstance(estimator, BatchEstimator) else estimator.run
    again = call(u.tolist(), counts.astype(np.int32).tolist()).theta
    assert np.array_equal(np.atleast_2d(again)[-1], theta)


@pytest.mark.parametrize("cls", DRIVE)
def test_scales_with_the_units(cls, drive):
    """Position in mm and force in mN: the parameters of the equation do not change."""
    run = cart_run(3, samples=2000)
    theta, _ = final(cls, drive, run)
    thousand = cls(pmfid.Drive(2000.0), pmfid.Encoder(1000 * run.encoder.resolution), DT, CUTOFF)
    call = thousand.fit if isinstance(thousand, BatchEstimator) else thousand.run
    scaled = np.atleast_2d(call(run.u, run.counts).theta)[-1]
    np.testing.assert_allclose(scaled, theta * [1, 1, 1000], rtol=1e-4)


@pytest.mark.parametrize("cls", DRIVE)
def test_mirror_image(cls, drive):
    """Input and encoder reversed: the same parameters, up to the encoder's floor."""
    run = cart_run(4, samples=2000, increments=None)
    theta, _ = final(cls, drive, run)
    mirrored = cls(drive, run.encoder, DT, CUTOFF)
    call = mirrored.fit if isinstance(mirrored, BatchEstimator) else mirrored.run
    np.testing.assert_allclose(np.atleast_2d(call(-run.u, -run.counts).theta)[-1], theta, rtol=1e-3)


@pytest.mark.parametrize("cls", DRIVE)
def test_more_data_shorter_error_bars(cls, drive):
    bars = []
    for samples in (1000, 4000):
        run = cart_run(5, samples=samples, increments=512)
        estimator = cls(drive, run.encoder, DT, CUTOFF)
        if isinstance(estimator, BatchEstimator):
            bars.append(estimator.fit(run.u, run.counts).theta_std[0])
        else:
            bars.append(estimator.run(run.u, run.counts).theta_std[-1, 0])
    assert all(long < short for short, long in pairwise(bars))


@pytest.mark.parametrize("cls", BATCH)
def test_batch_without_motion_says_so(cls, drive):
    with pytest.raises(pmfid.NotIdentifiableError, match="does not move"):
        cls(drive, pmfid.Encoder(1e-5), DT, CUTOFF).fit(np.ones(2000), np.zeros(2000, int))


@pytest.mark.parametrize("cls", BATCH)
def test_batch_covariance_is_symmetric_and_positive(cls, drive):
    run = cart_run(6, samples=2000, increments=512)
    fit = cls(drive, run.encoder, DT, CUTOFF).fit(run.u, run.counts)
    np.testing.assert_allclose(fit.theta_cov, fit.theta_cov.T, rtol=1e-9)
    assert np.all(np.linalg.eigvalsh(fit.theta_cov / np.outer(fit.theta_std, fit.theta_std)) > 0)
    assert 0 <= fit.relative_error < 1


@pytest.mark.parametrize("cls", RECURSIVE)
@pytest.mark.parametrize("forgetting", [1.0, 0.99])
def test_split_run_and_steps_are_the_whole_run(cls, forgetting, drive):
    run = cart_run(7, samples=1200)
    whole = cls(drive, run.encoder, DT, CUTOFF, forgetting=forgetting).run(run.u, run.counts)
    parts = cls(drive, run.encoder, DT, CUTOFF, forgetting=forgetting)
    parts.run(run.u[:500], run.counts[:500])
    resumed = cls(drive, run.encoder, DT, CUTOFF, forgetting=forgetting)
    resumed.set_state(parts.get_state())
    stepped = [resumed.step(u, int(c)).theta for u, c in zip(run.u[500:], run.counts[500:], strict=True)]
    assert np.array_equal(np.array(stepped), whole.theta[500:])


@pytest.mark.parametrize("cls", RECURSIVE)
def test_float32_is_close_to_float64(cls, drive):
    run = cart_run(8, samples=2500, increments=512)
    double, single = (
        cls(drive, run.encoder, DT, CUTOFF, forgetting=0.995, precision=precision).run(run.u, run.counts)
        for precision in ("float64", "float32")
    )
    np.testing.assert_allclose(single.theta[-1], double.theta[-1], rtol=2e-3)


@pytest.mark.parametrize("cls", RECURSIVE)
def test_zero_input_reports_poor_excitation(cls, drive):
    track = cls(drive, pmfid.Encoder(1e-5), DT, CUTOFF, forgetting=0.98).run(np.zeros(3000), np.zeros(3000, int))
    assert np.all(np.isfinite(track.theta))
    assert np.all((track.flagged(Status.POOR_EXCITATION) | track.flagged(Status.STARTING))[200:])


@pytest.mark.parametrize("cls", RECURSIVE)
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_hostile_input_leaves_finite_numbers(cls, precision, drive):
    rng = np.random.default_rng(9)
    u = rng.choice([0.0, 3.0, -3.0, np.nan, np.inf, -np.inf, 1e30, -1e30, 1e-40], 20_000)
    counts = rng.integers(-(2**31), 2**31, 20_000)
    track = cls(drive, pmfid.Encoder(1e-5), DT, CUTOFF, forgetting=0.99, precision=precision).run(u, counts)
    assert np.all(np.isfinite(track.theta))
    assert not np.any(np.isnan(track.theta_std))


@pytest.mark.parametrize("cls", RECURSIVE)
def test_a_state_of_another_configuration_is_refused(cls, drive):
    here = cls(drive, pmfid.Encoder(1e-5), DT, CUTOFF)
    there = cls(drive, pmfid.Encoder(1e-5), DT, 2 * CUTOFF)
    with pytest.raises(pmfid.UsageError, match="same method"):
        there.set_state(here.get_state())


@pytest.mark.parametrize("cls", RECURSIVE)
def test_counts_must_be_integers(cls, drive):
    with pytest.raises(TypeError):
        cls(drive, pmfid.Encoder(1e-5), DT, CUTOFF).step(1.0, 7.9)

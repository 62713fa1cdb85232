"""What every estimator owes on a linear process: all that take one are found, and run through every check."""

from __future__ import annotations

import numpy as np
import pytest

import pmfid
from pmfid import Status, TransferFunction
from pmfid.estimators.batch import BatchEstimator
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.registry import ESTIMATORS, methods_for
from tests.test_transfer_function import UNDERSHOOT, build, make_record

METHODS = [ESTIMATORS[name] for name in methods_for(UNDERSHOOT.model)]
BATCH = [cls for cls in METHODS if issubclass(cls, BatchEstimator)]
RECURSIVE = [cls for cls in METHODS if issubclass(cls, RecursiveEstimator)]
NAMES = ("a0", "a1", "b0", "b1")


def options_of(cls, noise_std: float) -> dict[str, float]:
    """The output is measured as a number: its noise is not that of the encoder."""
    return {"noise_std": noise_std} if "known-step" in cls.method else {}


def final(cls, run, **options) -> np.ndarray:
    estimator = build(cls, UNDERSHOOT, run, **(options_of(cls, run.noise_std) | options))
    if isinstance(estimator, BatchEstimator):
        return estimator.fit(run.u, run.counts).theta
    return estimator.run(run.u, run.counts).theta[-1]


def test_the_methods_are_these():
    found = {cls.method for cls in METHODS}
    assert {"ls", "bcls", "known-step", "srivc", "rls", "bcrls", "rknown-step", "rsrivc"} <= found
    assert "riv" not in found


@pytest.mark.parametrize("cls", METHODS)
def test_finds_the_truth(cls):
    run = make_record(UNDERSHOOT, 1, snr=30.0)
    np.testing.assert_allclose(final(cls, run), UNDERSHOOT.truth, rtol=0.02)
    assert build(cls, UNDERSHOOT, run).names == NAMES


@pytest.mark.parametrize("cls", METHODS)
def test_inputs_stay_untouched(cls):
    run = make_record(UNDERSHOOT, 2, snr=30.0)
    u, counts = run.u.copy(), run.counts.copy()
    first = final(cls, run)
    assert np.array_equal(u, run.u)
    assert np.array_equal(counts, run.counts)
    assert np.array_equal(final(cls, run), first)


@pytest.mark.parametrize("cls", METHODS)
def test_scales_with_the_units(cls):
    """The output in a thousandth of its unit: the a stay, the b go with it."""
    run = make_record(UNDERSHOOT, 3, snr=30.0)
    thousand = type(run)(run.u, run.y, run.counts, pmfid.Encoder(1000 * run.encoder.resolution), 1000 * run.noise_std)
    np.testing.assert_allclose(final(cls, thousand), final(cls, run) * [1, 1, 1000, 1000], rtol=1e-5)


@pytest.mark.parametrize("cls", METHODS)
def test_more_data_shorter_error_bars(cls):
    run = make_record(UNDERSHOOT, 4, snr=20.0)
    bars = []
    for part in (slice(1200), slice(None)):
        estimator = build(cls, UNDERSHOOT, run, **options_of(cls, run.noise_std))
        call = estimator.fit if isinstance(estimator, BatchEstimator) else estimator.run
        bars.append(np.atleast_2d(call(run.u[part], run.counts[part]).theta_std)[-1])
    assert np.all(bars[1] < bars[0])


@pytest.mark.parametrize("cls", BATCH)
def test_batch_without_an_output_says_so(cls):
    with pytest.raises(pmfid.NotIdentifiableError):
        cls(UNDERSHOOT.model, pmfid.Encoder(1e-3), 0.1, 2.0).fit(np.ones(2000), np.zeros(2000, int))


@pytest.mark.parametrize("cls", RECURSIVE)
@pytest.mark.parametrize("forgetting", [1.0, 0.99])
def test_split_run_and_steps_are_the_whole_run(cls, forgetting):
    run = make_record(UNDERSHOOT, 5, snr=20.0)
    whole = build(cls, UNDERSHOOT, run, forgetting=forgetting).run(run.u[:1500], run.counts[:1500])
    parts = build(cls, UNDERSHOOT, run, forgetting=forgetting)
    parts.run(run.u[:700], run.counts[:700])
    resumed = build(cls, UNDERSHOOT, run, forgetting=forgetting)
    resumed.set_state(parts.get_state())
    stepped = [resumed.step(u, int(c)).theta for u, c in zip(run.u[700:1500], run.counts[700:1500], strict=True)]
    assert np.array_equal(np.array(stepped), whole.theta[700:])


@pytest.mark.parametrize("cls", RECURSIVE)
def test_float32_is_close_to_float64(cls):
    run = make_record(UNDERSHOOT, 6, snr=20.0)
    double, single = (final(cls, run, forgetting=0.998, precision=precision) for precision in ("float64", "float32"))
    np.testing.assert_allclose(single, double, rtol=2e-3)


@pytest.mark.parametrize("cls", RECURSIVE)
def test_zero_input_reports_poor_excitation(cls):
    track = cls(UNDERSHOOT.model, pmfid.Encoder(1e-3), 0.1, 2.0, forgetting=0.98).run(
        np.zeros(2000), np.zeros(2000, int)
    )
    assert np.all(np.isfinite(track.theta))
    assert np.all((track.flagged(Status.POOR_EXCITATION) | track.flagged(Status.STARTING))[200:])
    assert not np.any(track.flagged(Status.STANDSTILL)), "rest means nothing to a process"


@pytest.mark.parametrize("cls", RECURSIVE)
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_hostile_input_leaves_finite_numbers(cls, precision):
    rng = np.random.default_rng(9)
    u = rng.choice([0.0, 3.0, -3.0, np.nan, np.inf, -np.inf, 1e30, -1e30, 1e-40], 20_000)
    counts = rng.integers(-(2**31), 2**31, 20_000)
    track = cls(UNDERSHOOT.model, pmfid.Encoder(1e-5), 0.1, 2.0, forgetting=0.99, precision=precision).run(u, counts)
    assert np.all(np.isfinite(track.theta))
    assert not np.any(np.isnan(track.theta_std))


@pytest.mark.parametrize("cls", RECURSIVE)
def test_the_largest_model_of_the_kernel(cls):
    """Eight parameters: fourth order with three zeros."""
    estimator = cls(TransferFunction(4, 3), pmfid.Encoder(1e-6), 0.01, 20.0)
    assert len(estimator.step(1.0, 0).theta) == 8
    with pytest.raises(pmfid.UsageError, match="at most 8 parameters, this transfer_function has 9: a0"):
        cls(TransferFunction(5, 3), pmfid.Encoder(1e-6), 0.01, 20.0)

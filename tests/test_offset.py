"""A process far from zero with an estimated constant: a pressure about 101 325 Pa."""

from __future__ import annotations

import numpy as np
import pytest

import pmfid
from pmfid.estimators.batch import BatchEstimator
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.simulation.process import simulate_process
from pmfid.simulation.signals import prbs

Record = tuple[np.ndarray, np.ndarray]
DT, TRUTH = 0.05, (4.0, 1.2, 2.0)


def counts_about(level: float, step: float) -> tuple[np.ndarray, np.ndarray]:
    u = prbs(3000, clock=8, amplitude=1.0, rng=np.random.default_rng(3))
    return u, np.floor((simulate_process((2.0,), (1.0, 1.2, 4.0), u, DT) + level) / step).astype(np.int64)


@pytest.mark.parametrize("level", [101_325.0, -273.15])
@pytest.mark.parametrize("cls", [pmfid.LS, pmfid.BCLS])
def test_the_level_of_the_output_does_not_matter(cls: type[BatchEstimator], level: float) -> None:
    step = 2e-3
    model, encoder = pmfid.TransferFunction(2, 0, offset=True), pmfid.Encoder(step)
    fit = cls(model, encoder, DT, 3.0).fit(*counts_about(level, step))
    np.testing.assert_allclose(fit.theta[:3], TRUTH, rtol=5e-3)
    assert abs(fit["offset"] - 4.0 * level) < 4 * fit.theta_std[3] + 1e-3 * abs(4.0 * level)
    np.testing.assert_allclose(fit["offset"] / fit["a0"], level, atol=5 * step)
    u, counts = counts_about(0.0, step)
    near = cls(model, encoder, DT, 3.0).fit(u, counts)
    np.testing.assert_allclose(fit.theta[:3], near.theta[:3], rtol=2e-3)
    np.testing.assert_allclose(fit.theta_std[:3], near.theta_std[:3], rtol=0.3)


# --- on-line ----------------------------------------------------------------------------------------------------------

RECURSIVE = [pmfid.RLS, pmfid.BCRLS]
#: numerator, denominator, sample period [s], cutoff [rad/s], dead time in samples
PROCESSES = {
    "one lag": ((2.0,), (1.0, 1.5), 0.05, 4.0, 0),
    "two, late": ((2.0,), (1.0, 1.2, 4.0), 0.05, 3.0, 2),
    "three and a zero": ((30.0, 200.0), (1.0, 9.0, 40.0, 100.0), 0.02, 8.0, 1),
}
STEPS = 20_000  # steps of the encoder in the range of the output


def online(cls: type[RecursiveEstimator], name: str, precision: str) -> tuple[RecursiveEstimator, Record]:
    """Return an estimator of a process with a constant, and u and counts from the first one."""
    b, a, dt, cutoff, delay = PROCESSES[name]
    u = prbs(4000, clock=8, amplitude=1.0, rng=np.random.default_rng(3))
    y = simulate_process(b, a, np.r_[np.zeros(delay), u][: u.size], dt)
    step = float(np.ptp(y)) / STEPS
    counts = np.floor(y / step + 700).astype(np.int64)
    model = pmfid.TransferFunction(len(a) - 1, len(b) - 1, delay=delay, offset=True)
    estimator = cls(model, pmfid.Encoder(step), dt, cutoff, forgetting=0.998, precision=precision)
    return estimator, (u, counts - counts[0])


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("name", PROCESSES)
@pytest.mark.parametrize("cls", RECURSIVE)
def test_online_the_level_is_in_the_constant_alone(cls: type[RecursiveEstimator], name: str, precision: str) -> None:
    """Only the constant changes, by A(0) times the level, and its error bar accordingly; all other bits stay."""
    estimator, (u, counts) = online(cls, name, precision)
    near, first = estimator.run(u, counts), estimator.estimate
    rounding = 1e-12 if precision == "float64" else 1e-6
    assert near.status[-1] == 0
    for changes in (1e3, 1e5, 1e6):
        level = int(changes * STEPS / 100)
        y = level * estimator.encoder.resolution
        estimator.reset()
        far, last = estimator.run(u, counts + level), estimator.estimate
        assert np.array_equal(far.theta[:, :-1], near.theta[:, :-1])
        assert np.array_equal(far.status, near.status)
        np.testing.assert_allclose(far.theta[-1, -1], near.theta[-1, -1] + near.theta[-1, 0] * y, rtol=rounding)
        lift = np.eye(last.theta.size)
        lift[-1, 0] = y
        white = [
            np.array(one.theta_cov) / np.sqrt(np.outer(track.inflation[-1], track.inflation[-1]))
            for one, track in ((first, near), (last, far))
        ]  # value for independent innovations
        np.testing.assert_allclose(white[1], lift @ white[0] @ lift.T, rtol=100 * rounding)
        np.testing.assert_allclose(far.theta_std[-1, -1], y * near.theta_std[-1, 0], rtol=0.05)

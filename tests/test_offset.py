"""A process far from zero, whose constant is estimated: a pressure about 101 325 Pa."""

from __future__ import annotations

import numpy as np
import pytest

import pmfid
from pmfid.estimators.batch import BatchEstimator
from pmfid.simulation.process import simulate_process
from pmfid.simulation.signals import prbs

DT, TRUTH = 0.05, (4.0, 1.2, 2.0)


def counts_about(level: float, step: float) -> tuple[np.ndarray, np.ndarray]:
    u = prbs(3000, clock=8, amplitude=1.0, rng=np.random.default_rng(3))
    return u, np.floor((simulate_process((2.0,), (1.0, 1.2, 4.0), u, DT) + level) / step).astype(np.int64)


@pytest.mark.parametrize("level", [101_325.0, -273.15])
@pytest.mark.parametrize("cls", [pmfid.LS, pmfid.BCLS, pmfid.KnownStep])
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


def test_a_counter_that_begins_below_zero() -> None:
    """The first count has its sign, as the kernel has it."""
    step = 2e-3
    u, counts = counts_about(-3.0, step)
    model = pmfid.TransferFunction(2, 0, offset=True)
    signed = pmfid.LS(model, pmfid.Encoder(step, bits=16), DT, 3.0).fit(u, counts)
    wrapped = pmfid.LS(model, pmfid.Encoder(step, bits=16), DT, 3.0).fit(u, counts % 2**16)
    np.testing.assert_allclose(wrapped.theta, signed.theta, rtol=1e-12)
    np.testing.assert_allclose(signed["offset"] / signed["a0"], -3.0, atol=5 * step)

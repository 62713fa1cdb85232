"""Without forgetting in float32, the estimate still uses new samples after millions of samples."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import pmfid
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.kernel.structures import structures
from pmfid.simulation import CART, CART_DT
from pmfid.simulation.drive import quantize, simulate_drive
from tests.conftest import cart_run, long_unless

SAMPLES, REPEATED = 20_000, 50
HEAVY = replace(CART, mass=1.3)


@cache
def motion(heavy: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return u, counts (1, n): a cart's run, repeated."""
    run = cart_run(3, samples=SAMPLES, increments=1024)
    moved = quantize(simulate_drive(HEAVY if heavy else CART, run.u, CART_DT).x, run.encoder.resolution)
    distance = int(moved[-1] - moved[0])
    counts = np.concatenate([moved + k * distance for k in range(REPEATED)])
    return np.tile(run.u, REPEATED)[None], counts[None]


def after_millions(cls: type[RecursiveEstimator], precision: str) -> RecursiveEstimator:
    """Return the estimator with sums as after a million similar samples."""
    run = cart_run(3, samples=SAMPLES, increments=1024)
    estimator = cls(pmfid.Drive(2.0), run.encoder, 0.01, 30.0, precision=precision)
    estimator.run(run.u, run.counts)
    state = np.frombuffer(estimator.kernel.raw_state(), structures(None, precision)["pmf_state_t"]).copy()
    sums = state[0]["direct"]
    for part in (sums["sums"]["cross"], sums["sums"]["square"], sums["peak"]):
        part *= REPEATED
    state[0]["direct"]["sums"]["weight"] *= REPEATED
    estimator.kernel.set_raw_state(state.tobytes())
    return estimator


@pytest.mark.parametrize("cls", long_unless(lambda cls: cls is pmfid.BCRLS, [pmfid.RLS, pmfid.BCRLS]))
def test_float32_still_gathers(cls: type[RecursiveEstimator]) -> None:
    fleet = pmfid.Fleet(after_millions(cls, "float32"), 1)
    u, counts = motion(heavy=True)
    for memory in range(3):
        last = fleet.run(u, counts + memory * counts[0, -1])
    assert last["mass"][0, -1] == pytest.approx(HEAVY.mass, rel=0.05)
    assert last.status[0, -1] == 0


@pytest.mark.parametrize("cls", long_unless(lambda cls: cls is pmfid.BCRLS, [pmfid.RLS, pmfid.BCRLS]))
def test_float32_agrees_with_float64_after_two_million_samples(cls: type[RecursiveEstimator]) -> None:
    u, counts = motion(heavy=False)
    single, double = (
        cls(pmfid.Drive(2.0), cart_run(3, increments=1024).encoder, 0.01, 30.0, precision=precision)
        for precision in ("float32", "float64")
    )
    fleets = [pmfid.Fleet(single, 1), pmfid.Fleet(double, 1)]
    for start in (0, counts[0, -1]):
        ends = [fleet.run(u, counts + start).theta[0, -1] for fleet in fleets]
    np.testing.assert_allclose(*ends, rtol=1e-3)


@pytest.mark.long
def test_a_rest_of_three_memories_keeps_the_estimate() -> None:
    estimator = after_millions(pmfid.BCRLS, "float32")
    u, counts = motion(heavy=False)
    moved = pmfid.Fleet(estimator, 1)
    before = moved.run(u[:, :10_000], counts[:, :10_000])
    rest = moved.run(np.zeros((1, 3 * 10**6)), np.full((1, 3 * 10**6), counts[0, 10_000]))
    np.testing.assert_allclose(rest.theta[0, -1], before.theta[0, -1], rtol=1e-3)

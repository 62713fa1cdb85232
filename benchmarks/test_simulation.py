"""Time of simulated motions, in open loop and under position control. The names are permanent."""

from __future__ import annotations

import numpy as np
from pytest_benchmark.fixture import BenchmarkFixture

from pmfid.simulation import CART, CART_CONTROL, CART_DT, Faults, position_control, prbs, simulate_drive, stop_and_go

SAMPLES = 200_000


def test_simulate_a_drive(benchmark: BenchmarkFixture) -> None:
    u = prbs(SAMPLES, clock=10, amplitude=3.0, rng=np.random.default_rng(0))
    assert benchmark(simulate_drive, CART, u, CART_DT).x.shape == (SAMPLES,)


def test_simulate_position_control_through_a_faulty_encoder(benchmark: BenchmarkFixture) -> None:
    reference = stop_and_go(SAMPLES, CART_DT, 0.2, 0.8, 0.5)
    lattice = {"resolution": 91e-6, "faults": Faults(missed=1e-3, jitter=0.1, line_error=0.1)}
    _, counts = benchmark(position_control, CART, reference, CART_DT, **CART_CONTROL, **lattice)
    assert counts.shape == (SAMPLES,)

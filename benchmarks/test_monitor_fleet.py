"""Time per axis and sample of many monitored axes on one core, compared to `Monitor.step` in a loop.

The names are permanent. Every axis has another place of the cart's normal work; 100 Hz, blocks of 17 samples.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from benchmarks.test_step import measure
from pmfid.monitor import Monitor, MonitorFleet, Watch, calibrate
from pmfid.simulation.scenarios import CART
from pmfid.types import Counts, Floats
from studies.monitoring.axis import INCREMENTS, make_riv, normal_work

#: Axes -> samples of each axis, which come in blocks of BLOCK samples.
SIZES = {1: 10_000, 12: 10_000, 1000: 1000, 10_000: 300}
BLOCK = 50
LOOP_SAMPLES = 5000
THETA = np.array([CART.mass, CART.viscous_friction, CART.coulomb_friction])


@cache
def monitor() -> Monitor:
    """Return a monitor with unreachable thresholds: a false alarm would lead its axis through `Monitor.run`."""
    calibration = calibrate(make_riv(INCREMENTS), THETA, *normal_work(7, INCREMENTS, 0.2))
    return Monitor(make_riv(INCREMENTS, THETA), calibration, Watch(mtbf_hours=1e5))


def tables(axes: int, samples: int) -> tuple[Floats, Counts]:
    u, counts = normal_work(11, INCREMENTS, 0.3)
    starts = np.random.default_rng(axes).integers(0, u.size - samples, axes)
    return np.stack([u[k : k + samples] for k in starts]), np.stack([counts[k : k + samples] for k in starts])


@pytest.mark.parametrize("axes", SIZES)
def test_pmfid_monitor_fleet(benchmark: BenchmarkFixture, axes: int) -> None:
    """Blocks of BLOCK samples of all axes follow one another."""
    samples, fleet, index = SIZES[axes], MonitorFleet(monitor(), axes), np.arange(axes)
    u, counts = tables(axes, samples)
    start = fleet.get_state()

    def run() -> None:
        for k in range(0, samples, BLOCK):
            fleet.run(index, u[:, k : k + BLOCK], counts[:, k : k + BLOCK])

    measure(benchmark, run, axes * samples, rounds=3, setup=lambda: fleet.set_state(start))


def test_pmfid_monitor_step(benchmark: BenchmarkFixture) -> None:
    """One axis runs sample by sample."""
    single, (u, counts) = MonitorFleet(monitor(), 1).monitor(0), tables(1, LOOP_SAMPLES)
    pairs, start = list(zip(u[0].tolist(), counts[0].tolist(), strict=True)), single.get_state()

    def run() -> None:
        for one, count in pairs:
            single.step(one, count)

    measure(benchmark, run, LOOP_SAMPLES, rounds=3, setup=lambda: single.set_state(start))


def test_pmfid_monitor_fleet_get_state(benchmark: BenchmarkFixture) -> None:
    """The result is all states of 10 000 axes as bytes; an axis counts as a sample here."""
    fleet = MonitorFleet(monitor(), 10_000)
    measure(benchmark, fleet.get_state, 10_000, rounds=5)

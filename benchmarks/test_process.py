"""Recursive least squares of order 4, and SRIVC with its discrete peers: time and error of the simulated output.

The peers, ARMAX and output error of sippy_unipi, are measured if it is installed; it is no requirement here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pytest_benchmark.fixture import BenchmarkFixture
from scipy.signal import lfilter

from pmfid import RLS, SRIVC, Encoder, Experiment, TransferFunction
from pmfid.encoder import fine_counts
from pmfid.simulation.process import PLANTS, simulate_process

PLANT = PLANTS["rao-garnier"]
U, CLEAN = PLANT.u, PLANT.y
Y = CLEAN + np.std(CLEAN) / np.sqrt(10) * np.random.default_rng(0).standard_normal(PLANT.samples)
PEERS = {"OE": {"OE_orders": [4, 4, 1]}, "ARMAX": {"ARMAX_orders": [4, 4, 4, 1]}}


def record(benchmark: BenchmarkFixture, simulated: NDArray[np.float64]) -> float:
    """Record and return the error of the simulated output, relative to the output without noise."""
    error = float(np.linalg.norm(simulated - CLEAN) / np.linalg.norm(CLEAN))
    benchmark.extra_info["samples"] = PLANT.samples
    benchmark.extra_info["output_error"] = error
    return error


def test_pmfid_srivc_order_4(benchmark: BenchmarkFixture) -> None:
    estimator = SRIVC(TransferFunction(4, 1), Encoder(1.0), PLANT.dt, PLANT.cutoff)
    experiment = Experiment(U, Y, dt=PLANT.dt)
    fit: Any = benchmark.pedantic(estimator.fit_experiments, args=([experiment],), rounds=5)
    found = fit.process
    assert record(benchmark, simulate_process(found.b[::-1], np.r_[1.0, found.a[::-1]], U, PLANT.dt)) < 0.02


@pytest.mark.parametrize("zeros", range(4))
def test_pmfid_rls_order_4(benchmark: BenchmarkFixture, zeros: int) -> None:
    """The models have five to eight parameters."""
    encoder, counts = fine_counts(Y)
    estimator = RLS(TransferFunction(4, zeros), encoder, PLANT.dt, PLANT.cutoff, forgetting=0.9995)
    track: Any = benchmark.pedantic(lambda: estimator.run(U, counts), setup=estimator.reset, rounds=50)
    benchmark.extra_info["samples"] = PLANT.samples
    assert np.all(np.isfinite(track.theta))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", PEERS)
def test_sippy_process(benchmark: BenchmarkFixture, kind: str) -> None:
    identify: Callable[..., Any] = pytest.importorskip("sippy_unipi").system_identification
    model = benchmark.pedantic(identify, args=(Y, U, kind), kwargs={"tsample": PLANT.dt, **PEERS[kind]}, rounds=1)
    bottom, top = (np.ravel(part[0][0]) for part in (model.G.den, model.G.num))
    simulated = lfilter(np.r_[np.zeros(bottom.size - top.size), top], bottom, U)
    assert np.isfinite(record(benchmark, simulated))

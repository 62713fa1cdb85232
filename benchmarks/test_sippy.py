"""Time of sippy_unipi's recursive ARX; skipped if it is not installed, because it requires CasADi."""

from __future__ import annotations

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from benchmarks.conftest import Record
from benchmarks.test_step import measure

SAMPLES = 10_000


@pytest.mark.filterwarnings("ignore")
def test_sippy_rls(benchmark: BenchmarkFixture, record: Record) -> None:
    """Estimate an ARX model of the measured velocity from input and direction, by recursive least squares.

    The parameters of SIPPY belong to a difference equation with the encoder's noise in the regressors, so that no mass
    is compared.
    """
    sippy = pytest.importorskip("sippy_unipi")
    counts = record.counts[: SAMPLES + 1]
    velocity = np.diff(counts) * (record.encoder.resolution / record.dt)
    inputs = np.stack([record.u[:SAMPLES], np.sign(velocity)])
    orders = [[1], [[2, 1]], [[0, 0]]]
    model = measure(
        benchmark,
        lambda: sippy.system_identification(
            velocity, inputs, "ARX", ARX_orders=orders, ARX_mod="RLLS", tsample=record.dt
        ),
        SAMPLES,
        rounds=3,
    )
    assert np.all(np.isfinite(model.NUMERATOR[0][0]))

"""Time of sippy_unipi's recursive ARX; skipped where it is not installed, for it brings CasADi with it."""

from __future__ import annotations

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from benchmarks.conftest import Record
from benchmarks.test_step import measure

SAMPLES = 10_000


@pytest.mark.filterwarnings("ignore")
def test_sippy_rls(benchmark: BenchmarkFixture, record: Record) -> None:
    """ARX of the measured velocity on input and direction, by recursive least squares.

    Its parameters are those of a difference equation with the encoder's noise in the regressors; no mass is compared.
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

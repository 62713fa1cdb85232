"""Time per axis and sample for many axes, compared to the scalar kernel in a loop and to NumPy over the axes.

The names are permanent. Every axis has its own part of the record; `run` starts from new states each time.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from pytest_benchmark.fixture import BenchmarkFixture

import pmfid
from benchmarks.conftest import DRIVE, Record
from benchmarks.test_step import make, measure, note_mass

#: Axes -> samples of each axis: enough for a measurable time, within the memory.
SIZES = {1: 200_000, 10: 50_000, 100: 10_000, 1000: 2_000, 10_000: 500, 100_000: 100}
LOOP_AXES = 200


def tables(record: Record, axes: int, samples: int) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return u, counts (axes, samples); each axis begins at another place of the record."""
    starts = np.random.default_rng(axes).integers(0, record.u.size - samples + 1, axes)
    u, counts = record.u.astype(np.float32), record.counts.astype(np.int32)
    return tuple(np.stack([row[k : k + samples] for k in starts]) for row in (u, counts))  # type: ignore[return-value]


@pytest.mark.parametrize("axes", SIZES)
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_pmfid_bcrls_fleet(benchmark: BenchmarkFixture, record: Record, precision: str, axes: int) -> None:
    """The fleet uses all processors and the widest vectors."""
    samples = SIZES[axes]
    u, counts = tables(record, axes, samples)
    fleet = pmfid.Fleet(make(pmfid.BCRLS, record, precision), axes)
    tracks = measure(benchmark, lambda: fleet.run(u, counts), axes * samples, rounds=4, setup=fleet.reset)
    note_mass(benchmark, np.median(tracks["mass"]))


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_pmfid_bcrls_fleet_one_thread(benchmark: BenchmarkFixture, record: Record, precision: str) -> None:
    u, counts = tables(record, 10_000, 500)
    fleet = pmfid.Fleet(make(pmfid.BCRLS, record, precision), 10_000, workers=1)
    tracks = measure(benchmark, lambda: fleet.run(u, counts), u.size, rounds=4, setup=fleet.reset)
    note_mass(benchmark, np.median(tracks["mass"]))


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_pmfid_bcrls_loop(benchmark: BenchmarkFixture, record: Record, precision: str) -> None:
    """The scalar kernel runs one axis after the other on one core."""
    u, counts = tables(record, LOOP_AXES, 500)
    inputs, numbers = u.astype(float), counts.astype(np.int64)
    estimator = make(pmfid.BCRLS, record, precision)

    def loop() -> list[float]:
        masses = []
        for one_u, one_counts in zip(inputs, numbers, strict=True):
            estimator.reset()
            masses.append(float(estimator.run(one_u, one_counts).theta[-1, 0]))
        return masses

    note_mass(benchmark, np.median(measure(benchmark, loop, u.size, rounds=10)))


def test_numpy_over_axes(benchmark: BenchmarkFixture, record: Record) -> None:
    """Recursive instrumental variables on filtered columns, every operation on all axes at once.

    BCRLS has the same recursion. The time excludes encoder and filters, and all axes read the same columns.
    """
    axes, samples, forgetting = 10_000, 500, 0.999
    batch = pmfid.BCLS(DRIVE, record.encoder, record.dt, 50.0)
    columns = batch.columns(record.u[: 2 * samples], record.counts[: 2 * samples])
    assert columns.zeta is not None
    rows = [np.tile(part[:samples, None], (1, axes, 1)[: part.ndim + 1]) for part in (columns.phi, columns.zeta)]

    def loop() -> float:
        P, theta = np.tile(1e3 * np.eye(3), (axes, 1, 1)), np.zeros((axes, 3))
        for phi, zeta, z in zip(*rows, columns.z, strict=False):
            P_zeta = np.einsum("aij,aj->ai", P, zeta)
            phi_P = np.einsum("ai,aij->aj", phi, P)
            gain = P_zeta / (forgetting + np.einsum("ai,ai->a", phi, P_zeta))[:, None]
            theta += gain * (z - np.einsum("ai,ai->a", phi, theta))[:, None]
            P = (P - gain[:, :, None] * phi_P[:, None, :]) / forgetting
        return float(theta[0, 0])

    mass = measure(benchmark, loop, axes * samples, rounds=2)
    note_mass(benchmark, mass, tolerance=0.05)

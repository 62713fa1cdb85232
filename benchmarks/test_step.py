"""Time per sample of pmfid and of its peers on the same record, each with the mass that it found.

The names are permanent: results of several years can be compared. The peers receive the filtered regressors, so that
they have less work than pmfid, which starts from the counts.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import padasip  # type: ignore[import-untyped]
import pytest
from numpy.typing import NDArray
from pytest_benchmark.fixture import BenchmarkFixture
from scipy.signal import lfilter
from statsmodels.regression.recursive_ls import RecursiveLS  # type: ignore[import-untyped]

import pmfid
from benchmarks.conftest import CUTOFF, DRIVE, FORGETTING, SAMPLES, Record
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.filters.columns import ColumnBuilder, FilterSpec
from pmfid.filters.network import SIGNALS, Taps
from pmfid.simulation.scenarios import CART
from tests.oracles import paper

LOOP_SAMPLES = 10_000
BATCH_START = 600
bcrls_of_paper: Callable[..., NDArray[np.float64]] = paper.bcrls
facts_of_paper: Callable[..., tuple[NDArray[np.float64], NDArray[np.float64]]] = paper.facts


def measure(
    benchmark: BenchmarkFixture,
    run: Callable[[], Any],
    samples: int,
    *,
    rounds: int,
    setup: Callable[[], None] | None = None,
) -> Any:
    """Measure the time of `run`, which takes `samples` samples, after one untimed round; return its last result."""
    pedantic: Callable[..., Any] = benchmark.pedantic
    result = pedantic(run, setup=setup, rounds=rounds, iterations=1, warmup_rounds=1)
    benchmark.extra_info["samples"] = samples
    if benchmark.stats is not None:  # None if timing is switched off
        # the best round, because on a shared machine all other rounds show the load of others
        benchmark.extra_info["ns_per_sample"] = benchmark.stats.stats.min / samples * 1e9
    return result


def note_mass(benchmark: BenchmarkFixture, mass: float, tolerance: float = 0.01) -> None:
    """Record the error of the mass besides the time; fail if the benchmark does not compute the mass."""
    error = float(mass) / CART.mass - 1
    benchmark.extra_info["mass_error"] = error
    assert abs(error) < tolerance


def make(cls: type[RecursiveEstimator], record: Record, precision: str = "float64") -> RecursiveEstimator:
    return cls(DRIVE, record.encoder, record.dt, CUTOFF, forgetting=FORGETTING, precision=precision)


def measure_run(benchmark: BenchmarkFixture, estimator: RecursiveEstimator, record: Record) -> None:
    def run() -> pmfid.Track:
        return estimator.run(record.u, record.counts)

    track = measure(benchmark, run, SAMPLES, rounds=20, setup=estimator.reset)
    note_mass(benchmark, track["mass"][-1])


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_pmfid_bcrls_run(benchmark: BenchmarkFixture, record: Record, precision: str) -> None:
    measure_run(benchmark, make(pmfid.BCRLS, record, precision), record)


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_pmfid_rls_run(benchmark: BenchmarkFixture, record: Record, precision: str) -> None:
    measure_run(benchmark, make(pmfid.RLS, record, precision), record)


def test_pmfid_bcrls_step(benchmark: BenchmarkFixture, record: Record) -> None:
    """Python calls the estimator for each sample and reads `theta` each time."""
    estimator = make(pmfid.BCRLS, record)
    u, counts = record.u[:LOOP_SAMPLES].tolist(), record.counts[:LOOP_SAMPLES].tolist()

    def loop() -> NDArray[np.float64]:
        step = estimator.step
        for voltage, count in zip(u, counts, strict=True):
            theta = step(voltage, count).theta
        return np.asarray(theta)

    theta = measure(benchmark, loop, LOOP_SAMPLES, rounds=20, setup=estimator.reset)
    note_mass(benchmark, theta[0])


def test_padasip_rls(benchmark: BenchmarkFixture, record: Record) -> None:
    """`FilterRLS.adapt` runs on the filtered regressors: only least squares, without filters and compensation."""
    rows, targets = list(record.phi[:LOOP_SAMPLES]), record.z[:LOOP_SAMPLES].tolist()

    def loop() -> float:
        rls = padasip.filters.FilterRLS(3, mu=FORGETTING, eps=1e-3, w="zeros")
        for phi, z in zip(rows, targets, strict=True):
            rls.adapt(z, phi)
        return float(rls.w[0])

    note_mass(benchmark, measure(benchmark, loop, LOOP_SAMPLES, rounds=20))


@pytest.mark.filterwarnings("ignore")
def test_statsmodels_rls(benchmark: BenchmarkFixture, record: Record) -> None:
    """`RecursiveLS.fit` runs on the filtered regressors: it has no forgetting, and keeps the history of all samples."""
    phi, z = record.phi[:LOOP_SAMPLES], record.z[:LOOP_SAMPLES]
    fit = measure(benchmark, lambda: RecursiveLS(z, phi).fit(), LOOP_SAMPLES, rounds=10)
    note_mass(benchmark, fit.params[0])


def test_numpy_rls(benchmark: BenchmarkFixture, record: Record) -> None:
    """Paper eq. 33, first four lines, runs on the filtered regressors."""
    rows, targets = list(record.phi[:LOOP_SAMPLES]), record.z[:LOOP_SAMPLES].tolist()

    def loop() -> float:
        P, theta = 1e3 * np.eye(3), np.zeros(3)
        for phi, z in zip(rows, targets, strict=True):
            P_phi = P @ phi
            gain = P_phi / (FORGETTING + phi @ P_phi)
            theta = theta + gain * (z - phi @ theta)
            P = (P - np.outer(gain, P_phi)) / FORGETTING
            P = (P + P.T) / 2
        return float(theta[0])

    note_mass(benchmark, measure(benchmark, loop, LOOP_SAMPLES, rounds=20))


def test_numpy_bcrls(benchmark: BenchmarkFixture, record: Record) -> None:
    """Paper eq. 33 to 36 run on the extended regressors, with the code of the tests that is read next to the paper."""
    phi, z = record.extended[: LOOP_SAMPLES + BATCH_START], record.extended_z[: LOOP_SAMPLES + BATCH_START]
    H, h = facts_of_paper(record.zeros, record.dt, 5, 3)
    G = np.eye(5)[:, :2]

    def loop() -> float:
        return float(bcrls_of_paper(phi, z, FORGETTING, BATCH_START, H, h, G)[-1, 0])

    note_mass(benchmark, measure(benchmark, loop, LOOP_SAMPLES, rounds=10))


def bcrls_network(record: Record) -> tuple[list[tuple[int, float, float, float]], Taps]:
    """Return all stages of pmfid's BCRLS, and the taps of the mass's column."""
    spec = FilterSpec(CUTOFF, 2, record.dt, "matched", record.zeros)
    builder = ColumnBuilder(DRIVE.equation, spec)
    mass = builder.regressors()[0]
    builder.target()
    builder.instruments()
    return builder.network.stages, mass


def test_pmfid_filters(benchmark: BenchmarkFixture, record: Record) -> None:
    """The benchmark has the encoder and the filters of BCRLS without the recursion."""
    kernel = make(pmfid.BCRLS, record).make_kernel()
    columns, _ = measure(
        benchmark, lambda: kernel.filter(record.u, record.counts), SAMPLES, rounds=20, setup=kernel.reset
    )
    assert np.array_equal(columns[-len(record.phi) :, 0], record.phi[:, 0])


def test_scipy_lfilter(benchmark: BenchmarkFixture, record: Record) -> None:
    """Each stage is one call over the whole record, without an encoder; the direction is a plain sign."""
    stages, mass = bcrls_network(record)
    velocity = np.diff(record.counts, prepend=record.counts[0]) * (record.encoder.resolution / record.dt)
    signals = [record.u, velocity, np.sign(velocity), np.ones(SAMPLES)]
    signals += [signals[3]] * (SIGNALS - len(signals))

    def run() -> list[NDArray[np.float64]]:
        nodes = list(signals)
        for source, a, b0, b1 in stages:
            nodes.append(lfilter([b0, b1], [1.0, -a], nodes[source]))
        return nodes

    nodes = measure(benchmark, run, SAMPLES, rounds=20)
    column = sum(weight * nodes[node] for node, weight in mass)
    np.testing.assert_allclose(column[-len(record.phi) :], record.phi[:, 0], rtol=1e-9, atol=1e-9)

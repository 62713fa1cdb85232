"""The recursion has the same bits for any call, equals the batch, and does not change without information."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import pmfid
from pmfid import Status
from pmfid.simulation.drive import quantize, simulate_drive
from pmfid.simulation.scenarios import CART, resolution_of
from pmfid.simulation.signals import prbs
from tests.conftest import TRUTH, cart_run
from tests.oracles import paper

DT, CUTOFF = 0.01, 50.0
RECURSIVE = [pmfid.RLS, pmfid.BCRLS]


def tracks_equal(a: pmfid.Track, b: pmfid.Track) -> None:
    for name in ("theta", "variance_factor", "innovation", "innovation_variance", "status"):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name


@settings(max_examples=25)
@given(
    seed=st.integers(0, 10**6),
    increments=st.sampled_from([4096, 1024, 256]),
    cutoff=st.floats(10.0, 80.0),
    clock=st.integers(3, 20),
    zeros=st.sampled_from([None, (-3.0, -11.0)]),
)
@example(
    seed=893, increments=256, cutoff=47.0, clock=16, zeros=(-3.0, -11.0)
)  # instruments with hardly any information
@pytest.mark.parametrize("pair", [(pmfid.LS, pmfid.RLS), (pmfid.BCLS, pmfid.BCRLS)])
def test_recursive_equals_batch_without_forgetting(pair, drive, seed, increments, cutoff, clock, zeros):
    run = cart_run(seed, samples=1500, increments=increments, clock=clock)
    encoder = replace(run.encoder, guard=False)  # without a delay, both use the same samples
    batch, recursive = (cls(drive, encoder, DT, cutoff, prefilter_zeros=zeros) for cls in pair)
    fit = batch.fit(run.u, run.counts)
    last = recursive.run(run.u, run.counts)
    # for a parameter with little information, rounding grows as noise does
    assert np.all(np.abs(last.theta[-1] - fit.theta) < 1e-8 * np.abs(fit.theta) + 1e-6 * fit.theta_std)
    columns = batch.columns(run.u, run.counts)
    half = np.linalg.qr(columns.zeta)[0].T @ columns.phi
    np.testing.assert_allclose(last.variance_factor[-1], np.diag(np.linalg.inv(half.T @ half)), rtol=1e-6)


@pytest.mark.parametrize("zeros", [(-2.0, -5.0), (-12.0, -0.5)])
def test_bcls_is_the_papers_compensation(zeros, drive):
    """The recursion of the paper (eq. 17 to 36) on the extended model gives the same result as the instruments."""
    run = cart_run(4, increments=512)
    extended = pmfid.LS(drive, run.encoder, DT, CUTOFF, prefilter_zeros=zeros)
    columns = extended.columns(run.u, run.counts)
    H, h = paper.facts(zeros, DT, 5, 3)
    G = np.eye(5)[:, :2]
    expected = paper.bcls(columns.phi, columns.z, H, h, G)
    fit = pmfid.BCLS(drive, run.encoder, DT, CUTOFF, prefilter_zeros=zeros).fit(run.u, run.counts)
    np.testing.assert_allclose(fit.theta, expected[:3], rtol=1e-6)


def test_bcrls_follows_the_papers_recursion(drive):
    """The paper's eq. 33 with forgetting gives the estimate except for the regularisation, 1e-4 of the information."""
    run, zeros = cart_run(5, increments=1024, samples=2000), (-5.0, -1.0)
    encoder = replace(run.encoder, guard=False)
    columns = pmfid.LS(drive, encoder, DT, CUTOFF, prefilter_zeros=zeros).columns(run.u, run.counts)
    H, h = paper.facts(zeros, DT, 5, 3)
    expected = paper.bcrls(columns.phi, columns.z, 0.995, 600, H, h, np.eye(5)[:, :2])
    track = pmfid.BCRLS(drive, encoder, DT, CUTOFF, prefilter_zeros=zeros, forgetting=0.995).run(run.u, run.counts)
    late = track.theta[-len(expected) :][600:]
    solved = np.flatnonzero(np.any(np.diff(late, axis=0) != 0, axis=1)) + 1
    assert set(np.diff(solved)) == {4}
    np.testing.assert_allclose(late[solved], expected[600:, :3][solved], rtol=2e-3)


@pytest.mark.parametrize("cls", RECURSIVE)
@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("voltage", [0.0, 1.0])
@pytest.mark.long
def test_a_million_samples_without_excitation(cls, precision, voltage, drive):
    """At rest (zero regressor) or at constant speed, the estimate is finite and flagged, and recovers within 2 s of
    motion.
    """
    n, head, tail = 1_000_000, 500, 200
    moves = prbs(head + tail, clock=10, amplitude=3.0, rng=np.random.default_rng(7))
    u = np.r_[moves[:head], np.full(n, voltage), moves[head:]]
    resolution = resolution_of(4096)
    counts = quantize(simulate_drive(CART, u, DT).x, resolution)
    estimator = cls(drive, pmfid.Encoder(resolution), DT, CUTOFF, forgetting=0.98, precision=precision)
    track = estimator.run(u, counts)
    assert np.all(np.isfinite(track.theta))
    assert np.all(np.isfinite(track.variance_factor))
    assert np.all(track.has_status(Status.POOR_EXCITATION)[head + 1000 : head + n])
    np.testing.assert_allclose(track["mass"][head + n - 1], TRUTH[0], rtol=0.05)
    np.testing.assert_allclose(track.theta[-1], TRUTH, rtol=0.05)
    assert not track.has_status(Status.POOR_EXCITATION)[-1]


@pytest.mark.parametrize("cls", RECURSIVE)
def test_nothing_comes_of_nothing(cls, drive):
    track = cls(drive, pmfid.Encoder(1e-5), DT, CUTOFF, forgetting=0.99).run(np.ones(5000), np.zeros(5000, int))
    assert np.all(track.theta == 0)
    assert np.all(track.has_status(Status.STARTING))
    assert np.all(np.isinf(track.theta_std))


@pytest.mark.parametrize("cls", RECURSIVE)
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_bad_values_are_flagged_and_forgotten(cls, precision, drive):
    run = cart_run(9, samples=3000)
    u, counts = run.u.copy(), run.counts.copy()
    u[700], u[1200], u[1500] = np.nan, np.inf, 1e300
    counts[2000:] += 10**9
    encoder = pmfid.Encoder(run.encoder.resolution, max_speed=5.0)
    track = cls(drive, encoder, DT, CUTOFF, forgetting=0.99, precision=precision).run(u, counts)
    assert np.all(np.isfinite(track.theta))
    assert track.has_status(Status.INVALID_INPUT)[[708, 1208]].all()
    assert np.flatnonzero(track.has_status(Status.COUNT_JUMP)).tolist() == [2008]  # the guard waits for eight counts
    np.testing.assert_allclose(track.theta[-1], TRUTH, rtol=0.03)


def test_counter_wrap_changes_nothing(drive):
    run = cart_run(10, samples=1500)
    wrapped = run.counts % 2**10
    assert np.any(np.abs(np.diff(wrapped)) > 500)
    narrow = pmfid.Encoder(run.encoder.resolution, bits=10)
    a = pmfid.BCRLS(drive, run.encoder, DT, CUTOFF).run(run.u, run.counts)
    b = pmfid.BCRLS(drive, narrow, DT, CUTOFF).run(run.u, wrapped)
    tracks_equal(a, b)
    np.testing.assert_allclose(np.diff(narrow.position(wrapped)), np.diff(run.encoder.position(run.counts)), atol=1e-12)


def test_an_estimate_is_a_snapshot(drive):
    run = cart_run(12, samples=400)
    estimator = pmfid.RLS(drive, run.encoder, DT, CUTOFF, forgetting=0.95)
    estimator.run(run.u[:300], run.counts[:300])
    estimate = estimator.estimate
    theta = estimate.theta
    estimator.run(run.u[300:], run.counts[300:])
    assert np.array_equal(estimate.theta, theta)
    assert not np.array_equal(estimator.estimate.theta, theta)

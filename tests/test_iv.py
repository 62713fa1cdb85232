"""Instrumental variables with the auxiliary model: reversals, standstill, real data."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.io

import pmfid
from pmfid import Status
from pmfid.diagnostics.verdict import verdict
from pmfid.encoder import quantize
from pmfid.findings import codes
from pmfid.simulation.scenarios import make_scenario
from tests.conftest import EMPS, TRUTH, assert_near, cart_run, needs_emps
from tests.refusals import refused

DT = 0.01
START = {"mass": 0.8, "viscous_friction": 10.0, "coulomb_friction": 0.3}


@pytest.mark.parametrize("time_constant", [2, 5])
@pytest.mark.parametrize("increments", [None, 256])
def test_no_discretisation_error(time_constant, increments, drive):
    """With reversals inside samples, the mean over the seeds equals the truth."""
    cutoff = 1 / (time_constant * DT)
    found = [
        pmfid.IV(drive, run.encoder, DT, cutoff).fit(run.u, run.counts).theta
        for run in (cart_run(seed, increments=increments) for seed in range(10))
    ]
    assert_near(np.mean(found, axis=0), TRUTH, [1e-3, 2e-3, 1e-2])
    if increments is None:
        np.testing.assert_allclose(found[0], TRUTH, rtol=1e-4)


@pytest.mark.parametrize("increments", [4096, 512, 128])
def test_stop_and_go_through_the_encoder(increments, drive):
    for seed in range(3):
        scenario = make_scenario("stop-and-go", seed=seed, increments=increments)
        encoder, u = pmfid.Encoder(scenario.resolution), scenario.motion.u
        fit = pmfid.IV(drive, encoder, DT, 100 / 3).fit(u, scenario.counts)
        assert_near(fit.theta, TRUTH, [0.005, 0.005, 0.02])
        track = pmfid.RIV(drive, encoder, DT, 100 / 3, forgetting=0.99, initial=START).run(u, scenario.counts)
        assert_near(track.theta[1000:].mean(axis=0), TRUTH, [0.005, 0.005, 0.02])
        assert not np.any(track.has_status(Status.FALLBACK)[1000:])


def test_riv_falls_back_and_recovers(drive):
    """The start is so wrong that the model leaves the plant: a flag says so, BCRLS takes over, and `riv` returns
    after seconds.
    """
    run = cart_run(1, increments=1024)
    lost = {"mass": 40.0, "viscous_friction": 1.0, "coulomb_friction": 5.5}
    track = pmfid.RIV(drive, run.encoder, DT, 100 / 3, forgetting=0.99, initial=lost).run(run.u, run.counts)
    assert np.any(track.has_status(Status.FALLBACK))
    assert not np.any(track.has_status(Status.FALLBACK)[1500:])
    assert_near(track.theta[1500:].mean(axis=0), TRUTH, [0.01, 0.01, 0.05])


def test_the_verdict_knows_the_bias_of_other_methods(drive):
    scenario = make_scenario("stop-and-go", seed=1, increments=256)
    encoder, u, counts = pmfid.Encoder(scenario.resolution), scenario.motion.u, scenario.counts
    for cls in (pmfid.BCLS, pmfid.LS):
        estimator = cls(drive, encoder, DT, 100 / 3)
        fit = estimator.fit(u, counts)
        assert "biased" in codes(verdict(estimator, u, counts, fit.theta, fit.theta_std, 0.01).findings)
    run = cart_run(3, increments=1024)
    estimator = pmfid.IV(drive, run.encoder, DT, 100 / 3)
    fit = estimator.fit(run.u, run.counts)
    assert codes(verdict(estimator, run.u, run.counts, fit.theta, fit.theta_std, 0.01).findings) == ()


@needs_emps
@pytest.mark.parametrize(
    ("step", "cutoff", "within"),
    [(5e-8, 100.0, (0.01, 0.02, 0.02)), (1e-3, 100.0, (0.02, 0.04, 0.04)), (2e-3, 20.0, (0.03, 0.06, 0.06))],
)
def test_emps(step, cutoff, within):
    """Direction and standstill come from the model alone; published values are 95.11, 203.5, 20.39."""
    u, q = emps_record()
    fit = pmfid.IV(pmfid.Drive(1.0, offset=True), pmfid.Encoder(step), 1e-3, cutoff).fit(u, quantize(q, step))
    np.testing.assert_allclose(fit.theta[:3] / [95.1089, 203.5034, 20.3935], np.ones(3), atol=max(within))
    assert np.all(np.abs(fit.theta[:3] / [95.1089, 203.5034, 20.3935] - 1) < within)


@needs_emps
def test_emps_friction_by_direction():
    """Published values are 95.15, 166.7, 240.4, 20.14, 20.63; at 200 rad/s all are within 3 %."""
    u, q = emps_record()
    drive = pmfid.Drive(1.0, friction="directional")
    fit = pmfid.IV(drive, pmfid.Encoder(5e-8), 1e-3, 200.0).fit(u, quantize(q + 1e-12, 5e-8))
    published = [95.154, 166.7061, 240.4236, 20.1440, 20.6277]
    np.testing.assert_allclose(fit.theta, published, rtol=0.03)
    track = pmfid.RIV(drive, pmfid.Encoder(5e-8), 1e-3, 200.0).run(u, quantize(q + 1e-12, 5e-8))
    np.testing.assert_allclose(track.theta[-1], published, rtol=0.08)
    refused(("use iv", lambda: pmfid.BCLS(drive, pmfid.Encoder(5e-8), 1e-3, 200.0)))


def emps_record() -> tuple[np.ndarray, np.ndarray]:
    record = scipy.io.loadmat(EMPS)
    return record["vir"].ravel() * float(record["gtau"][0, 0]), record["qm"].ravel()


@pytest.mark.parametrize("name", ["mass-step", "stop-and-go-mass-step"])
@pytest.mark.parametrize("increments", [4096, 256])
@pytest.mark.parametrize("time_constant", [2, 5])
def test_riv_never_spikes(name, increments, time_constant, drive):
    """From 1 s on, no estimate is outside 0.7 to 1.5 of the true mass, except in the second after the mass step."""
    for seed in range(4):
        scenario = make_scenario(name, seed=seed, increments=increments)
        n = scenario.counts.size
        track = pmfid.RIV(drive, pmfid.Encoder(scenario.resolution), DT, 1 / (time_constant * DT), forgetting=0.99).run(
            scenario.motion.u, scenario.counts
        )
        ratio = track["mass"] / np.where(np.arange(n) < n // 2, 1.07, 1.44)
        late = np.r_[ratio[100 : n // 2], ratio[n // 2 + 100 :]]
        assert late.min() > 0.7
        assert late.max() < 1.5


def test_judge_knows_what_the_encoder_explains(drive):
    """The error of the equation is that of the encoder's step, unless the input is 2 ms late."""
    from pmfid.simulation.drive import simulate_drive
    from pmfid.simulation.scenarios import CART, resolution_of

    run = cart_run(1, increments=1024)
    estimator = pmfid.IV(drive, run.encoder, DT, 100 / 3)
    fit = estimator.fit(run.u, run.counts)
    columns = estimator.columns_at(fit.theta, run.u, run.counts)
    error = columns.z - columns.phi @ fit.theta
    assert np.mean(error**2) == pytest.approx(fit.theta @ estimator.noise() @ fit.theta, rel=0.1)
    late = np.r_[np.zeros(2), np.repeat(run.u, 10)[:-2]]
    counts = quantize(simulate_drive(CART, late, DT / 10).x[::10], resolution_of(1024))
    fit = estimator.fit(run.u, counts)
    assert "dead_time" in codes(verdict(estimator, run.u, counts, fit.theta, fit.theta_std, 0.01).findings)

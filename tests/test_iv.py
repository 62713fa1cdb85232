"""Instrumental variables with the auxiliary model: reversals, standstill, real data."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.io

import pmfid
from pmfid import Status, _kernel32, _kernel64
from pmfid.encoder import quantize
from pmfid.simulation.drive import DriveParameters, simulate_drive
from pmfid.simulation.scenarios import make_scenario
from pmfid.simulation.signals import prbs
from tests.conftest import EMPS, TRUTH, assert_near, cart_run, needs_emps

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


@pytest.mark.parametrize(
    ("parameters", "amplitude"),
    [
        (DriveParameters(1.07, 12.8, 0.8, 2.0), 3.0),
        (DriveParameters(1.07, 12.8, 0.8, 2.0, offset=0.3), 3.0),
        (DriveParameters(95.0, 203.0, 20.0, 35.0, offset=-3.0), 2.0),
        (DriveParameters(1.0, 0.0, 0.5, 1.0), 1.0),
        (DriveParameters(1.07, 12.8, 3.0, 2.0), 3.0),
    ],
)
def test_equals_the_event_driven_simulation(parameters, amplitude):
    """The cases include long stiction (the last case), no damping, and a constant load."""
    dt, rng = 0.01, np.random.default_rng(1)
    u = prbs(2000, clock=7, amplitude=amplitude, rng=rng) * rng.uniform(0.2, 1.0, 2000)
    motion = simulate_drive(parameters, u, dt)
    p = parameters
    roles = (p.mass, p.viscous_friction, p.viscous_friction, p.coulomb_friction, p.coulomb_friction, p.offset, 0.0)
    mean, direction, moving = _kernel64.simulate(roles, p.input_gain, dt, u)
    x = np.r_[0.0, np.cumsum(mean) * dt]
    span = np.ptp(motion.x)
    np.testing.assert_allclose(x[:-1], motion.x, atol=2e-6 * span)
    np.testing.assert_allclose(direction, motion.direction, atol=1e-4)
    np.testing.assert_allclose(moving, motion.moving, atol=1e-4)
    assert np.any(motion.moving < 1) or p.coulomb_friction < 1
    single, *_ = _kernel32.simulate(roles, p.input_gain, dt, u)
    np.testing.assert_allclose(single, mean, atol=1e-3 * np.ptp(mean))


def test_approximant_is_good_at_strong_damping():
    """For damping * dt = 1 the mean velocity is right within 1e-4 of its range."""
    p = DriveParameters(0.128, 12.8, 0.8, 2.0)
    u = prbs(1000, clock=3, amplitude=3.0, rng=np.random.default_rng(2))
    mean, *_ = _kernel64.simulate((p.mass, 12.8, 12.8, 0.8, 0.8, 0.0, 0.0), 2.0, 0.01, u)
    expected = np.diff(simulate_drive(p, u, 0.01).x) / 0.01
    np.testing.assert_allclose(mean[:-1], expected, atol=1e-4 * np.ptp(mean))

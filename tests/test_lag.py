"""An input after a first-order lag: known, estimated, and distinguished from a dead time."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import pmfid
from pmfid import IV, RIV, Drive, Encoder, MotionFit
from pmfid.simulation.drive import DriveParameters, Machine, MachineRun, drive_machine
from tests.test_dead_time import AXES, CART, truth

THETA = np.array(CART[1:4])
#: Steps of the integration per sample: with fewer, the error of the position would show in the counts.
STEPS = 80


@cache
def run_lagged(axis: str, lag: float, dead_time: float = 0.0, switches: int = 250) -> MachineRun:
    """Simulate random steps after a lag and a dead time [samples]."""
    gain, mass, viscous, coulomb, dt, size, step, _ = AXES[axis]
    rng = np.random.default_rng(7)
    u = size * np.repeat(rng.choice([-1.0, 1.0], switches), 6)
    machine = Machine(DriveParameters(mass, viscous, coulomb, gain), lag=lag * dt, dead_time=dead_time * dt)
    return drive_machine(machine, u, dt, step, phase=rng.uniform(0, step), steps=STEPS)


def made(method: type, axis: str, **late: object) -> pmfid.IV:
    gain, _, _, _, dt, _, step, cutoff = AXES[axis]
    return method(Drive(gain, **late), Encoder(step), dt, cutoff)


@pytest.mark.parametrize(("axis", "lag"), [("cart", 0.2), ("wheel", 0.6), ("stage", 0.6)])
def test_the_fit_finds_it_and_instruments_that_are_given_it_agree(axis: str, lag: float) -> None:
    run, dt = run_lagged(axis, lag, switches=100), AXES[axis][4]
    fit = made(MotionFit, axis, lag="estimate").fit(run.u, run.counts)
    assert (fit.names[-1], fit.units[-1]) == ("lag", "s")
    assert fit.theta[-1] / dt == pytest.approx(lag, abs=0.01)
    np.testing.assert_allclose(fit.theta[:3] / truth(axis), 1.0, atol=0.002)
    known = made(IV, axis, lag=float(fit.theta[-1])).fit(run.u, run.counts)
    assert np.all(np.abs(known.theta - truth(axis)) < 4 * known.theta_std + 2e-3 * truth(axis))


def test_next_to_a_dead_time() -> None:
    run = run_lagged("cart", 0.8, 1.3, switches=120)
    fit = made(MotionFit, "cart", lag="estimate", dead_time="estimate").fit(run.u, run.counts)
    assert fit.names[-2:] == ("dead_time", "lag")
    np.testing.assert_allclose(fit.theta[-2:] / 0.01, [1.3, 0.8], atol=0.03)
    np.testing.assert_allclose(fit.theta[:3] / THETA, 1.0, atol=0.005)
    np.testing.assert_array_less(np.abs(fit.theta[:3] - THETA), 3 * fit.theta_std[:3])


@pytest.mark.parametrize("method", [pmfid.LS, pmfid.BCLS, IV])
def test_a_known_lag_leaves_nothing_of_its_bias(method: type) -> None:
    run = run_lagged("cart", 1.2)
    known, none = (made(method, "cart", lag=lag).fit(run.u, run.counts).theta for lag in (0.012, 0.0))
    np.testing.assert_allclose(known / THETA, 1.0, atol=0.03)
    assert abs(none[0] / 1.07 - 1) > 0.15


@pytest.mark.parametrize("method", [pmfid.RLS, pmfid.BCRLS, RIV])
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_a_known_lag_on_line_next_to_a_known_dead_time(method: type, precision: str) -> None:
    run = run_lagged("cart", 0.7, 0.6)
    estimator = method(Drive(2.0, lag=0.007, dead_time=0.006), Encoder(CART[6]), 0.01, 20.0, precision=precision)
    track = estimator.run(run.u, run.counts)
    np.testing.assert_allclose(track.theta[-1] / THETA, 1.0, atol=0.03)

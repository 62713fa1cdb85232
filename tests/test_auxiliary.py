"""The kernel's auxiliary model against the exact simulation of the cart."""

from __future__ import annotations

import numpy as np
import pytest

from pmfid import _kernel32, _kernel64
from pmfid.simulation.drive import DriveParameters, simulate_drive
from pmfid.simulation.signals import prbs


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

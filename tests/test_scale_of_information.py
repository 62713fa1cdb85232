"""A memory counts time: after a large motion, the estimate still follows a smaller one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pmfid
from pmfid import Status
from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, Schedule, prbs, quantize, simulate_drive
from studies.machines import AXES
from tests.test_forgetting import RECURSIVE

MEMORY = 500
LOADED = replace(CART, mass=1.3 * CART.mass)


def amplitude_step(before: float, after: float, seed: int):
    """Return u and counts: ten memories at one amplitude, two at the other, then three with another mass."""
    ends = np.cumsum([10, 2, 3]) * MEMORY
    u = prbs(int(ends[-1]), clock=10, amplitude=1.0, rng=np.random.default_rng(seed))
    u[: ends[0]] *= before
    u[ends[0] :] *= after
    motion = simulate_drive(Schedule(((0.0, CART), (ends[1] * CART_DT, LOADED))), u, CART_DT)
    return u, quantize(motion.x, CART_RESOLUTION)


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize(("before", "after"), [(1.0, 1.0), (12.0, 1.0), (30.0, 1.0), (4.0, 1.0), (1.0, 100.0)])
@pytest.mark.parametrize("cls", RECURSIVE)
def test_a_change_of_mass_is_followed_after_a_change_of_amplitude(cls, before, after, precision, drive):
    options = {"forgetting": 1 - 1 / MEMORY, "precision": precision}
    for seed in range(2):
        track = cls(drive, pmfid.Encoder(CART_RESOLUTION), CART_DT, 50.0, **options).run(
            *amplitude_step(before, after, seed)
        )
        np.testing.assert_allclose(track["mass"][-1], LOADED.mass, rtol=0.05)
        assert not track.has_status(Status.POOR_EXCITATION)[-1]


@pytest.mark.parametrize("cls", [pmfid.BCRLS, pmfid.RIV])
@pytest.mark.parametrize("seed", range(2))
def test_a_motion_that_the_encoder_shows_only_in_the_mean_is_enough(cls, seed):
    """Single accelerations of the rotary axis are within the error of its encoder, after ten times this input."""
    axis, ends = AXES["rotary"], np.cumsum([10, 2, 3]) * MEMORY
    least = 4 * axis.drive.coulomb_friction / axis.drive.input_gain
    u = prbs(int(ends[-1]), clock=axis.clock, amplitude=least, rng=np.random.default_rng([seed, 13]))
    u[: ends[0]] *= 10
    loaded = replace(axis.drive, mass=1.3 * axis.drive.mass)
    motion = simulate_drive(Schedule(((0.0, axis.drive), (float(ends[1]) * axis.dt, loaded))), u, axis.dt)
    encoder, model = pmfid.Encoder(axis.resolution), pmfid.Drive(axis.drive.input_gain)
    estimator = cls(model, encoder, axis.dt, 1 / 3 / axis.dt, forgetting=1 - 1 / MEMORY)
    mass = estimator.run(u, quantize(motion.x, axis.resolution))["mass"][-1]
    np.testing.assert_allclose(mass, loaded.mass, rtol=0.05)


@pytest.mark.parametrize("cls", [pmfid.RLS, pmfid.BCRLS, pmfid.RIV])
def test_rest_and_a_constant_speed_after_a_large_motion_are_harmless(cls, drive):
    """Each part lasts half an hour: the estimate stays, is flagged as held, and follows again at once."""
    head, still = 1000, 180_000
    wave = prbs(head + MEMORY, clock=10, amplitude=12.0, rng=np.random.default_rng(5))
    u = np.r_[wave[:head], np.zeros(still), np.full(still, 1.0), wave[head:]]
    counts = quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION)
    track = cls(drive, pmfid.Encoder(CART_RESOLUTION), CART_DT, 50.0, forgetting=0.99).run(u, counts)
    for end in (head + still - 1, head + 2 * still - 1):
        assert track.has_status(Status.POOR_EXCITATION)[end]
        np.testing.assert_allclose(track["mass"][end], CART.mass, rtol=0.03)
    np.testing.assert_allclose(track["mass"][-1], CART.mass, rtol=0.01)

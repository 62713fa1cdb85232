"""A memory is one of time: what a larger motion told before does not make the estimate deaf to a smaller one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pmfid
from pmfid import Status
from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, Schedule, prbs, quantize, simulate_drive
from tests.test_forgetting import CASES

MEMORY = 500
LOADED = replace(CART, mass=1.3 * CART.mass)


def amplitude_step(before: float, after: float, seed: int):
    """Ten memories at one amplitude, two at the other, then another mass for three; u and counts."""
    ends = np.cumsum([10, 2, 3]) * MEMORY
    u = prbs(int(ends[-1]), clock=10, amplitude=1.0, rng=np.random.default_rng(seed))
    u[: ends[0]] *= before
    u[ends[0] :] *= after
    motion = simulate_drive(Schedule(((0.0, CART), (ends[1] * CART_DT, LOADED))), u, CART_DT)
    return u, quantize(motion.x, CART_RESOLUTION)


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize(("before", "after"), [(1.0, 1.0), (12.0, 1.0), (30.0, 1.0), (4.0, 1.0), (1.0, 100.0)])
@pytest.mark.parametrize(("cls", "scheme"), [case for case in CASES if case[0] is not pmfid.RKnownStep])
def test_a_change_of_mass_is_followed_after_a_change_of_amplitude(cls, scheme, before, after, precision, drive):
    options = {"forgetting": 1 - 1 / MEMORY, "forgetting_scheme": scheme, "precision": precision}
    for seed in range(2):
        track = cls(drive, pmfid.Encoder(CART_RESOLUTION), CART_DT, 50.0, **options).run(
            *amplitude_step(before, after, seed)
        )
        np.testing.assert_allclose(track["mass"][-1], LOADED.mass, rtol=0.05)
        assert not track.flagged(Status.POOR_EXCITATION)[-1]


@pytest.mark.parametrize("cls", [pmfid.RLS, pmfid.BCRLS, pmfid.RIV])
def test_rest_and_a_constant_speed_after_a_large_motion_are_harmless(cls, drive):
    """Half an hour of each: the estimate stays, is said to be held, and is there again at once."""
    head, still = 1000, 180_000
    wave = prbs(head + MEMORY, clock=10, amplitude=12.0, rng=np.random.default_rng(5))
    u = np.r_[wave[:head], np.zeros(still), np.full(still, 1.0), wave[head:]]
    counts = quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION)
    track = cls(drive, pmfid.Encoder(CART_RESOLUTION), CART_DT, 50.0, forgetting=0.99).run(u, counts)
    for end in (head + still - 1, head + 2 * still - 1):
        assert track.flagged(Status.POOR_EXCITATION)[end]
        np.testing.assert_allclose(track["mass"][end], CART.mass, rtol=0.03)
    np.testing.assert_allclose(track["mass"][-1], CART.mass, rtol=0.01)

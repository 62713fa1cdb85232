"""A memory counts time: after a large motion, the estimate still follows a smaller one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pmfid
from pmfid import Status
from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, Schedule, prbs, quantize, simulate_drive
from studies.scale import outcomes
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


@pytest.mark.parametrize("factor", [1 / 100, 1 / 30])
def test_the_instruments_forget_a_large_input_as_the_sums_do(factor):
    """For bcrls, the memory of the slow pre-filter zero ends within the memory of the estimator."""
    found = [one for one in outcomes("cart", factor, 4) if one.setting.method == "bcrls"]
    assert max(one.error for one in found) < 0.05
    assert not any(one.flagged for one in found)


def test_a_motion_that_the_encoder_shows_only_in_the_mean_is_enough():
    """Single accelerations of the rotary axis are within the error of its encoder."""
    assert max(one.error for one in outcomes("rotary", 1 / 10, 4)) < 0.05


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

"""Exponential forgetting with a bounded covariance, through rest, constant speed and a change of mass."""

from dataclasses import replace

import numpy as np
import pytest

import pmfid
from pmfid.simulation import CART, CART_DT, Schedule, prbs, quantize, resolution_of, simulate_drive

CUTOFF, FORGETTING = 50.0, 0.99
RECURSIVE = (pmfid.RLS, pmfid.BCRLS, pmfid.RIV)


def gap_record(increments=4096, still=3000, coast=3000, head=2000):
    """Return u, counts, resolution and the start of the last part. The parts are a PRBS, a rest, constant speed, and a
    PRBS with another mass."""
    moves = prbs(2 * head, clock=10, amplitude=3.0, rng=np.random.default_rng(3))
    u = np.r_[moves[:head], np.zeros(still), np.ones(coast), moves[head:]]
    change = head + still + coast
    loaded = Schedule(((0.0, CART), (change * CART_DT, replace(CART, mass=1.44))))
    resolution = resolution_of(increments)
    return u, quantize(simulate_drive(loaded, u, CART_DT).x, resolution), resolution, change


def make(cls, resolution, precision="float64"):
    options = {"forgetting": FORGETTING, "precision": precision}
    return cls(pmfid.Drive(CART.input_gain), pmfid.Encoder(resolution), CART_DT, CUTOFF, **options)


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("cls", RECURSIVE)
def test_a_gap_is_survived_and_the_new_mass_is_found(cls, precision):
    u, counts, resolution, change = gap_record()
    track = make(cls, resolution, precision).run(u, counts)
    assert np.all(np.isfinite(track.theta))
    np.testing.assert_allclose(track["mass"][1000:2000], CART.mass, rtol=0.005)
    np.testing.assert_allclose(track["mass"][2000 : change - 1], CART.mass, rtol=0.06)
    np.testing.assert_allclose(track["mass"][-1], 1.44, rtol=0.01)

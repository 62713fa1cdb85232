"""Steps compiled for one method: used if possible, with the bits of the general step."""

from __future__ import annotations

import numpy as np
import pytest

import pmfid
from pmfid.simulation import CART_DT
from tests.conftest import cart_run

METHODS = [pmfid.RLS, pmfid.BCRLS, pmfid.RIV]


@pytest.mark.parametrize("forgetting", [0.99, 1.0])
@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("cls", METHODS)
def test_bits_are_those_of_the_general_step(cls, precision, forgetting):
    """The bits are also equal for wrong counts, an input that is not a number, and an axis at rest."""
    run = cart_run(1, increments=2**14)
    u, counts = run.u.copy(), run.counts.copy()
    u[700:706], u[1500] = np.nan, 1e9
    counts[1100] += 900
    counts[1900:] += 77
    u[2300:], counts[2300:] = 0.0, counts[2300]
    found = []
    for straight in (True, False):
        estimator = cls(pmfid.Drive(2.0), run.encoder, CART_DT, 50.0, forgetting=forgetting, precision=precision)
        kernel = estimator.kernel
        kernel.straight = straight
        assert kernel.straight == straight
        tracks, last = kernel.run(u, counts), kernel.step(1.0, int(counts[-1]))
        found.append((*tracks, np.frombuffer(kernel.raw_state(True), np.uint32), last.theta_cov, last.theta_std))
    for one, other in zip(*found, strict=True):
        assert np.array_equal(one, other)


@pytest.mark.parametrize("cls", METHODS)
def test_other_configurations_take_the_general_step(cls, drive):
    def is_straight(model=drive, **options):
        return cls(model, pmfid.Encoder(1e-5), CART_DT, 50.0, **options).kernel.straight

    assert is_straight()
    assert not is_straight(pmfid.Drive(2.0, offset=True))
    assert not is_straight(order=3)
    assert not is_straight(steps="given")
    assert not is_straight(pmfid.Drive(2.0, gravity=True))

"""Records that are longer than a stretch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmfid import IV, Drive, Encoder, identify, quantize
from pmfid.estimators import iv
from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, simulate_drive
from pmfid.types import Counts, Floats
from tests.tuned import set_tuning

STRETCH, SAMPLES = 900, 1500
METHOD = IV(Drive(CART.input_gain), Encoder(CART_RESOLUTION), CART_DT, 20.0)


@pytest.fixture(autouse=True)
def _short_stretch(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let records of few samples count as long."""
    set_tuning(monkeypatch, iv, stretch=STRETCH)


def record(seed: int, **later: float) -> tuple[Floats, Counts]:
    """Return a record in whose last sixth some parameters are `later` times as large."""
    u = prbs(SAMPLES, clock=10, amplitude=4.0, rng=np.random.default_rng(seed))
    changed = replace(CART, **{name: factor * getattr(CART, name) for name, factor in later.items()})
    motion = simulate_drive(((0.0, CART), (5 * SAMPLES * CART_DT / 6, changed)), u, CART_DT)
    return u, quantize(motion.x, CART_RESOLUTION)


def test_a_long_record_settles_where_the_whole_iteration_does(monkeypatch: pytest.MonkeyPatch) -> None:
    u, counts = record(5)
    found = METHOD.settle_iteration(u, counts)[1]
    set_tuning(monkeypatch, iv, stretch=SAMPLES)
    np.testing.assert_allclose(found, METHOD.settle_iteration(u, counts)[1], rtol=1e-6)


def test_a_parameter_that_changes_late_in_a_long_record_is_found() -> None:
    u, counts = record(7, mass=1.1)
    result = identify(u, counts, model=METHOD.model, dt=CART_DT, encoder=METHOD.encoder, method="ls")
    assert "unmodelled" in result.status

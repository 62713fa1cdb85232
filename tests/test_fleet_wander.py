"""Friction that varies slowly is no step or drift, and it does not hide steps and drifts."""

from __future__ import annotations

import numpy as np
import pytest

from pmfid.fleet.series import Series
from pmfid.fleet.verdicts import CHANGED, AxisVerdict, follow_axis, judge_axes
from pmfid.types import Floats
from tests.test_fleet_changes import NAMES, SEGMENT, series

N = 40
THETA, BARS = np.array([64.0, 10.0, 2.5]), np.array([0.002, 0.006, 0.008])


def seen(rng: np.random.Generator, factors: Floats) -> Series:
    """Return segments of an axis whose parameters are scaled by factors (n, p)."""
    std = THETA * BARS * np.exp(0.3 * rng.standard_normal((len(factors), 1)))
    return series(THETA * factors + std * rng.standard_normal(factors.shape), std)


def friction(wave: Floats) -> Floats:
    """Return factors (n, p): viscous friction follows the wave, Coulomb friction a part of it, the mass stays."""
    return 1 + wave[:, None] * [0.0, 1.0, 0.7]


def sinusoid(rng: np.random.Generator, n: int = N) -> Floats:
    wave = 0.05 * np.sin(2 * np.pi * rng.uniform(0.6, 2.5) * np.arange(n) / n + rng.uniform(0, 2 * np.pi))
    return np.asarray(wave)


def walk(rng: np.random.Generator, n: int = N) -> Floats:
    steps = np.cumsum(rng.standard_normal(n))
    return np.asarray(0.035 * (steps - steps.mean()) / steps.std())


def verdicts(fleet: list[Series]) -> list[AxisVerdict]:
    """Judge axes that each have their own type, so that only their past counts."""
    follows = [follow_axis(f"a{k}", str(k), one, NAMES, 0.02) for k, one in enumerate(fleet)]
    return judge_axes(follows, NAMES, 0.02)


@pytest.mark.parametrize("wave", [sinusoid, walk])
@pytest.mark.parametrize("factor", [0.85, 1.1, 1.25])
def test_a_step_of_the_mass_next_to_it_keeps_cause_and_time(wave: object, factor: float) -> None:
    rng = np.random.default_rng(3)
    factors = [friction(wave(rng)) for _ in range(10)]  # type: ignore[operator]
    for k, one in enumerate(factors):
        one[10 + 2 * k :, 0] *= factor
    found = verdicts([seen(rng, factor) for factor in factors])
    assert sum(one.cause == "mass" for one in found) >= 9  # friction may vary in the same way by chance
    for k, one in enumerate(found):
        assert one.kind == CHANGED
        assert abs(one.since - SEGMENT * (10 + 2 * k)) <= SEGMENT

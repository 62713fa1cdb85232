"""Two versions of a machine under one name: neither half is named, but an odd axis within a half is."""

from __future__ import annotations

import numpy as np
import pytest

from pmfid.fleet.changes import sorts_of
from pmfid.fleet.history import _sorts
from pmfid.fleet.verdicts import DIFFERS, Follow, follow_axis, judge_axes
from pmfid.types import Floats
from tests.test_fleet_changes import NAMES, series

BARS = np.array([0.002, 0.005, 0.008])


def fleet(masses: Floats, seed: int = 0) -> list[Follow]:
    """Return axes of one type with these masses; the parameters of each machine scatter by 5 %."""
    rng = np.random.default_rng(seed)
    theta = np.stack([masses, np.full(masses.size, 10.0), np.full(masses.size, 2.5)], axis=1)
    theta *= np.exp(0.05 * rng.standard_normal(theta.shape))
    noise = rng.standard_normal((masses.size, 10, 3))
    return [
        follow_axis(f"a{k}", "press", series(own * (1 + BARS * some), np.tile(own * BARS, (10, 1))), NAMES, 0.02)
        for k, (own, some) in enumerate(zip(theta, noise, strict=True))
    ]


@pytest.mark.parametrize("second", [30, 12])
@pytest.mark.parametrize("factor", [0.6, 1.8])
def test_two_versions_are_reported_and_neither_is_named(second: int, factor: float) -> None:
    masses = np.r_[np.full(60 - second, 1.0), np.full(second, factor)]
    follows = fleet(masses)
    assert not any(one.named for one in judge_axes(follows, NAMES, 0.02))
    reported = _sorts(follows, NAMES, 0.02)
    assert [(one.code, one.part) for one in reported] == [("several_sorts", "type press")]
    assert "2 kinds of machines differ in mass" in reported[0].text
    assert f"{second} around {factor:.1g}"[:10] in reported[0].text


@pytest.mark.parametrize("odd", [0.6, 1.4, 2.8])
def test_who_differs_from_his_own_version_is_named(odd: float) -> None:
    """The spread over both versions once hid the odd axis."""
    masses = np.r_[np.full(30, 1.0), np.full(30, 2.0)]
    masses[7] = odd
    found = judge_axes(fleet(masses), NAMES, 0.02)
    assert [(k, one.kind) for k, one in enumerate(found) if one.named] == [(7, DIFFERS)]


@pytest.mark.parametrize("axes", [8, 16, 40, 200])
def test_one_sort_is_not_parted(axes: int) -> None:
    rng = np.random.default_rng(axes)
    for _ in range(20):
        assert len(sorts_of(0.1 * rng.standard_normal((axes, 3)), 8, 0.02)) == 1
        assert len(sorts_of(0.05 * rng.standard_t(3, (axes, 3)), 8, 0.02)) == 1


def test_a_few_odd_ones_are_no_sort() -> None:
    masses = np.ones(100)
    masses[:6] = 1.9
    follows = fleet(masses)
    assert not _sorts(follows, NAMES, 0.02)
    assert [k for k, one in enumerate(judge_axes(follows, NAMES, 0.02)) if one.named] == list(range(6))

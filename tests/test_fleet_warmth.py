"""Histories whose friction follows a temperature: a daily cycle is no wear, and wear next to it is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from pmfid.fleet import estimate
from pmfid.fleet.series import Series, widen_errors
from pmfid.fleet.verdicts import CHANGED, DRIFTS, AxisVerdict, follow_axis, judge_axes
from pmfid.fleet.warmth import remove_warmth
from pmfid.simulation import CART
from studies.monitoring.warm_axis import DRY, DT, RATE, RESOLUTION, record

NAMES, HOUR = ("mass", "viscous_friction", "coulomb_friction"), 3600.0


def history(seed: int, hours: int, loss: float = 0.0, step: float = 0.0) -> Series:
    """Return hourly estimates with an error of 0.5 %, and friction that varies by 15 % each day.

    Friction also loses a part per hour, and changes by a `step` in the middle.
    """
    rng, hour = np.random.default_rng(seed), np.arange(hours, dtype=np.float64)
    hot = 30 + 10 * np.sin(2 * np.pi * hour / 24) + 2 * rng.standard_normal(hours)
    wear = (1 - loss * hour) * np.where(hour >= hours // 2, 1 + step, 1.0)
    dry = 2.5 * (1 - 0.015 * (hot - 30)) * wear
    theta = np.stack([np.full(hours, 1.07), np.full(hours, 12.8), dry], axis=1)
    std = 0.005 * np.array([1.07, 12.8, 2.5]) * np.ones((hours, 1))
    theta = theta + std * rng.standard_normal(theta.shape)
    whole, nothing = np.full(hours, 3000), np.zeros(hours)
    return Series(
        HOUR * hour, HOUR * (hour + 1), whole, nothing, nothing + 0.02, nothing.astype(np.uint32), theta, std, hot
    )


def judge(series: Series, tolerance: float) -> AxisVerdict:
    same = widen_errors(remove_warmth(series, NAMES))
    return judge_axes([follow_axis("a", "", same, NAMES, tolerance)], NAMES, tolerance)[0]


def blind(series: Series) -> Series:
    return replace(series, temperature=None)


@pytest.mark.parametrize("hours", [12, 30, 300])
def test_a_daily_cycle_is_no_change(hours: int) -> None:
    """Without the temperature, only a far larger step would be visible."""
    verdicts = [judge(history(seed, hours), 0.005) for seed in range(20)]
    assert sum(one.named for one in verdicts) <= 1
    without = [judge(blind(history(seed, hours)), 0.005).visible for seed in range(5)]
    assert np.median([one.visible for one in verdicts]) < 0.3 * np.median(without)


@pytest.mark.parametrize("loss", [0.1, -0.1])
def test_wear_next_to_the_cycle_is_named(loss: float) -> None:
    """A loss of 10 % in 300 h is named in its first half, and never without the temperature."""
    worn = [history(seed, 150, loss / 300) for seed in range(10)]
    verdicts = [judge(one, 0.005) for one in worn]
    assert {(one.kind, one.cause) for one in verdicts} == {(DRIFTS, "coulomb_friction")}
    assert np.mean([one.size * one.days for one in verdicts]) == pytest.approx(-loss / 2, abs=0.003)
    assert not any(judge(blind(one), 0.005).named for one in worn)


def test_a_step_next_to_the_cycle_is_a_step() -> None:
    verdict = judge(history(1, 100, step=-0.05), 0.01)
    assert (verdict.kind, verdict.cause) == (CHANGED, "coulomb_friction")
    assert verdict.size == pytest.approx(-0.05, abs=0.004)


def test_a_history_too_short_for_the_rate_stays() -> None:
    short = history(1, 6)
    assert remove_warmth(short, NAMES) is short


def test_rows_with_a_temperature_become_segments_with_one() -> None:
    u, counts, hot = record(3, 20.0, 0.15)
    rows = {"axis": np.full(u.size, "a"), "t": DT * np.arange(u.size), "u": u, "counts": counts, "temp": hot}
    columns = {"time": "t", "input": "u", "output": "counts", "output_kind": "counts"}
    axis = {"encoder": {"resolution": RESOLUTION}, "model": {"input_gain": CART.input_gain}}
    with_it = columns | {"friction_temperature": "temp"}
    seen, unseen = (
        estimate(pl.DataFrame(rows), axis=axis | {"record": keys}, by="axis", period="run", segment=30.0).axes
        for keys in (with_it, columns)
    )
    assert seen["visible"][0] < 0.5 * unseen["visible"][0]
    assert seen["coulomb_friction"][0] == pytest.approx(DRY.coulomb_friction * (1 + RATE * (hot.mean() - 30)), rel=0.01)

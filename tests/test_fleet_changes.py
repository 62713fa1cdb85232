"""The place of a step while another parameter moves, on segments of given numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmfid.fleet.changes import step_of, trend_of
from pmfid.fleet.series import Series, mean_of, widen_errors
from pmfid.fleet.verdicts import CHANGED, DRIFTS, STOPPED, AxisVerdict, follow_axis, judge_axes, sentence
from pmfid.types import Floats

NAMES = ("mass", "viscous_friction", "coulomb_friction")
SEGMENT, N = 60.0, 16


def series(theta: Floats, std: Floats) -> Series:
    """Return usable segments."""
    n = len(theta)
    start = SEGMENT * np.arange(n)
    counts = np.full(n, 3000)
    return Series(start, start + SEGMENT, counts, np.zeros(n), np.full(n, 0.02), np.zeros(n, np.uint32), theta, std)


def breathing(rng: np.random.Generator, place: int, factor: float, phase: float) -> Series:
    """Return segments with a step of the mass, and with friction that varies by 3 % with the temperature.

    The segment of the step has samples of both sides, and its status says so.
    """
    wave = 0.03 * np.sin(2 * np.pi * 1.3 * np.arange(N) / N + phase)
    std = np.tile([5e-3, 0.08, 0.01], (N, 1)) * np.exp(0.3 * rng.standard_normal((N, 1)))
    theta = np.stack([np.full(N, 90.0), 120 * (1 + wave), 18 * (1 + 0.3 * wave)], axis=1)
    theta[place:, 0] *= factor
    theta[place - 1, 0] *= 1 + 0.6 * (factor - 1)
    std[place - 1] *= 300
    return series(theta + std * rng.standard_normal((N, 3)), std)


@pytest.mark.parametrize("seed", range(6))
def test_a_step_next_to_friction_that_breathes_is_a_step(seed: int) -> None:
    """The variation of the friction was once taken for the beginning of the step, and a drift then fitted better."""
    rng = np.random.default_rng(seed)
    place, factor = int(rng.integers(5, 12)), float(rng.choice([0.85, 1.2]))
    one = breathing(rng, place, factor, rng.uniform(0, 2 * np.pi))
    step = step_of(one, NAMES, 0.02)
    assert step is not None
    assert step.since in (SEGMENT * (place - 1), SEGMENT * place)
    verdict = judge_axes([follow_axis("a", "", one, NAMES, 0.02)], NAMES, 0.02)[0]
    assert verdict.kind == CHANGED
    assert abs(step.relative[0] - (factor - 1)) < 0.005


def test_a_step_in_a_segment_that_says_nothing_came_there() -> None:
    """The step was once reported for the following segment, in which nothing happened."""
    rng = np.random.default_rng(5)
    whole = breathing(rng, 9, 1.2, 0.0)
    step = step_of(whole[np.arange(N) != 8], NAMES, 0.02)
    assert step is not None
    assert (step.since, step.until) == (SEGMENT * 8, SEGMENT * 10)


def test_a_drift_of_minutes_is_not_reported_per_day() -> None:
    quick = AxisVerdict(DRIFTS, 2.0, "mass", size=27.0, std=5.0, days=0.01)
    assert sentence(quick) == "mass drifts by +27 % ± 5 % within 0:14:24"
    assert "per day" in sentence(AxisVerdict(DRIFTS, 2.0, "mass", size=0.01, std=0.001, days=9.0))


@pytest.mark.parametrize("cause", ["mass", "friction", "input_gain"])
def test_a_drift_has_its_cause_and_its_size_from_the_begin_on(cause: str) -> None:
    """An earlier version named the parameter that moved most clearly, with sizes relative to the middle of the
    history.
    """
    rng, n, factor = np.random.default_rng(3), 40, 1.25
    line = np.linspace(1.0, factor, n)
    theta, std = np.tile([90.0, 120.0, 18.0], (n, 1)), np.tile([0.1, 0.5, 0.05], (n, 1))
    which = {"mass": [0], "friction": [1, 2], "input_gain": [0, 1, 2]}[cause]
    theta[:, which] *= (1 / line if cause == "input_gain" else line)[:, None]
    trend = trend_of(series(theta + std * rng.standard_normal((n, 3)), std), NAMES, 0.02)
    assert trend is not None
    assert trend.cause == cause
    assert abs(trend.size - (factor - 1)) < 0.015


def test_a_segment_too_sure_of_itself_is_no_change() -> None:
    """Estimates scatter by 5 %, and a few have bars of 0.01 %: these few once decided the verdict on the axis."""
    named = 0
    for seed in range(10):
        rng, n = np.random.default_rng(seed), 24
        std = np.full((n, 3), 0.02)
        std[rng.choice(n, 3, replace=False)] = 1e-4
        one = series(1 + 0.05 * rng.standard_normal((n, 3)), std)
        named += judge_axes([follow_axis("a", "", widen_errors(one), NAMES, 0.02)], NAMES, 0.02)[0].named
        first, bar = mean_of(widen_errors(one)[:3])
        assert np.all(np.abs(first - 1) < 4 * bar)
    assert named == 0


def test_a_drift_has_one_size_with_an_honest_bar() -> None:
    """The headline was once "+11 % ± 0.04 %" for a drift of +10.4 %, and the table of slopes had another number."""
    rng, n, days = np.random.default_rng(4), 72, 3.0
    time = np.linspace(0.0, days, n)
    theta = np.tile([90.0, 120.0, 18.0], (n, 1))
    theta[:, 1] *= 1 + 0.104 * time
    std = np.tile([0.1, 0.5, 0.2], (n, 1)) * (1 + 0.3 * time[:, None])  # later segments say less
    noise = std * rng.standard_normal((n, 3))
    noise[:, 1] -= 2 * noise[:, 2]
    drifting = replace(series(theta + noise, std), start=86_400 * time, end=86_400 * time + SEGMENT)
    follow = follow_axis("a", "", widen_errors(drifting), NAMES, 0.02)
    verdict = judge_axes([follow], NAMES, 0.02)[0]
    assert (verdict.kind, verdict.cause) == (DRIFTS, "viscous_friction")
    assert abs(verdict.size - 0.104) < 3 * verdict.std
    assert verdict.std < 0.005
    assert follow.trend is not None
    assert 86_400 * follow.trend.slopes[1] == pytest.approx(verdict.size)
    assert 86_400 * follow.trend.stds[1] == pytest.approx(verdict.std)
    assert (
        sentence(replace(verdict, size=0.10612, std=0.0004)) == "viscous friction drifts by +10.61 % ± 0.04 % per day"
    )


def test_an_axis_that_stopped_delivering_is_named() -> None:
    rng = np.random.default_rng(6)
    whole = [series(1 + 0.01 * rng.standard_normal((N, 3)), np.full((N, 3), 0.01)) for _ in range(5)]
    follows = [follow_axis(f"x{k}", "", one[: 8 if k == 2 else N], NAMES, 0.02) for k, one in enumerate(whole)]
    verdicts = judge_axes(follows, NAMES, 0.02)
    assert [verdict.named for verdict in verdicts] == [k == 2 for k in range(5)]
    assert verdicts[2].kind == STOPPED
    assert sentence(verdicts[2]) == "no motion in the log since 0:08:00"
    few = [follow_axis(f"x{k}", "", one[: 8 if k else N], NAMES, 0.02) for k, one in enumerate(whole)]
    assert not any(verdict.named for verdict in judge_axes(few, NAMES, 0.02)), "most axes have stopped: a shift ended"

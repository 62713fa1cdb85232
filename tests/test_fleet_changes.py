"""The judgement of a fleet: segments, steps, drifts and wandering."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from pmfid.fleet.changes import sorts_of, step_of, trend_of
from pmfid.fleet.history import History, _sorts
from pmfid.fleet.segments import Share, shares_of
from pmfid.fleet.series import Series
from pmfid.fleet.tuning import TUNING
from pmfid.fleet.verdicts import CHANGED, DIFFERS, AxisVerdict, Follow, follow_axis, judge_axes
from pmfid.report.fleet import moving, write_fleet
from pmfid.types import Counts, Floats

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


SETTLED, QUARTER, SPAN = 20, 250, 20_000


def moves(rests: list[int], length: int = 100) -> Counts:
    """Return counts of moves in alternating directions, each after its rest [samples]."""
    steps = np.concatenate([np.r_[np.zeros(rest, int), np.full(length, (-1) ** k)] for k, rest in enumerate(rests)])
    return np.r_[0, np.cumsum(steps), np.full(5 * TUNING.segments_long * SETTLED, steps.sum())]


def shares(counts: Counts) -> list[Share]:
    return list(shares_of(counts, SETTLED, QUARTER, SPAN))


@pytest.mark.parametrize("rest", [500, 3000, 9000])
def test_every_move_is_in_one_segment_with_as_much_rest_as_settles(rest: int) -> None:
    counts = moves([rest] * 40)
    found = shares(counts)
    places = np.concatenate([one.places for one in found])
    assert np.unique(places).size == places.size
    moving = np.flatnonzero(np.diff(counts)) + 1
    assert np.isin(moving, places).all() or rest == 500  # the last samples of whole segments may also be too few
    assert places.size < moving.size + 40 * 2 * (SETTLED + 1) + 5 * SETTLED
    assert all(one.places[-1] - one.places[0] < SPAN for one in found)


def test_few_moves_follow_themselves_without_a_jump_and_count_once() -> None:
    one = shares(moves([3000, 3000, 3000]))[0]
    counts = one.counts(moves([3000, 3000, 3000]))
    assert counts.size == one.size == 4 * QUARTER
    assert np.abs(np.diff(counts)).max() == 1
    assert one.repeats == pytest.approx(one.size / one.places.size)
    assert one.repeats > 2


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


def alike(axes: int) -> list[AxisVerdict]:
    """Return the verdicts on axes whose segments have the same numbers: a spread of zero."""
    one = series(np.tile([1.0, 10.0, 2.0], (N, 1)), np.tile([0.01, 0.1, 0.02], (N, 1)))
    return judge_axes([follow_axis(f"a{k}", "", one, NAMES, 0.02) for k in range(axes)], NAMES, 0.02)


@pytest.mark.parametrize("axes", [2, 3, 12])
def test_axes_that_are_all_alike_are_not_named(axes: int) -> None:
    assert [verdict.kind for verdict in alike(axes)] == [""] * axes


def history(axes: int, deviation: float) -> History:
    rows = [
        {"axis": f"a{k}", "type": "", "named": k == 0, "kind": "changed" if k == 0 else "", "score": 2.0 - k}
        | {"cause": "mass", "size": 0.2, "std": 0.01, "why": "mass +20.0 % ± 1.0 % between 0:01:00 and 0:02:00"}
        | {"since": 60.0, "until": 120.0, "segments": 9, "mass": 1.0, "mass_deviation": deviation, "mass_change": 0.0}
        | {"mass_slope": 0.0, "mass_slope_std": 1.0, "visible": 0.1}
        for k in range(axes)
    ]
    period = {"first": 0.0, "last": 60.0, "mass": 1.0, "mass_std": 0.1, "quality": "good", "findings": ""}
    periods = [{"axis": f"a{k}", "period": 0.0} | period for k in range(axes)]
    problems = {"axis": pl.String, "file": pl.String, "code": pl.String, "times": pl.Int64, "from": pl.Float64}
    nothing = pl.DataFrame(schema=problems | {"text": pl.String})
    facts = (("mass",), ("kg",), 900, 60.0, "day")
    return History(pl.DataFrame(periods), pl.DataFrame(rows), nothing, *facts)


def page_of(folder: Path, found: History) -> str:
    write_fleet(folder, found, "lake")
    return (folder / "fleet.html").read_text(encoding="utf-8")


def with_kinds(found: History, kinds: list[str]) -> History:
    named = [kind not in ("", "no estimate", "wanders") for kind in kinds]
    return replace(found, axes=found.axes.with_columns(pl.Series("kind", kinds), pl.Series("named", named)))


def test_axes_without_an_estimate_are_listed_and_counted_in_the_title(tmp_path: Path) -> None:
    """The page once pointed to a table that did not list the axes."""
    page = page_of(tmp_path, with_kinds(history(3, 0.1), ["no estimate", "", ""]))
    assert "<h1>lake: 0 of 3 axes need attention, 1 has no estimate</h1>" in page
    assert "<td>a0</td>" in page.partition("<h2>No estimate</h2>")[2].partition("<h2>")[0]
    nothing = page_of(tmp_path, with_kinds(history(3, 0.1), ["no estimate"] * 3))
    assert "No axis has an estimate" in nothing
    assert "No axis changed" not in nothing


def test_trends_are_drawn_of_what_moves() -> None:
    """The largest distances from other axes once took all the space."""
    found = with_kinds(history(4, 0.1), ["differs", "changed", "drifts", ""])
    assert moving(found)["axis"].to_list() == ["a1", "a2"]

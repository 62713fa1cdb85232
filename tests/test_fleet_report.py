"""The report on a fleet with little knowledge, and its layout on a narrow screen."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from pmfid.fleet.history import History
from pmfid.fleet.verdicts import AxisVerdict, follow_axis, judge_axes
from pmfid.report.fleet import moving, ticks_of, write_fleet
from tests.test_fleet_changes import NAMES, N, series


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


def test_the_title_counts_axes_whose_periods_are_too_few_to_show_a_change() -> None:
    made = history(3, 0.0)
    blind = replace(made, axes=made.axes.with_columns(visible=pl.Series([0.1, math.inf, math.inf])))
    assert blind.title == "1 of 3 axes needs attention, 2 have too few periods to show a change"


def test_few_axes_of_a_type_are_said_to_be_judged_by_their_past_alone(tmp_path: Path) -> None:
    """These axes were once drawn at the median of their type without a notice."""
    write_fleet(tmp_path, history(3, float("nan")), "lake")

    assert "3 axes are of a type with fewer than 8" in (tmp_path / "fleet.html").read_text(encoding="utf-8")


def test_why_an_axis_needs_attention_can_be_read_on_a_narrow_screen(tmp_path: Path) -> None:
    """Long text goes over several lines. An earlier version cut the text off."""
    write_fleet(tmp_path, history(3, 0.1), "lake")
    page = (tmp_path / "fleet.html").read_text(encoding="utf-8")

    assert '<td class="long">mass +20.0 %' in page
    assert "td.long { white-space: pre-line;" in page
    assert "fewer than 8" not in page


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


def test_axes_that_wander_are_distinguished_from_those_that_need_attention(tmp_path: Path) -> None:
    page = page_of(tmp_path, with_kinds(history(3, 0.1), ["changed", "wanders", "wanders"]))
    assert "1 of 3 axes needs attention</h1>" in page
    assert "2 axes wander, which needs no action." in page
    assert "<h2>Axes that wander</h2>" in page


def test_one_name_that_is_a_number_does_not_push_the_reasons_off_the_page(tmp_path: Path) -> None:
    """A number among the names once made their column numeric, and the longest name stayed on one line."""
    found = history(3, 0.1)
    names = pl.Series("axis", ["007", "<b>" + "long" * 40, "漢字"])
    periods = found.periods.with_columns(names)
    found = replace(with_kinds(found, ["changed"] * 3), periods=periods)
    page = page_of(tmp_path, replace(found, axes=found.axes.with_columns(names)))
    assert '<td class="long">&lt;b&gt;longlong' in page
    assert '<td class="number">007' not in page


def test_trends_are_drawn_of_what_moves() -> None:
    """The largest distances from other axes once took all the space."""
    found = with_kinds(history(4, 0.1), ["differs", "changed", "drifts", ""])
    assert moving(found)["axis"].to_list() == ["a1", "a2"]


@pytest.mark.parametrize(
    ("times", "texts"),
    [
        ([1.7e9, 1.7e9 + 30 * 86_400], ["2023-11-14", "2023-12-14"]),
        ([1.7e9, 1.7e9 + 3600], ["11-14\n22:13", "11-14\n23:13"]),
        ([0.0, 600.0], ["0:00:00", "0:10:00"]),
    ],
)
def test_times_of_hours_and_of_months_are_distinguished(times: list[float], texts: list[str]) -> None:
    """All labels of a short history once showed the same date."""
    assert ticks_of(np.array(times)) == texts

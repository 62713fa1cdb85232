"""What the report on a fleet says where it knows little, and how it is read on a narrow screen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from pmfid.fleet.history import History
from pmfid.fleet.verdicts import Verdict, followed, judged
from pmfid.report.fleet import write_fleet
from tests.test_fleet_changes import NAMES, N, series


def alike(axes: int) -> list[Verdict]:
    """Of so many axes whose segments have the same numbers: a spread of zero."""
    one = series(np.tile([1.0, 10.0, 2.0], (N, 1)), np.tile([0.01, 0.1, 0.02], (N, 1)))
    return judged([followed(f"a{k}", "", one, NAMES, 0.02) for k in range(axes)], NAMES, 0.02)


@pytest.mark.parametrize("axes", [2, 3, 12])
def test_axes_that_are_all_alike_are_not_named(axes: int) -> None:
    assert [verdict.kind for verdict in alike(axes)] == [""] * axes


def history(axes: int, deviation: float) -> History:
    rows = [
        {"axis": f"a{k}", "type": "", "named": k == 0, "kind": "changed" if k == 0 else "", "score": 2.0 - k}
        | {"cause": "mass", "size": 0.2, "std": 0.01, "why": "mass +20.0 % ± 1.0 % between 0:01:00 and 0:02:00"}
        | {"since": 60.0, "until": 120.0, "segments": 9, "mass": 1.0, "mass_deviation": deviation, "mass_change": 0.0}
        | {"mass_slope": 0.0, "mass_slope_std": 1.0}
        for k in range(axes)
    ]
    period = {"first": 0.0, "last": 60.0, "mass": 1.0, "mass_std": 0.1, "quality": "good", "findings": ""}
    periods = [{"axis": f"a{k}", "period": 0.0} | period for k in range(axes)]
    problems = {"axis": pl.String, "file": pl.String, "code": pl.String, "times": pl.Int64, "from": pl.Float64}
    nothing = pl.DataFrame(schema=problems | {"text": pl.String})
    facts = (("mass",), ("kg",), 900, 60.0, "day", 1, 0, "local")
    return History(pl.DataFrame(periods), pl.DataFrame(rows), nothing, *facts)


def test_few_axes_of_a_type_are_said_to_be_judged_by_their_past_alone(tmp_path: Path) -> None:
    """They had been drawn at the median of their type without a word."""
    write_fleet(tmp_path, history(3, float("nan")), "lake")

    assert "3 axes are of a type with fewer than 8" in (tmp_path / "fleet.html").read_text(encoding="utf-8")


def test_why_an_axis_needs_attention_can_be_read_on_a_narrow_screen(tmp_path: Path) -> None:
    """What is long goes over several lines, where it had been cut off."""
    write_fleet(tmp_path, history(3, 0.1), "lake")
    page = (tmp_path / "fleet.html").read_text(encoding="utf-8")

    assert '<td class="long">mass +20.0 %' in page
    assert "td.long { white-space: normal;" in page
    assert "fewer than 8" not in page

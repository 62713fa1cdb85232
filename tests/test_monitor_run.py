"""`pmfid monitor`: a record, its events, the page and the tables of estimates."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from pmfid.simulation import CART, CART_DT, Schedule
from studies.monitoring.axis import INCREMENTS, changing
from studies.monitoring.pipe import write_axis
from tests.command import run_command

CHANGE = 15.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write axis.toml, its reference, and run.csv, in which the mass grows by a fifth."""
    place = tmp_path_factory.mktemp("monitor")
    write_axis(place, 300.0)
    heavier = Schedule(((0.0, CART), (CHANGE, replace(CART, mass=1.2 * CART.mass))))
    u, counts = changing(heavier, 5, INCREMENTS, 40.0)
    rows = (f"{k * CART_DT:.2f},{a!r},{b}" for k, (a, b) in enumerate(zip(u.tolist(), counts.tolist(), strict=True)))
    (place / "run.csv").write_text("\n".join(["t,u,counts", *rows]) + "\n")
    return place


def invoke(folder: Path, *arguments: str, code: int = 0) -> str:
    result = run_command("monitor", folder / "run.csv", "--config", folder / "axis.toml", *arguments, code=code)
    return result.stdout if code == 0 else result.output


@pytest.fixture(scope="module")
def read(folder: Path) -> str:
    """Return the output of the command for run.csv; it also writes page.html and out.parquet."""
    return invoke(folder, "--json", "--report", str(folder / "page.html"), "--out", str(folder / "out.parquet"))


def events(text: str, kind: str) -> list[dict[str, Any]]:
    found = [json.loads(line) for line in text.splitlines()]
    return [event for event in found if event["event"] == kind]


def test_a_record_with_a_heavier_load(folder: Path, read: str) -> None:
    (start,), (alarm,) = events(read, "start"), events(read, "alarm")
    assert start["nominal"]["mass"] == pytest.approx(CART.mass, rel=2e-3)
    assert (alarm["parameter"], alarm["direction"], alarm["unit"]) == ("mass", "up", "kg")
    assert alarm["relative"] == pytest.approx(0.2, abs=0.03)
    assert CHANGE < alarm["time"] < CHANGE + 4
    (settled,) = events(read, "settled")
    assert settled["parameters"]["mass"]["change"] == pytest.approx(0.2, abs=0.01)
    assert events(read, "end") == [{"event": "end", "samples": 4000, "outliers": 0, "alarms": 1}]
    table = pl.read_parquet(folder / "out.parquet")
    assert table.height == 4000
    assert table["mass"][-1] == pytest.approx(1.2 * CART.mass, rel=0.01)
    assert {"watching", "suspicious", "settling"} <= set(table["state"])
    page = (folder / "page.html").read_text()
    assert "mass +" in page
    assert "mathdefault" not in page  # formulas are not typeset, because units may contain a $
    assert "<svg" in page
    assert not re.search(r"(src|href)=\"http", page)


def test_estimates_as_text_are_those_of_parquet(folder: Path, read: str) -> None:
    """An existing file is replaced, and no input of the run is."""
    out = folder / "out.csv"
    out.write_text("earlier")
    text = invoke(folder, "--out", str(out))
    assert "ALARM" in text
    assert text.endswith("4000 samples, 1 alarm\n")
    assert pl.read_csv(out).equals(pl.read_parquet(folder / "out.parquet").cast({"status": pl.Int64}))
    for option, name in (("--out", "run.csv"), ("--report", "normal.csv")):
        assert "would replace" in invoke(folder, option, str(folder / name), code=2)
    assert "pmfid serve" in run_command("monitor", "-", code=2).output

"""The demo keeps its promises and computes the numbers that it shows."""

from __future__ import annotations

import math
import re
from io import StringIO
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

import pmfid
from examples.demo.__main__ import main
from examples.demo.report import demo_table, findings, write_demo
from examples.demo.run import (
    COLUMNS,
    INCREMENTS,
    METHODS,
    DemoResult,
    run_demo,
    settling_time,
)
from pmfid.simulation import make_scenario, resolution_of


@pytest.fixture(scope="module")
def result() -> DemoResult:
    return run_demo()


@pytest.fixture(scope="module")
def folder(result: DemoResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the demo and return its folder."""
    place = tmp_path_factory.mktemp("demo")
    write_demo(place, result)
    return place


def printed(result: DemoResult, width: int) -> str:
    console = Console(file=StringIO(), width=width)
    console.print(demo_table(result))
    text = console.file.getvalue()  # type: ignore[attr-defined]
    assert isinstance(text, str)
    return text


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_bcrls_finds_the_mass_with_every_encoder(seed: int) -> None:
    rows = run_demo(seed).rows_of("BCRLS")
    assert [row.increments for row in rows] == list(INCREMENTS)
    assert all(row.worst("mass") < 1.0 for row in rows)
    assert all(row.outside == 0 for row in rows)
    assert all(row.settling_time < 3.0 for row in rows)


def test_there_is_a_row_for_each_combination(result: DemoResult) -> None:
    assert [(row.increments, row.method) for row in result.rows] == list(product(INCREMENTS, METHODS))
    assert set(METHODS) == {"RIV", "RLS", "extended RLS", "BCRLS"}
    assert demo_table(result).row_count == len(INCREMENTS) * len(METHODS)


def test_a_row_tells_what_the_estimator_alone_gives(result: DemoResult) -> None:
    scenario = make_scenario("mass-step", seed=0, increments=256)
    estimator = pmfid.RLS(pmfid.Drive(2.0), pmfid.Encoder(resolution_of(256)), 0.01, 50.0, forgetting=0.99)
    track = estimator.run(scenario.motion.u, scenario.counts)
    row = next(row for row in result.rows_of("RLS") if row.increments == 256)
    old, new = track["mass"][1000:1500], track["mass"][2500:]
    assert row.errors_old["mass"] == pytest.approx(100 * (old.mean() / 1.07 - 1), rel=1e-9)
    assert row.errors_new["mass"] == pytest.approx(100 * (new.mean() / 1.44 - 1), rel=1e-9)
    assert row.errors_new["coulomb_friction"] == pytest.approx(
        100 * (track["coulomb_friction"][2500:].mean() / 0.8 - 1), rel=1e-9
    )
    assert row.std_new == pytest.approx(new.std())
    late = np.flatnonzero(np.abs(track["mass"] / 1.44 - 1) > 0.05)[-1] + 1
    assert row.settling_time == pytest.approx(0.01 * (late - 1500))


def test_the_extended_estimate_is_biased_and_the_compensated_is_not(result: DemoResult) -> None:
    extended, compensated = result.rows_of("extended RLS")[-1], result.rows_of("BCRLS")[-1]
    assert extended.worst("mass") > 20 * compensated.worst("mass")
    assert extended.outside > 0


def test_settling_time() -> None:
    assert settling_time(np.array([1.0, 1.44, 1.2, 1.44, 1.45]), 1.44, 0.5) == 1.5
    assert settling_time(np.array([1.44, 1.44]), 1.44, 0.5) == 0.0
    assert settling_time(np.array([1.44, 1.0]), 1.44, 0.5) == math.inf
    assert settling_time(np.array([np.nan, 1.44]), 1.44, 0.5) == 0.5


def test_the_table_is_whole_in_80_columns(result: DemoResult) -> None:
    text = printed(result, 80)
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= 80
    for row in result.rows:
        pattern = r"\s+".join(re.escape(cell) for cell in row.cells())
        assert re.search(rf"^\s*{pattern}\s*$", text, re.MULTILINE)
    assert all(len(row.cells()) == len(COLUMNS) for row in result.rows)


def test_the_findings_hold_whether_plain_rls_is_fine_or_not(result: DemoResult) -> None:
    text = " ".join(findings(result))
    worst = max(row.worst("mass") for row in result.rows_of("RLS"))
    assert f"within {worst:.2f} %" in text
    assert "fine here too" in text if worst <= 1 else "biased here" in text


@pytest.mark.long
def test_same_seed_same_bytes(folder: Path, tmp_path: Path) -> None:
    write_demo(tmp_path / "b" / "deep", run_demo())
    for name in ("report.html", "cart.csv"):
        assert (folder / name).read_bytes() == (tmp_path / "b" / "deep" / name).read_bytes()
    page = (folder / "report.html").read_text("utf-8")
    assert page.count("<figure") == 6
    assert "http" not in page
    assert len(page) < 1_500_000
    assert all(f'<td class="number">{n}</td>' in page for n in INCREMENTS)


def test_the_record_gives_the_new_mass(folder: Path) -> None:
    t, u, counts = np.loadtxt(folder / "cart.csv", delimiter=",", skiprows=1, unpack=True)
    estimator = pmfid.BCRLS(pmfid.Drive(2.0), pmfid.Encoder(22.75e-6), t[1] - t[0], 50.0, forgetting=0.99)
    assert estimator.run(u, counts.astype(int))["mass"][-1] == pytest.approx(1.44, rel=0.01)
    assert "2.275e-05 m" in (folder / "report.html").read_text("utf-8")


def test_main_draws_the_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["--out", str(tmp_path), "--images", str(tmp_path / "new")])
    assert (tmp_path / "new" / "demo.png").stat().st_size > 10_000
    assert "BCRLS" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"duration": 19.9}, "duration must be 20 to 3600 s, got 19.9"),
        ({"duration": math.nan}, "duration must be .* got nan"),
        ({"duration": 1e9}, "duration must be .* got 1000000000"),
        ({"seed": -1}, "seed must be a whole number >= 0, got -1"),
        ({"seed": 0.5}, "seed must be a whole number >= 0, got 0.5"),
    ],
)
def test_bad_arguments_name_the_value(arguments: dict[str, float], message: str) -> None:
    with pytest.raises(pmfid.UsageError, match=message):
        run_demo(**arguments)  # type: ignore[arg-type]


def test_other_durations_work() -> None:
    short = run_demo(seed=5, duration=20.03)
    assert short.step_time == pytest.approx(10.015)
    assert np.flatnonzero(np.diff(short.truth["mass"])).tolist() == [1001]
    assert all(row.worst("mass") < 1.0 for row in short.rows_of("BCRLS"))


def test_the_first_screen_says_what_happened(result: DemoResult, folder: Path) -> None:
    """The first screen has a figure, one sentence and a table, whose numbers are those of the rows."""
    page = (folder / "report.html").read_text("utf-8")
    first = page.partition("<section>")[2].partition("</section>")[0]
    assert first.index("<figure") < first.index("<p>") < first.index("<table>")
    (sentence,) = re.findall("<p>(.*?)</p>", first)
    assert sentence.startswith("At 15 s the load of the cart rises from 1.07 to 1.44 kg: RIV finds both within ")
    worst = max(row.worst("mass") for row in result.rows_of("RIV"))
    assert float(sentence.partition("both within ")[2].split()[0]) == pytest.approx(worst, rel=0.05)
    assert sentence.count(". ") == 0
    assert " s s" not in sentence
    assert first.count("<tr>") == 1 + len(METHODS)

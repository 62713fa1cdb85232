"""The history of a fleet: changed axes are found, files and threads do not change the bytes, bad parts are named."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner

import pmfid
from pmfid import fleet
from pmfid.cli.main import main
from pmfid.fleet.history import History
from pmfid.report.fleet import write_fleet
from studies.fleet_data import AXIS_TOML, DT, Change, Machine, machines, rows
from tests.command import run_command
from tests.conftest import long_unless
from tests.refusals import refused
from tests.tuned import set_tuning

AXES, SAMPLES, HALF = 12, 60_000, 300.0
#: Axis -> its changed parameter, the factor and the time [s]. A third axis does not change, but is no machine of the
#: same type.
CHANGES = {
    2: Change("mass", 1.2, 190.0),
    5: Change("friction", 0.75, 310.0),
    7: Change("input_gain", 0.88, 410.0),
}


@pytest.fixture(scope="module")
def log() -> pl.DataFrame:
    """Return all rows in order."""
    made = machines(AXES, 0, SAMPLES * DT, seed=4)
    own = [Machine(one.name, one.number, one.drive, CHANGES.get(one.number)) for one in made]
    return pl.concat([rows(one, SAMPLES, seed=4) for one in own])


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("axis") / "axis.toml"
    path.write_text(AXIS_TOML + "[estimator]\ncutoff = 20.0\nprefilter_zeros = [-4.0, -0.13]\n")
    return path


@pytest.fixture(scope="module")
def plain(log: pl.DataFrame, config: Path) -> History:
    """Estimate from one frame in one thread."""
    return fleet.estimate(log, axis=config, by="machine", period="1min", workers=1)


# --- found changes ----------------------------------------------------------------------------------------------------


def test_those_that_changed_are_named_with_cause_size_and_time(plain: History) -> None:
    named = {row["axis"]: row for row in plain.named.iter_rows(named=True)}
    assert set(named) == {f"axis-{k:04d}" for k in CHANGES}
    for number, change in CHANGES.items():
        row = named[f"axis-{number:04d}"]
        assert (row["kind"], row["cause"]) == ("changed", change.cause)
        assert abs(row["size"] - (change.factor - 1)) < 4 * row["std"] < 0.05
        assert row["since"] <= change.time + 1 <= row["until"] + 1


def test_numbers_with_a_unit_give_the_same_bytes(log: pl.DataFrame, config: Path, tmp_path: Path) -> None:
    part, reported = log.filter(pl.col("machine") == "axis-0000"), tmp_path / "axis.toml"
    text = config.read_text()
    step = f"{tomllib.loads(text)['encoder']['resolution']!r}"
    reported.write_text(text.replace(f"resolution = {step}", f'resolution = "{step} m"'))
    assert reported.read_text() != text
    bare, with_unit = (
        fleet.estimate(part, axis=one, by="machine", out=tmp_path / one.parent.name) for one in (config, reported)
    )
    assert with_unit.periods.equals(bare.periods)


def test_the_estimates_of_quiet_periods_are_the_truth_within_their_bars(plain: History) -> None:
    truth = {one.name: one.drive for one in machines(AXES, 0, SAMPLES * DT, seed=4)}
    quiet = plain.periods.filter(~pl.col("axis").is_in(plain.named["axis"].to_list()) & (pl.col("quality") == "good"))
    apart = np.array(
        [
            [(row[name] - getattr(truth[row["axis"]], name)) / row[f"{name}_std"] for name in plain.names]
            for row in quiet.iter_rows(named=True)
        ]
    )
    assert len(apart) == 10 * (AXES - len(CHANGES))
    assert 0.3 < np.sqrt(np.mean(apart**2)) < 1.5


def test_a_period_with_a_change_in_it_is_in_doubt(plain: History) -> None:
    row = plain.periods.filter((pl.col("axis") == "axis-0002") & (pl.col("period") == 180.0)).row(0, named=True)
    assert row["quality"] == "doubt"
    assert "changed" in row["findings"].split()


def test_one_that_differs_from_its_type_is_named_and_another_type_is_not(log: pl.DataFrame, config: Path) -> None:
    heavy = log.filter(pl.col("machine") == "axis-0002").filter(pl.col("t") > 200)  # rows after its change
    few = pl.concat([log.filter(~pl.col("machine").is_in([f"axis-{k:04d}" for k in CHANGES])), heavy])
    double = pl.col("u") * pl.when(pl.col("machine") == "axis-0002").then(0.5).otherwise(1.0)
    typed = few.with_columns(double.alias("u"), pl.lit("a").alias("kind"))
    found = fleet.estimate(typed, axis=config, by="machine", type="kind", workers=1)
    assert [(row["axis"], row["kind"]) for row in found.named.iter_rows(named=True)] == [("axis-0002", "differs")]
    kind = pl.when(pl.col("machine") == "axis-0002").then(pl.lit("b")).otherwise(pl.lit("a"))
    alone = fleet.estimate(typed.with_columns(kind=kind), axis=config, by="machine", type="kind")
    assert not alone.named.height


# --- the same bytes ---------------------------------------------------------------------------------------------------

Layout = Callable[[pl.DataFrame, Path], None]


def by_axis(log: pl.DataFrame, folder: Path) -> None:
    """Write files whose axis is only in the names of the folders."""
    for (name,), part in log.partition_by("machine", as_dict=True).items():
        (folder / f"machine={name}").mkdir()
        part.drop("machine").write_parquet(folder / f"machine={name}" / "0.parquet")


def by_time(log: pl.DataFrame, folder: Path) -> None:
    """Write files of 100 s, with the rows of all axes in random order."""
    part = (pl.col("t") / 100).floor()
    for k, rest in enumerate(log.with_columns(part=part).partition_by("part", include_key=False)):
        rest.sample(fraction=1.0, shuffle=True, seed=k).write_parquet(folder / f"[{k}].parquet")


def in_arrow(log: pl.DataFrame, folder: Path) -> None:
    """Write two files with different types and with some common rows."""
    log[: log.height // 2 + 1000].cast({"counts": pl.Int64, "u": pl.Float64}).write_ipc(folder / "a.arrow")
    log[log.height // 2 :].with_columns(pl.col("counts").cast(pl.String)).write_parquet(folder / "b.parquet")


@pytest.mark.parametrize(
    "layout", long_unless([by_axis, in_arrow].__contains__, [by_axis, by_time, in_arrow]), ids=lambda one: one.__name__
)
def test_partitions_order_and_threads_leave_the_bytes(
    log: pl.DataFrame, config: Path, plain: History, layout: Layout, tmp_path: Path
) -> None:
    (tmp_path / "data").mkdir()
    layout(log, tmp_path / "data")
    found = fleet.estimate(tmp_path / "data", axis=config, by="machine", period="1min", workers=2, out=tmp_path / "out")
    assert found.axes.equals(plain.axes)
    assert found.periods.drop("findings").equals(plain.periods.drop("findings"))
    kept = pl.read_parquet(tmp_path / "out" / "periods.parquet")
    assert kept.equals(found.periods)


def test_the_size_of_chunks_leaves_the_bytes(
    log: pl.DataFrame, config: Path, plain: History, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_tuning(monkeypatch, "pmfid.fleet.files", plan_rows=50_000, plan_least=50_000)
    set_tuning(monkeypatch, "pmfid.fleet.evaluate", segments_batch=20_000)
    shuffled = log.sample(fraction=1.0, shuffle=True, seed=2)
    assert fleet.estimate(shuffled, axis=config, by="machine", period="1min").periods.equals(plain.periods)


def test_results_within_the_data_are_no_data(log: pl.DataFrame, config: Path, tmp_path: Path) -> None:
    log.head(SAMPLES).write_parquet(tmp_path / "data.parquet")
    for _ in range(2):
        found = fleet.estimate(tmp_path, axis=config, by="machine", out=tmp_path / "out")
        assert found.problems.height == 0


def test_a_folder_with_other_files_is_left_alone(log: pl.DataFrame, config: Path, tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("mine")
    refused((r"thesis\.tex", lambda: fleet.estimate(log, axis=config, by="machine", out=tmp_path)))


# --- wrong input ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def spoilt(log: pl.DataFrame, config: Path, tmp_path_factory: pytest.TempPathFactory) -> History:
    """Estimate a data set with one fault of each kind, each in its own axis."""
    folder = tmp_path_factory.mktemp("spoilt")
    parts = {f"p{k}": log[k * SAMPLES : (k + 1) * SAMPLES] for k in range(AXES)}
    row, t = pl.int_range(pl.len()), pl.col("t")
    half = pl.col("machine").is_not_null() & ((t < HALF) | (row % 2 == 0))
    parts["p0"] = parts["p0"].filter(half)  # the sampling rate halves at this time
    parts["p1"] = parts["p1"].filter(~t.is_between(100, 170) & ~t.is_between(400, 400.05))  # gaps
    parts["p3"] = pl.concat([parts["p3"], parts["p3"][1000:2000]])  # repeated rows
    wrong = parts["p4"][5000:5020].with_columns(pl.col("counts") + 99)
    parts["p4"] = pl.concat([parts["p4"], wrong])  # rows that contradict others
    parts["p6"] = parts["p6"].head(10)
    parts["p8"] = parts["p8"].cast({"counts": pl.String, "u": pl.Float32, "t": pl.String})
    parts["p9"] = parts["p9"].rename({"u": "voltage"})
    for name, part in parts.items():
        part.write_parquet(folder / f"{name}.parquet")
    damaged = folder / "p10.parquet"
    data = bytearray(damaged.read_bytes())
    data[len(data) // 3 : 2 * len(data) // 3] = bytes(len(data) // 3)  # the footer of the file stays whole
    damaged.write_bytes(data)
    shutil.copy(config, folder / "notes.txt")
    (folder / "p11.parquet").write_bytes(b"PAR1")
    (folder / "_SUCCESS").write_bytes(b"")
    (folder / "notes.txt").unlink()
    return fleet.estimate(folder, axis=config, by="machine", period="1min")


def codes_of(found: History, where: str) -> set[str]:
    return set(found.problems.filter((pl.col("axis") == where) | (pl.col("file") == where))["code"].to_list())


@pytest.mark.parametrize(
    ("where", "code"),
    [
        ("axis-0003", "duplicates"),
        ("axis-0004", "contradictions"),
        ("axis-0006", "no_record"),
        ("p8.parquet", "type"),
        ("p9.parquet", "unreadable"),
        ("p10.parquet", "unreadable"),
        ("p11.parquet", "unreadable"),
    ],
)
def test_what_cannot_be_used_is_named(spoilt: History, where: str, code: str) -> None:
    assert code in codes_of(spoilt, where)


def test_a_change_of_the_sample_period_is_named(spoilt: History) -> None:
    assert codes_of(spoilt, "axis-0000") & {"mixed_dt", "no_record"}


def test_the_rest_is_done(spoilt: History, plain: History) -> None:
    known = {axis: spoilt.periods.filter(pl.col("axis") == axis) for axis in spoilt.axes["axis"].to_list()}
    for axis in ("axis-0002", "axis-0003", "axis-0005", "axis-0007", "axis-0008"):
        own = plain.periods.filter(pl.col("axis") == axis).drop("findings")
        if axis != "axis-0008":  # the input of this axis has fewer digits
            assert known[axis].drop("findings").equals(own), axis
        assert known[axis]["quality"].is_in(["good", "doubt"]).all()
    assert known["axis-0006"]["quality"].to_list() == ["none"]
    gaps = known["axis-0001"]
    assert gaps.filter(pl.col("period") == 120.0).height == 0, "a period without rows has no row"
    assert {row["axis"] for row in spoilt.named.iter_rows(named=True)} == set(plain.named["axis"].to_list())


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"by": "axis"}, "no column 'axis'"),
        ({"period": "fortnight"}, "duration"),
        ({"period": "0"}, "duration"),
        ({"segment": 0.5}, "are shorter than"),
        ({"type": "kind"}, "no column 'kind'"),
    ],
    ids=str,
)
def test_what_cannot_be_is_said(log: pl.DataFrame, config: Path, settings: dict[str, object], said: str) -> None:
    given = {"axis": config, "by": "machine"} | settings
    refused((said, lambda: fleet.estimate(log.head(SAMPLES), **given)))  # type: ignore[arg-type]


def test_methods_off_line_and_relative_times_left_out_are_refused(log: pl.DataFrame, tmp_path: Path) -> None:
    for line, said in (('[estimator]\nmethod = "iv"\n', "riv"), ("", "exclude")):
        path = tmp_path / f"{said}.toml"
        text = AXIS_TOML if line else AXIS_TOML.replace('time = "t"', 'time = "t"\nexclude = [[0.0, 1.0]]')
        path.write_text(text + line)
        refused((said, partial(fleet.estimate, log.head(SAMPLES), axis=path, by="machine")))


def test_a_stamp_of_another_century_does_not_stop_it(log: pl.DataFrame, config: Path) -> None:
    stamps = pl.when(pl.int_range(pl.len()) == 30_000).then(1e300).otherwise(pl.col("t"))
    found = fleet.estimate(log.head(SAMPLES).with_columns(t=stamps), axis=config, by="machine")
    assert found.periods.filter(pl.col("period") == 0.0)["quality"].to_list() == ["good"]


# --- the command ------------------------------------------------------------------------------------------------------


def test_the_command_prints_and_writes(log: pl.DataFrame, plain: History, tmp_path: Path) -> None:
    """The record chooses the filters once."""
    config = tmp_path / "axis.toml"
    config.write_text(AXIS_TOML)
    log.write_parquet(tmp_path / "log.parquet")
    words = ["fleet", "history", str(tmp_path / "log.parquet"), "--config", str(config), "--axis", "machine"]
    words += ["--out", str(tmp_path / "out"), "--period", "1min"]
    shown = run_command(*words)
    assert shown.stdout.startswith("3 of 12 axes need attention")
    page = (tmp_path / "out" / "fleet.html").read_text()
    assert all(f"axis-{k:04d}" in page for k in CHANGES)
    again = CliRunner().invoke(main, [*words, "--json"])
    reported = json.loads(again.stdout)
    assert {one["axis"] for one in reported["attention"]} == set(plain.named["axis"].to_list())


def test_the_report_draws_any_name_and_has_the_trends(plain: History, tmp_path: Path) -> None:
    """Control characters, formulas and long names once reached the figures and the terminal."""
    names = {"axis-0002": "<b>$x_{\x1b[31m", "axis-0005": "x" * 400}
    axes, periods = (
        one.with_columns(pl.col("axis").replace(names).alias("axis")) for one in (plain.axes, plain.periods)
    )
    found = replace(plain, axes=axes, periods=periods)
    write_fleet(tmp_path, found, "lake")
    page = (tmp_path / "fleet.html").read_text()
    assert "<b>" not in page
    assert "Trend of the axes that move" in page
    assert "\x1b" not in str(found)
    quiet = plain.axes.filter(~pl.col("named"))
    apart = quiet["mass_slope"] / quiet["mass_slope_std"]
    assert apart.abs().max() < 5  # type: ignore[operator]
    assert plain.axes.filter(pl.col("axis") == "axis-0002")["mass_slope"].item() > 0


def test_nobody_moves_is_exit_code_3(log: pl.DataFrame, config: Path, tmp_path: Path) -> None:
    still = log.head(SAMPLES).with_columns(pl.lit(0.0).alias("u"), pl.lit(0).alias("counts"))
    still.write_parquet(tmp_path / "log.parquet")
    words = ["fleet", "history", str(tmp_path / "log.parquet"), "--config", str(config), "--axis", "machine"]
    run_command(*words, "--out", str(tmp_path / "out"), code=3)


def test_the_package_opens_by_its_name() -> None:
    assert pmfid.fleet.estimate is fleet.estimate


def test_the_name_of_the_readme_is_there_after_a_plain_import() -> None:
    shown = subprocess.run(
        [sys.executable, "-c", "import pmfid; print(pmfid.fleet.estimate.__name__)"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert shown.stdout.strip() == "estimate", shown.stderr

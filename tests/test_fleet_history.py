"""The history of a fleet: changed axes are found, files and threads do not change the bytes, bad parts are named."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner

from pmfid import fleet
from pmfid.cli.main import main
from pmfid.fleet.history import History
from studies.fleet_data import AXIS_TOML, DT, Change, Machine, machines, rows
from tests.command import run_command
from tests.conftest import long_unless
from tests.refusals import refused

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

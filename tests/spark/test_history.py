"""The history of a fleet on Spark has the bytes of the local engine, from files and DataFrames with any fault."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import polars as pl
import pytest

from pmfid import fleet
from pmfid.errors import UsageError
from pmfid.fleet.history import History
from studies.fleet_data import AXIS_TOML, DT, Change, Machine, machines, rows
from tests.command import run_command
from tests.refusals import refused
from tests.tuned import set_tuning

if TYPE_CHECKING:
    from pyspark.sql import SparkSession

AXES, SAMPLES = 6, 30_000
TABLES = ("periods", "axes", "problems")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a data set with faults: an invalid file, another column, a number as text, repeated rows."""
    folder = tmp_path_factory.mktemp("lake")
    own = machines(AXES, 0, SAMPLES * DT, seed=7)
    made = [Machine(one.name, one.number, one.drive, Change("mass", 1.2, 160.0) if k == 2 else None) for k, one in
            enumerate(own)]  # fmt: skip
    logs = [rows(one, SAMPLES, seed=7) for one in made]
    logs[1] = pl.concat([logs[1], logs[1][500:900]])
    logs[3] = pl.concat([logs[3], logs[3][900:910].with_columns(pl.col("counts") + 7)])
    logs[4] = logs[4].with_columns(pl.col("counts").cast(pl.String))
    for k in (0, 1, 2, 3):
        (folder / "mixed").mkdir(exist_ok=True)
        logs[k][: SAMPLES // 2].write_parquet(folder / f"early-{k}.parquet")
    pl.concat([log[SAMPLES // 2 :] for log in logs[:4]]).sample(fraction=1.0, shuffle=True, seed=3).write_parquet(
        folder / "mixed" / "late.parquet"
    )
    logs[4].write_parquet(folder / "text.parquet")
    logs[5].rename({"u": "voltage"}).write_parquet(folder / "other.parquet")
    (folder / "damaged.parquet").write_bytes(b"PAR1")
    return folder


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("axis") / "axis.toml"
    path.write_text(AXIS_TOML)
    return path


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the budget small, so that several chunks result."""
    set_tuning(monkeypatch, "pmfid.fleet.engine", plan_rows=40_000, plan_least=40_000)


def estimated(data: object, config: Path, out: Path | None = None, engine: fleet.Engine | None = None) -> History:
    return fleet.estimate(data, axis=config, by="machine", period="1min", out=out, engine=engine)


@pytest.fixture(scope="module")
def frames(folder: Path) -> list[pl.DataFrame]:
    """Return the files of the folder that fit one frame."""
    names = [*(f"early-{k}.parquet" for k in range(4)), "mixed/late.parquet"]
    return [pl.read_parquet(folder / name) for name in names]


def test_files_have_the_bytes_of_the_local_engine(
    spark: SparkSession, folder: Path, config: Path, tmp_path: Path
) -> None:
    """All three tables and the faults in them are equal."""
    estimated(folder, config, tmp_path / "local")
    found = estimated(folder, config, tmp_path / "spark", fleet.Spark())
    assert found.engine == "spark"
    assert {"duplicates", "contradictions", "type", "unreadable"} <= set(found.problems["code"].to_list())
    for name in TABLES:
        ours, theirs = ((tmp_path / engine / f"{name}.parquet").read_bytes() for engine in ("spark", "local"))
        assert ours == theirs, name


def test_a_spark_dataframe_has_the_bytes_of_the_same_frame_here(
    spark: SparkSession, frames: list[pl.DataFrame], config: Path, tmp_path: Path
) -> None:
    whole = pl.concat(frames)
    data = spark.createDataFrame(whole.to_arrow()).repartition(5)
    plain, found = estimated(whole, config), estimated(data, config, tmp_path / "out")
    assert [row["axis"] for row in plain.named.iter_rows(named=True)] == ["axis-0002"]
    for name in TABLES:
        assert getattr(found, name).equals(getattr(plain, name)), name


def test_times_and_types_of_spark_are_those_of_polars(
    spark: SparkSession, frames: list[pl.DataFrame], tmp_path: Path
) -> None:
    """Dates, whole numbers as names of axes, and a name with a dot."""
    axis = pl.col("machine").str.slice(5).cast(pl.Int32)
    time = pl.datetime(2026, 3, 1) + pl.duration(microseconds=(pl.col("t") * 1e6).round().cast(pl.Int64))
    few = pl.concat(frames[:2]).select(axis.alias("no."), time.alias("t"), pl.col("u").cast(pl.Float32), "counts")
    config = tmp_path / "axis.toml"
    config.write_text(AXIS_TOML)
    data = spark.createDataFrame(few.to_arrow())
    plain, found = (fleet.estimate(one, axis=config, by="no.") for one in (few, data))
    assert plain.periods.height == 2
    assert found.periods.equals(plain.periods)


def test_what_is_wrong_is_said(spark: SparkSession, frames: list[pl.DataFrame], config: Path) -> None:
    data = spark.createDataFrame(frames[0].rename({"u": "voltage"}).head(100).to_arrow())
    refused(
        ("no column 'u'", lambda: estimated(data, config)),
        ("leave out the engine", lambda: estimated(data, config, engine=fleet.Local())),
        ("stays on this machine", lambda: estimated(frames[0], config, engine=fleet.Spark())),
    )


def test_executors_with_another_version_are_refused(
    spark: SparkSession, folder: Path, config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pmfid.fleet.history.Work", partial(fleet.Work, version="0.0.1"))
    with pytest.raises(UsageError, match=r"the driver has 0\.0\.1: install the same"):
        estimated(folder, config, engine=fleet.Spark())


def test_the_command(spark: SparkSession, folder: Path, config: Path, tmp_path: Path) -> None:
    words = ["fleet", "history", str(folder), "--config", str(config), "--axis", "machine", "--period", "1min"]
    words += ["--out", str(tmp_path / "out"), "--engine", "spark"]
    shown = run_command(*words)
    assert shown.stdout.startswith("1 of 5 axes need")
    refused = run_command(*words, "--workers", "2", code=2)
    assert "--master" in refused.stderr

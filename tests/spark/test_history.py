"""The history of a Spark DataFrame has the bytes of the same rows on this machine, with any fault."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl
import pytest

from pmfid import fleet
from pmfid.fleet.history import History
from studies.fleet_data import AXIS_TOML, DT, Change, machines, rows
from tests.refusals import refused

if TYPE_CHECKING:
    from pyspark.sql import SparkSession

AXES, SAMPLES = 5, 30_000
TABLES = ("periods", "axes", "problems")


@pytest.fixture(scope="module")
def log() -> pl.DataFrame:
    """Return the rows of some axes in a random order, with repeated and contradictory rows, and a changed axis."""
    own = machines(AXES, 0, SAMPLES * DT, seed=7)
    made = [replace(one, change=Change("mass", 1.2, 160.0)) if k == 2 else one for k, one in enumerate(own)]
    logs = [rows(one, SAMPLES, seed=7) for one in made]
    logs[1] = pl.concat([logs[1], logs[1][500:900]])
    logs[3] = pl.concat([logs[3], logs[3][900:910].with_columns(pl.col("counts") + 7)])
    return pl.concat(logs).sample(fraction=1.0, shuffle=True, seed=3)


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("axis") / "axis.toml"
    path.write_text(AXIS_TOML)
    return path


def estimated(data: Any, config: Path, out: Path | None = None) -> History:
    return fleet.estimate(data, axis=config, by="machine", period="1min", out=out)


def test_a_spark_dataframe_has_the_bytes_of_the_same_rows_here(
    spark: SparkSession, log: pl.DataFrame, config: Path, tmp_path: Path
) -> None:
    """Several chunks here, several partitions there: all three tables and the faults in them are equal."""
    data = spark.createDataFrame(log.to_arrow()).repartition(5)
    plain = estimated(log, config, tmp_path / "local")
    estimated(data, config, tmp_path / "spark")
    assert [row["axis"] for row in plain.named.iter_rows(named=True)] == ["axis-0002"]
    assert {"duplicates", "contradictions"} <= set(plain.problems["code"].to_list())
    for name in TABLES:
        ours, theirs = ((tmp_path / place / f"{name}.parquet").read_bytes() for place in ("spark", "local"))
        assert ours == theirs, name


def test_times_and_types_of_spark_are_those_of_polars(spark: SparkSession, log: pl.DataFrame, tmp_path: Path) -> None:
    """Dates, whole numbers as names of axes, and a name with a dot."""
    axis = pl.col("machine").str.slice(5).cast(pl.Int32)
    time = pl.datetime(2026, 3, 1) + pl.duration(microseconds=(pl.col("t") * 1e6).round().cast(pl.Int64))
    few = log.filter(pl.col("machine") < "axis-0002").select(
        axis.alias("no."), time.alias("t"), pl.col("u").cast(pl.Float32), "counts"
    )
    config = tmp_path / "axis.toml"
    config.write_text(AXIS_TOML)
    data = spark.createDataFrame(few.to_arrow())
    plain, found = (fleet.estimate(one, axis=config, by="no.") for one in (few, data))
    assert plain.periods.height == 2
    assert found.periods.equals(plain.periods)


def test_missing_columns_and_executors_with_another_version_are_refused(
    spark: SparkSession, log: pl.DataFrame, config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = log.filter(pl.col("machine") == "axis-0000")
    refused(
        ("no column 'u'", lambda: estimated(spark.createDataFrame(few.rename({"u": "voltage"}).to_arrow()), config))
    )
    monkeypatch.setattr("pmfid.fleet.history.Work", partial(fleet.Work, version="0.0.1"))
    data = spark.createDataFrame(few.to_arrow())
    refused((r"the driver has 0\.0\.1: install the same", lambda: estimated(data, config)))

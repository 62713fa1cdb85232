"""Faults of a data set: each is named, all other data are processed, and the other axes keep every bit."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from pmfid import fleet
from pmfid.errors import UsageError
from pmfid.fleet.history import History, write_whole
from pmfid.fleet.source import RESULTS, Part, other_unit, seconds_of
from pmfid.io.tables import LONGEST_CELL
from studies.fleet_data import AXIS_TOML, machines, rows
from tests.refusals import refused

AXES, SAMPLES = 9, 6000


@pytest.fixture(scope="module")
def logs() -> list[pl.DataFrame]:
    """Return logs of March 2026."""
    plain = [rows(one, SAMPLES, seed=8) for one in machines(AXES, 0, 1.0, seed=8)]
    return [log.with_columns(pl.col("t") + 1_772_323_200.0) for log in plain]


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("axis") / "axis.toml"
    path.write_text(AXIS_TOML + "[estimator]\ncutoff = 20.0\nprefilter_zeros = [-4.0, -0.13]\n")
    return path


def estimated(data: object, config: Path, out: Path | None = None) -> History:
    return fleet.estimate(data, axis=config, by="machine", period="1min", out=out)


@pytest.fixture(scope="module")
def plain(logs: list[pl.DataFrame], config: Path) -> History:
    return estimated(pl.concat(logs), config)


def stamps(log: pl.DataFrame, unit: pl.datatypes.Datetime) -> pl.DataFrame:
    whole = (pl.col("t") * 1e6).round().cast(pl.Int64)
    times = pl.from_epoch(whole, time_unit="us").dt.replace_time_zone("UTC")
    return log.with_columns(times.dt.convert_time_zone(unit.time_zone or "UTC").cast(unit).alias("t"))


def named(log: pl.DataFrame, value: object) -> pl.DataFrame:
    return log.with_columns(pl.lit(value).alias("machine"))


@pytest.fixture(scope="module")
def mixed(logs: list[pl.DataFrame], config: Path, tmp_path_factory: pytest.TempPathFactory) -> History:
    """Estimate a data set with an axis for each case, each in its own files."""
    folder = tmp_path_factory.mktemp("mixed")
    decimal = {"u": pl.Decimal(12, 4), "counts": pl.Decimal(12, 0)}
    frames = {
        "zone": stamps(logs[0], pl.Datetime("ns", "Asia/Tokyo")),
        "unit": stamps(logs[1], pl.Datetime("ms", "UTC")),
        "decimal": logs[2].cast(decimal),  # type: ignore[arg-type]
        "half": logs[3].gather_every(2),
        "parts": pl.concat([named(logs[4][:3000], 7.25), named(logs[5][:3000], 7.75)]),
        "nobody": named(logs[4], ""),
        "switch": logs[6].with_columns(pl.col("counts") > 0),
        "integer": named(logs[7], 7.0),
        "none": logs[8][:0],
        "script": named(logs[8], "<b>Ü\x1b/../$x_{"),
    }
    for name, frame in frames.items():
        frame.write_parquet(folder / f"{name}.parquet")
    return estimated(folder, config)


def codes(found: History, where: str) -> list[str]:
    return found.problems.filter((pl.col("axis") == where) | (pl.col("file") == where))["code"].to_list()


def test_other_units_zones_and_decimals_are_the_same(mixed: History, plain: History) -> None:
    for axis in ("axis-0000", "axis-0001", "axis-0002"):
        own, other = (one.periods.filter(pl.col("axis") == axis) for one in (mixed, plain))
        assert own.height == 1
        assert own.equals(other), axis


@pytest.mark.parametrize(
    ("where", "code"),
    [
        ("axis-0003", "other_dt"),
        ("nobody.parquet", "rows_lost"),
        ("switch.parquet", "unreadable"),
        ("none.parquet", "empty"),
    ],
)
def test_what_is_odd_is_named(mixed: History, where: str, code: str) -> None:
    assert code in codes(mixed, where)


def test_axes_whose_names_are_numbers_are_not_put_together(mixed: History) -> None:
    """7.25 and 7.75 once both became 7."""
    known = set(mixed.axes["axis"].to_list())
    assert {"7.25", "7.75", "7", "<b>Ü\x1b/../$x_{"} <= known
    assert "" not in known


def test_a_file_that_grows_while_it_is_read_is_named(
    logs: list[pl.DataFrame], config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = tmp_path / "data"
    data.mkdir()
    logs[0].write_parquet(data / "a.parquet")
    logs[1].write_parquet(data / "b.parquet")
    first = estimated(data, config)
    with monkeypatch.context() as patched:
        patched.setattr(Part, "rewritten", property(_grows(data / "b.parquet", logs[2])))
        found = estimated(data, config, tmp_path / "out")
    assert codes(found, "b.parquet") == ["rewritten"]
    assert found.periods.filter(pl.col("axis") == "axis-0000").equals(
        first.periods.filter(pl.col("axis") == "axis-0000")
    )
    again = estimated(data, config, tmp_path / "out")
    assert "axis-0002" in again.axes["axis"].to_list()
    assert not codes(again, "b.parquet")


def _grows(path: Path, more: pl.DataFrame) -> Callable[[Part], bool]:
    """Let another writer extend the file just before the look."""
    plainly = Part.rewritten.fget  # type: ignore[attr-defined]

    def look(part: Part) -> bool:
        if part.name == path.name:
            pl.concat([pl.read_parquet(path), more]).write_parquet(path)
        return bool(plainly(part))

    return look


# --- times ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("ahead", "ending"), [("0h", ""), ("0h", "Z"), ("1h", "+01:00"), ("-9h30m", "-0930")])
def test_text_of_iso_8601_is_a_time(ahead: str, ending: str) -> None:
    there = pl.Series("t", [1_772_323_200.25, 1_772_323_201.0])
    stamps = pl.from_epoch((there * 1e6).cast(pl.Int64), time_unit="us").dt.offset_by(ahead)
    text = (stamps.dt.strftime("%Y-%m-%dT%H:%M:%S%.6f") + ending).extend(pl.Series(["2026-03-01", "yes", None]))
    found = pl.DataFrame({"t": text}).select(seconds_of(pl.col("t"), "t", pl.String(), 1.0))["t"]
    assert found.to_list() == [*there.to_list(), None, None, None]


def test_a_long_text_is_no_time() -> None:
    """A compressed file of 5 kB repeated a text of 20 kB in 400 000 rows, whose split took 6 GB."""
    stamp = "2026-03-01 00:00:00.25"
    frame = pl.DataFrame({"t": [stamp, stamp + " " * LONGEST_CELL]})
    assert frame.select(seconds_of(pl.col("t"), "t", pl.String(), 1.0))["t"].to_list() == [1_772_323_200.25, None]


@pytest.mark.parametrize("kind", [pl.Date(), pl.Time(), pl.Boolean()])
def test_half_a_time_is_refused(kind: pl.DataType) -> None:
    refused((r"'t' (has the type|must contain times)", lambda: seconds_of(pl.col("t"), "t", kind, 1.0)))


def test_durations_are_seconds() -> None:
    frame = pl.DataFrame({"t": [1500]}, schema={"t": pl.Duration("ms")})
    assert frame.select(seconds_of(pl.col("t"), "t", frame.schema["t"], 1e-3))["t"].to_list() == [1.5]


def test_another_unit_is_reported() -> None:
    assert 'time_unit = "ms"' in other_unit(1.7e12, 1.8e12, 1.0)
    assert 'time_unit = "s"' in other_unit(5e9, 5.1e9, 3.0)
    assert not other_unit(0.0, 1.8e9, 1.0)
    assert not other_unit(0.0, 1e12, 1.0)


def test_an_axis_of_two_types_is_named(logs: list[pl.DataFrame], config: Path, tmp_path: Path) -> None:
    for name, part in (("b", logs[0][:3000]), ("a", logs[0][3000:])):
        part.with_columns(pl.lit(name).alias("kind")).write_parquet(tmp_path / f"{name}.parquet")
    found = fleet.estimate(tmp_path, axis=config, by="machine", period="1min", type="kind")
    assert "types a, b" in found.problems.filter(pl.col("code") == "types")["text"][0]
    assert found.axes["type"].to_list() == ["a"]


# --- folders ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def lake(logs: list[pl.DataFrame], config: Path, tmp_path_factory: pytest.TempPathFactory) -> History:
    """Estimate a folder with links and entries that are no files, besides files."""
    folder, other = tmp_path_factory.mktemp("lake"), tmp_path_factory.mktemp("other")
    logs[0].write_parquet(folder / "a.parquet")
    logs[1].write_parquet(other / "b.parquet")
    logs[2].write_ipc_stream(folder / "stream.arrow")
    (folder / "elsewhere").symlink_to(other)
    (other / "back").symlink_to(folder)
    (folder / "nowhere.parquet").symlink_to(folder / "gone")
    os.mkfifo(folder / "pipe.parquet")
    (folder / os.fsdecode(b"\xff.parquet")).write_bytes(b"")
    for name in ("machine=said", "machine=__HIVE_DEFAULT_PARTITION__"):
        (folder / name).mkdir()
    logs[3].write_parquet(folder / "machine=said" / "c.parquet")
    logs[4].drop("machine").write_parquet(folder / "machine=__HIVE_DEFAULT_PARTITION__" / "d.parquet")
    logs[5].select("machine", "t", "u", "counts", pl.col("t").cast(pl.Float32).alias("short")).with_columns(
        pl.col("short").alias("t")
    ).write_parquet(folder / "short.parquet")
    logs[6].with_columns(pl.concat_list("machine")).write_parquet(folder / "list.parquet")
    for name in RESULTS:  # files of a history in the same folder
        (folder / "results" / name).mkdir(parents=True)
    logs[7].write_parquet(folder / "results" / "e.parquet")
    return estimated(folder, config)


def test_links_are_followed_once_and_results_are_no_data(lake: History) -> None:
    assert set(lake.axes["axis"].to_list()) == {f"axis-{k:04d}" for k in (0, 1, 2, 3, 5)}
    assert not any("results" in name or name.startswith("elsewhere/back") for name in lake.problems["file"].to_list())


@pytest.mark.parametrize(
    ("file", "code", "said"),
    [
        ("nowhere.parquet", "unreadable", "leads nowhere"),
        ("pipe.parquet", "unreadable", "is not a readable file"),
        ("\\udcff.parquet", "unreadable", "rename it"),
        ("machine=said/c.parquet", "type", "machine = said, but its column says axis-0003"),
        ("machine=__HIVE_DEFAULT_PARTITION__/d.parquet", "rows_lost", "6000 rows"),
        ("short.parquet", "type", "write the column as float64"),
        ("list.parquet", "unreadable", "must contain names"),
    ],
)
def test_what_is_no_data_is_named(lake: History, file: str, code: str, said: str) -> None:
    found = lake.problems.filter((pl.col("file") == file) & (pl.col("code") == code))
    assert said in " ".join(found["text"].to_list())


def test_a_disk_that_fills_up_is_said(tmp_path: Path) -> None:
    """Polars then raises an error that is no OSError."""

    def write(part: Path) -> None:
        part.write_text("half")
        raise pl.exceptions.ComputeError("No space left on device")

    refused(("free some space", lambda: write_whole(tmp_path / "a.parquet", write)))
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_is_said(logs: list[pl.DataFrame], config: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "link").symlink_to(tmp_path / "gone" / "deeper")
    for name in ("file/below", "link", "n" * 300, "a\0b"):
        with pytest.raises(UsageError, match="folder"):
            estimated(logs[0], config, tmp_path / name)
    refused(("for example file", lambda: estimated(tmp_path, config, tmp_path)))


@pytest.mark.parametrize(("setting", "said"), [("segment", "are shorter than"), ("tolerance", "tolerance = nan")])
def test_numbers_that_are_none_are_refused(logs: list[pl.DataFrame], config: Path, setting: str, said: str) -> None:
    settings: dict[str, Any] = {setting: float("nan")}
    refused((said, lambda: fleet.estimate(logs[0], axis=config, by="machine", period="1min", **settings)))


def test_a_missing_column_is_said_in_spite_of_a_damaged_file(
    logs: list[pl.DataFrame], config: Path, tmp_path: Path
) -> None:
    (tmp_path / "a.parquet").write_bytes(b"PAR1")
    logs[0].write_parquet(tmp_path / "b.parquet")
    refused((r"b\.parquet: the data have no column 'axis'", lambda: fleet.estimate(tmp_path, axis=config, by="axis")))


# --- tables of a lake -------------------------------------------------------------------------------------------------


def test_a_delta_table_is_read_by_its_log(logs: list[pl.DataFrame], config: Path, tmp_path: Path) -> None:
    """Overwritten files still exist, and a name of a partition may have any letters."""
    deltalake = pytest.importorskip("deltalake", reason="deltalake is not installed: pip install 'pmfid[delta]'")
    wanted = pl.concat([named(logs[0], "a b/ü"), named(logs[1], "2")])
    deltalake.write_deltalake(tmp_path / "table", pl.concat(logs[2:4]), partition_by=["machine"])
    deltalake.write_deltalake(tmp_path / "table", wanted, mode="overwrite", partition_by=["machine"])
    found, plainly = estimated(tmp_path / "table", config), estimated(wanted, config)
    assert found.periods.equals(plainly.periods)
    assert not found.problems.height
    refused(("single snapshot", lambda: estimated(tmp_path, config)))


def test_a_delta_table_without_the_reader_or_with_more_than_files_is_refused(
    logs: list[pl.DataFrame], config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    logs[0].write_parquet(tmp_path / "a.parquet")
    (tmp_path / "_delta_log").mkdir()
    monkeypatch.setitem(sys.modules, "deltalake", None)
    refused((r"pmfid\[delta\]", lambda: estimated(tmp_path, config)))


def test_a_table_of_iceberg_is_refused(logs: list[pl.DataFrame], config: Path, tmp_path: Path) -> None:
    (tmp_path / "metadata").mkdir()
    (tmp_path / "metadata" / "v1.metadata.json").write_text("{}")
    logs[0].write_parquet(tmp_path / "a.parquet")
    refused(("Iceberg", lambda: estimated(tmp_path, config)))


def test_estimates_are_numbers(mixed: History) -> None:
    known = mixed.axes.filter(pl.col("kind") != "no estimate")
    assert np.all(np.isfinite(known["mass"].to_numpy()))

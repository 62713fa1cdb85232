"""What a data set may have that is none: named, the rest is done, and the other axes keep every bit."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from pmfid import fleet
from pmfid.errors import UsageError
from pmfid.fleet.history import History
from pmfid.fleet.source import Part
from studies.fleet_data import AXIS_TOML, machines, rows

AXES, SAMPLES = 9, 6000


@pytest.fixture(scope="module")
def logs() -> list[pl.DataFrame]:
    """Of March 2026."""
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
    """An axis for each case, in files of their own."""
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
    """7.25 and 7.75 had both become 7."""
    known = set(mixed.axes["axis"].to_list())
    assert {"7.25", "7.75", "7", "<b>Ü\x1b/../$x_{"} <= known
    assert "" not in known


def test_a_file_that_grows_while_it_is_read_is_named_and_done_anew(
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
    """Another writer, just before the look."""
    plainly = Part.rewritten.fget  # type: ignore[attr-defined]

    def look(part: Part) -> bool:
        if part.name == path.name:
            pl.concat([pl.read_parquet(path), more]).write_parquet(path)
        return bool(plainly(part))

    return look


# --- tables of a lake -------------------------------------------------------------------------------------------------


def test_a_delta_table_is_read_by_its_log(logs: list[pl.DataFrame], config: Path, tmp_path: Path) -> None:
    """What is overwritten lies there still, and a name of a partition may have any letters."""
    deltalake = pytest.importorskip("deltalake", reason="deltalake is not installed: pip install 'pmfid[delta]'")
    wanted = pl.concat([named(logs[0], "a b/ü"), named(logs[1], "2")])
    deltalake.write_deltalake(tmp_path / "table", pl.concat(logs[2:4]), partition_by=["machine"])
    deltalake.write_deltalake(tmp_path / "table", wanted, mode="overwrite", partition_by=["machine"])
    found, plainly = estimated(tmp_path / "table", config), estimated(wanted, config)
    assert found.periods.equals(plainly.periods)
    assert not found.problems.height
    with pytest.raises(UsageError, match="own folder"):
        estimated(tmp_path, config)


def test_a_delta_table_without_the_reader_or_with_more_than_files_is_refused(
    logs: list[pl.DataFrame], config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    logs[0].write_parquet(tmp_path / "a.parquet")
    (tmp_path / "_delta_log").mkdir()
    monkeypatch.setitem(sys.modules, "deltalake", None)
    with pytest.raises(UsageError, match=r"pmfid\[delta\]"):
        estimated(tmp_path, config)


def test_a_table_of_iceberg_is_refused(logs: list[pl.DataFrame], config: Path, tmp_path: Path) -> None:
    (tmp_path / "metadata").mkdir()
    (tmp_path / "metadata" / "v1.metadata.json").write_text("{}")
    logs[0].write_parquet(tmp_path / "a.parquet")
    with pytest.raises(UsageError, match="Iceberg"):
        estimated(tmp_path, config)


def test_estimates_are_numbers(mixed: History) -> None:
    known = mixed.axes.filter(pl.col("kind") != "no estimate")
    assert np.all(np.isfinite(known["mass"].to_numpy()))

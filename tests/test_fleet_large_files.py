"""A file with a row group larger than the memory is read in windows, each shard its own rows, with the same bytes."""

from __future__ import annotations

from pathlib import Path

import polars as pl
import pytest

from pmfid import fleet
from pmfid.config.axis import load_axis
from pmfid.errors import UsageError
from pmfid.fleet.data import TRIED
from pmfid.fleet.history import History
from pmfid.fleet.plan import survey_part
from pmfid.fleet.source import Part, SourceColumns, parts_of
from studies.fleet_data import AXIS_TOML, machines, rows
from tests.tuned import set_tuning

AXES, SAMPLES, WINDOW = 4, 7000, 3000


@pytest.fixture(scope="module")
def log() -> pl.DataFrame:
    """Return rows ordered by axis, across midnight."""
    return pl.concat([rows(one, SAMPLES, seed=8) for one in machines(AXES, 0, 1.0, seed=8)]).with_columns(
        pl.col("t") + 86_370.0
    )


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "axis.toml"
    path.write_text(AXIS_TOML + "[estimator]\ncutoff = 20.0\nprefilter_zeros = [-4.0, -0.13]\n")
    return path


@pytest.fixture
def large(log: pl.DataFrame, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write one file of one row group; windows are shorter than an axis, and each shard has one axis."""
    set_tuning(monkeypatch, "pmfid.fleet.plan", plan_budget=SAMPLES + 500, plan_rows=SAMPLES + 500, plan_small=WINDOW)
    set_tuning(monkeypatch, "pmfid.fleet.source", source_window=WINDOW)
    path = tmp_path / "data" / "all.parquet"
    path.parent.mkdir()
    log.write_parquet(path, row_group_size=log.height)
    return path


def estimated(data: object, config: Path) -> History:
    return fleet.estimate(data, axis=config, by="machine", period="1min")


def test_windows_say_the_same_of_a_file_as_one_look(large: Path, config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    columns = SourceColumns.from_axis(load_axis(config), "machine")
    part = parts_of(large)[0]
    assert [one.many for one in part.windows()] == [WINDOW] * 9 + [AXES * SAMPLES - 9 * WINDOW]
    found = survey_part(part, columns)
    set_tuning(monkeypatch, "pmfid.fleet.source", source_window=10**9)
    assert found.rows.equals(survey_part(part, columns).rows)
    assert found.rows["rows"].sum() == AXES * SAMPLES


def test_a_shard_reads_its_own_rows_of_a_large_file_and_the_bytes_are_the_same(
    large: Path, log: pl.DataFrame, config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each shard once read the whole file: the time grew with the square of the size."""
    read: list[int] = []
    plainly = Part.rows

    def rows_of(part: Part, columns: SourceColumns) -> pl.LazyFrame:
        read.append(part.many or 0)
        return plainly(part, columns)

    with monkeypatch.context() as patched:
        patched.setattr(Part, "rows", rows_of)
        found = estimated(large, config)
    assert found.shards >= AXES
    assert max(read) == WINDOW
    looks = found.shards + TRIED  # each shard has one axis
    assert sum(read) <= log.height + looks * SAMPLES
    plain = estimated(log, config)
    assert found.periods.equals(plain.periods)
    assert found.axes.equals(plain.axes)


def test_a_large_file_that_is_damaged_is_named(large: Path, config: Path) -> None:
    data = bytearray(large.read_bytes())
    data[len(data) // 2 :] = bytes(len(data) - len(data) // 2)
    large.write_bytes(data)
    with pytest.raises(UsageError, match="not a readable"):
        estimated(large.parent, config)

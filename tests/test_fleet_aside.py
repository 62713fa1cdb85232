"""Files larger than a chunk are read in pieces, and files that mix their axes once, with the same bytes."""

from __future__ import annotations

import shutil
from pathlib import Path

import polars as pl
import pytest

from pmfid import fleet
from pmfid.fleet import plan
from pmfid.fleet.history import History
from pmfid.fleet.source import Part, SourceColumns
from studies.fleet_data import AXIS_TOML, machines, rows
from tests.refusals import refused
from tests.tuned import set_tuning

AXES, SAMPLES = 6, 12_000


@pytest.fixture(scope="module")
def log() -> pl.DataFrame:
    """Return the rows, ordered by axis."""
    return pl.concat([rows(one, SAMPLES, seed=8) for one in machines(AXES, 0, 1.0, seed=8)])


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("axis") / "axis.toml"
    path.write_text(AXIS_TOML + "[estimator]\ncutoff = 20.0\nprefilter_zeros = [-4.0, -0.13]\n")
    return path


@pytest.fixture(scope="module")
def plain(log: pl.DataFrame, config: Path) -> History:
    return fleet.estimate(log, axis=config, by="machine", period="1min")


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Let a chunk have the rows of one axis, and list the parts whose rows are read."""
    set_tuning(monkeypatch, "pmfid.fleet.files", plan_rows=SAMPLES, plan_least=SAMPLES)
    found, plainly = list[str](), Part.rows

    def look(part: Part, columns: SourceColumns) -> pl.LazyFrame:
        found.append(part.name)
        return plainly(part, columns)

    monkeypatch.setattr(Part, "rows", look)
    return found


@pytest.fixture
def mixed(log: pl.DataFrame, tmp_path: Path) -> Path:
    """Write two files, of a minute each, with rows of all axes in turns."""
    (tmp_path / "data").mkdir()
    turns = log.sort("t", "machine")
    half = turns.height // 2
    turns[: half + 600].write_parquet(tmp_path / "data" / "0.parquet")  # some rows are in both files
    turns[half:].write_parquet(tmp_path / "data" / "1.parquet", row_group_size=7000)
    return tmp_path / "data"


def estimated(data: Path, config: Path, out: Path | None = None) -> History:
    return fleet.estimate(data, axis=config, by="machine", period="1min", out=out)


def test_a_chunk_reads_its_own_rows_of_a_large_file(
    log: pl.DataFrame, config: Path, plain: History, tmp_path: Path, opened: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    reads = list[plan.Read]()

    def read(chunk: plan.Chunk, length: float) -> tuple[pl.DataFrame, list[plan.RowProblem]]:
        reads.extend(chunk.reads)
        return plan.read_chunk(chunk, length)

    monkeypatch.setattr("pmfid.fleet.files.read_chunk", read)
    log.write_parquet(tmp_path / "all.parquet", row_group_size=log.height)
    found = estimated(tmp_path / "all.parquet", config)
    assert [one.many for one in reads[1:]] == [SAMPLES] * AXES
    assert all(one.only for one in reads)
    assert found.periods.equals(plain.periods)


def test_mixed_files_are_read_three_times_and_leave_the_bytes(
    mixed: Path, config: Path, plain: History, tmp_path: Path, opened: list[str]
) -> None:
    """A file is read for the survey, for the choice of filters, and for the rows, whatever the number of chunks."""
    found = estimated(mixed, config, tmp_path / "out")
    assert found.periods.drop("findings").equals(plain.periods.drop("findings"))
    assert found.axes.equals(plain.axes)
    assert found.problems["code"].to_list() == ["duplicates"] * AXES
    assert {name: opened.count(name) for name in opened} == {"0.parquet": 3 + AXES, "1.parquet": 3 + AXES}
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "axes.parquet",
        "periods.parquet",
        "problems.parquet",
    ]


def test_a_damaged_mixed_file_is_named_and_the_other_is_used(mixed: Path, config: Path, opened: list[str]) -> None:
    damaged = mixed / "0.parquet"
    data = bytearray(damaged.read_bytes())
    whole = estimated(mixed / "1.parquet", config)
    # The damage is in heads of pages, because Parquet has no checksum of numbers.
    data[4 : len(data) // 3] = bytes(len(data) // 3 - 4)
    damaged.write_bytes(data)
    found = estimated(mixed, config)
    assert found.problems.filter(pl.col("file") == "0.parquet")["code"].to_list() == ["unreadable"]
    assert found.periods.equals(whole.periods)


def test_a_disk_without_room_is_said(
    mixed: Path, config: Path, opened: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*given: object, **named: object) -> None:
        raise pl.exceptions.ComputeError("No space left on device")

    monkeypatch.setattr(pl.LazyFrame, "sink_parquet", full)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: shutil._ntuple_diskusage(1, 1, 0))
    refused(("free some space", lambda: estimated(mixed, config)))

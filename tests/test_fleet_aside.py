"""Files larger than a chunk are read in pieces, and files that mix their axes once, with the same bytes."""

from __future__ import annotations

from pathlib import Path

import polars as pl
import pytest

from pmfid import fleet
from pmfid.fleet import plan
from pmfid.fleet.history import History
from pmfid.fleet.source import Part, SourceColumns
from studies.fleet_data import AXIS_TOML, machines, rows
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

"""Files that mix their axes row by row are read once, with the same bytes and no files left on the disk."""

from __future__ import annotations

from pathlib import Path

import polars as pl
import pytest

from pmfid import fleet
from pmfid.errors import UsageError
from pmfid.fleet.history import History
from pmfid.fleet.rows import Aside
from pmfid.fleet.source import Part
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
def mixed(log: pl.DataFrame, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write two files, of a minute each, with rows of all axes in turns; each shard has one axis."""
    set_tuning(monkeypatch, "pmfid.fleet.plan", plan_budget=SAMPLES + 2000, plan_rows=SAMPLES + 2000)
    set_tuning(monkeypatch, "pmfid.fleet.rows", aside_batch=5000)
    (tmp_path / "data").mkdir()
    turns = log.sort("t", "machine")
    half = turns.height // 2
    turns[: half + 600].write_parquet(tmp_path / "data" / "0.parquet")  # some rows are in both files
    turns[half:].write_parquet(tmp_path / "data" / "1.parquet", row_group_size=7000)
    return tmp_path / "data"


def test_mixed_files_are_read_twice_and_leave_the_bytes(
    mixed: Path, config: Path, plain: History, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file is read once for the survey and once for the rows. An earlier version read each file for each of six
    shards.
    """
    opened: list[str] = []
    plainly = Part.rows
    monkeypatch.setattr(Part, "rows", lambda part, columns: opened.append(part.name) or plainly(part, columns))
    found = fleet.estimate(mixed, axis=config, by="machine", period="1min", out=tmp_path / "out")
    assert found.shards == AXES
    assert found.periods.drop("findings").equals(plain.periods.drop("findings"))
    assert found.axes.equals(plain.axes)
    assert found.problems["code"].to_list() == ["duplicates"] * AXES
    assert sorted(opened) == ["0.parquet"] * 2 + ["1.parquet"] * 2
    assert not list(tmp_path.rglob("aside-*"))


def test_what_lies_aside_is_gone_when_its_last_shard_is_done(
    mixed: Path, config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lying: list[int] = []
    plainly = Aside.release

    def done(aside: Aside, shard: object) -> None:
        plainly(aside, shard)  # type: ignore[arg-type]
        lying.append(len(list(tmp_path.rglob("*.rows"))))

    monkeypatch.setattr(Aside, "release", done)
    fleet.estimate(mixed, axis=config, by="machine", out=tmp_path / "out", engine=fleet.Local(1))
    assert lying == [2] * (AXES - 1) + [0]


def test_nothing_stays_aside_after_an_error_and_what_was_done_is_done(
    mixed: Path, config: Path, plain: History, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plainly, called = fleet.Work.shard, 0

    def fails(work: fleet.Work, *rest: object) -> fleet.Segments:
        nonlocal called
        called += 1
        if called == 4:
            raise UsageError("the fourth")
        return plainly(work, *rest)  # type: ignore[arg-type]

    call = lambda: fleet.estimate(  # noqa: E731
        mixed, axis=config, by="machine", period="1min", out=tmp_path / "out", engine=fleet.Local(1)
    )
    with monkeypatch.context() as patched:
        patched.setattr(fleet.Work, "shard", fails)
        with pytest.raises(UsageError, match="the fourth"):
            call()
    assert not list(tmp_path.rglob("aside-*"))
    killed = tmp_path / "out" / "work" / "aside-killed"
    killed.mkdir()
    (killed / "0.rows").write_bytes(b"left")
    again = call()
    assert again.reused >= 3
    assert again.axes.equals(plain.axes)
    assert not killed.exists()


def test_a_damaged_mixed_file_is_named_and_the_other_is_used(mixed: Path, config: Path) -> None:
    damaged = mixed / "0.parquet"
    data = bytearray(damaged.read_bytes())
    whole = fleet.estimate(mixed / "1.parquet", axis=config, by="machine", period="1min")
    data[4 : len(data) // 3] = bytes(
        len(data) // 3 - 4
    )  # the damage is in heads of pages, because Parquet has no checksum of numbers
    damaged.write_bytes(data)
    found = fleet.estimate(mixed, axis=config, by="machine", period="1min")
    assert found.problems.filter(pl.col("file") == "0.parquet")["code"].to_list() == ["unreadable"]
    assert found.periods.equals(whole.periods)


def test_a_disk_without_room_is_said(mixed: Path, config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "pmfid.fleet.rows.Aside._pack_rows", lambda *rest: (_ for _ in ()).throw(OSError(28, "No space"))
    )
    with pytest.raises(UsageError, match="free some space"):
        fleet.estimate(mixed, axis=config, by="machine")

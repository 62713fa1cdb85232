"""`pmfid fleet stream` on Spark: the bits of one process, kills, states that move, and refusals."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner

import pmfid
from pmfid.cli.main import main
from pmfid.fleet.shards import States, StreamPlan
from pmfid.pipeline.monitored import setup
from pmfid.simulation import CART_DT
from pmfid.stream.blocks import encode
from pmfid.stream.delivery import Block
from pmfid.stream.groups import Pace, prepare
from studies.monitoring.pipe import write_axis
from tests.firmware.build import GCC, M7, Target
from tests.spark.kill_campaign import campaign
from tests.spark.streams import block_of, estimates_of, in_one_process, parts_of, rows_of, write_parts
from tests.test_moved_states import LEG, Firmware, fresh, monitor_of

if TYPE_CHECKING:
    from pyspark.sql import SparkSession

PACE = Pace(window=0.6, every=0.1)
SHARDS = 2


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write axis.toml and calibrate the axis."""
    monkeypatch.setattr(setup, "HOURS", 0.5)
    monkeypatch.setenv("PMFID_CACHE", str(tmp_path / "cache"))
    write_axis(tmp_path, 60.0)
    return tmp_path


def called(folder: Path, *words: str) -> tuple[int, str]:
    """Call `pmfid fleet` with these words."""
    done = CliRunner().invoke(main, ["fleet", *words, "--config", str(folder / "axis.toml")])
    return done.exit_code, done.output


def streamed(folder: Path, source: str, number: int, *more: str) -> tuple[int, str]:
    """Call `pmfid fleet stream` on a folder; `number` names the output of the stream."""
    places = ["--out", str(folder / f"out-{number}"), "--checkpoint", str(folder / f"checkpoint-{number}")]
    pace = ["--shards", str(SHARDS), "--window", "0.6", "--every", "0.1", "--once"]
    return called(folder, "stream", str(folder / source), *places, *pace, *more)


def test_a_stream_moves_to_another_one_and_gives_what_one_process_gives(spark: SparkSession, folder: Path) -> None:
    """Parquet files go through one stream. The stream's states go through a service's folder into a second stream,
    which reads growing files.
    """
    plan, rows = StreamPlan(prepare(folder / "axis.toml"), PACE, SHARDS), rows_of(4, 16.0)
    before, after = parts_of(rows, 2)
    bodies, table = in_one_process(plan, [before, after])
    write_parts(folder / "in", parts_of(before, 2))
    assert streamed(folder, "in", 1) == (0, "")
    assert called(folder, "state", str(folder / "checkpoint-1"), "--out", str(folder / "state"))[0] == 0

    (folder / "more").mkdir()
    half = len(after) // 2
    data = b"".join(block for _, block in after[:half])
    (folder / "more" / "a.pmfb").write_bytes(data + after[half][1][:50])
    assert streamed(folder, "more", 2, "--state", str(folder / "state")) == (0, "")
    (folder / "more" / "a.pmfb").write_bytes(data + b"".join(block for _, block in after[half:]))
    assert streamed(folder, "more", 2) == (0, "")
    assert called(folder, "state", str(folder / "checkpoint-2"), "--out", str(folder / "end"))[0] == 0

    ended, expected = (
        States.from_folder(folder / "end", plan.prepared.digest),
        States.from_bodies(bodies, plan.prepared.digest),
    )
    assert ended.axes == expected.axes
    for name in ended.axes:
        one, other = (states.monitor(name, plan.prepared, PACE).get_state() for states in (ended, expected))
        assert one == other, name
    given = pl.concat([pl.read_parquet(folder / f"out-{k}" / "estimates" / "*.parquet") for k in (1, 2)])
    wanted = estimates_of(table).select(given.columns)
    assert given.sort("axis", "number").equals(wanted, null_equal=True)
    notices = pl.concat([pl.read_parquet(folder / f"out-{k}" / "notices" / "*.parquet") for k in (1, 2)])
    wanted = table.filter((pl.col("row") == "notice") & (pl.col("number") > 0)).select(notices.columns)
    found = notices.filter(pl.col("number") > 0)
    assert found.sort("axis", "number").equals(wanted.sort("axis", "number"), null_equal=True)


@pytest.mark.skipif(bool(GCC.missing), reason=GCC.missing)
@pytest.mark.parametrize("target", [GCC if M7.missing else M7], ids=lambda target: target.name)
def test_a_state_goes_from_firmware_through_spark_and_back(spark: SparkSession, folder: Path, target: Target) -> None:
    """A state goes through firmware, Python, Spark, `Fleet` and firmware without a change of the estimates."""
    prepared = prepare(folder / "axis.toml")
    motion = block_of("x1", 5 * LEG * CART_DT, seed=5)
    legs = [(motion.u[k : k + LEG], motion.counts[k : k + LEG]) for k in range(0, 5 * LEG, LEG)]
    firmware = Firmware(fresh(prepared), folder / "firmware", target)
    first, state = firmware.run(None, *legs[0])
    estimator = fresh(prepared)
    estimator.set_state(state)
    second = estimator.run(*legs[1]).theta

    States.from_monitors({"x1": monitor_of(prepared, estimator)}, prepared, PACE).write(
        folder / "state", prepared, PACE
    )
    write_parts(folder / "in", [[("x1", encode(Block("x1", 3, 70, 0.7, CART_DT, *legs[2])))]])
    assert streamed(folder, "in", 1, "--state", str(folder / "state"), "--every", "0") == (0, "")
    assert called(folder, "state", str(folder / "checkpoint-1"), "--axis", "x1", "--out", str(folder / "end"))[0] == 0
    given = pl.read_parquet(folder / "out-1" / "estimates" / "*.parquet").sort("number")
    third = given.select(prepared.setup.monitor.names).to_numpy()
    moved = States.from_folder(folder / "end", prepared.digest).monitor("x1", prepared, PACE).estimator

    fleet = pmfid.Fleet(moved, 2)
    fourth = np.asarray(fleet.run(*(np.tile(one, (2, 1)) for one in legs[3]), every=1).theta)[1]
    fifth, _ = firmware.run(fleet.axis(1).get_state(), *legs[4])
    straight = fresh(prepared).run(motion.u, motion.counts).theta
    assert np.concatenate([first, second, third, fourth, fifth]).tobytes() == np.ascontiguousarray(straight).tobytes()


def test_kills_leave_no_trace(spark: SparkSession, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A small form of the campaign of `python -m tests.spark.kill_campaign`."""
    monkeypatch.setattr(setup, "HOURS", setup.HOURS)
    monkeypatch.setenv("PMFID_CACHE", str(tmp_path / "cache"))
    assert campaign(tmp_path, kills=2, axes=3, seconds=10.0, files=8).kills == 2


def test_what_is_refused_is_said_with_a_remedy(spark: SparkSession, folder: Path) -> None:
    code, said = streamed(folder, "nowhere", 1)
    assert code == 2
    assert "this is not a folder; give the folder" in said
    (folder / "in").mkdir()
    (folder / "in" / "a.parquet").write_bytes(b"no Parquet")
    code, said = streamed(folder, "in", 1)
    assert code == 2
    assert said.startswith("pmfid: the stream stopped")
    assert "Traceback" not in said
    assert said.count("\n") == 1
    text = (folder / "axis.toml").read_text()
    (folder / "axis.toml").write_text(text.replace("forgetting = 0.99", "forgetting = 0.995"))
    code, said = streamed(folder, "in", 1)
    assert code == 2
    assert "the stream began with another config" in said
    code, said = called(folder, "state", str(folder / "checkpoint-1"), "--out", str(folder / "state"))
    assert code == 2

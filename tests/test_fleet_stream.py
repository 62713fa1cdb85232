"""A shard of a stream has the bits of a single monitor for any batches, and its state can move."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace
from pathlib import Path
from random import Random

import numpy as np
import polars as pl
import pytest

from pmfid.errors import UsageError
from pmfid.fleet.shards import Folder, States, StreamPlan, StreamSettings, StreamShard, open_folder, shard_of, table_of
from pmfid.fleet.spark.stream import SparkLog
from pmfid.monitor.fleet import MonitorFleet
from pmfid.stream.blocks import encode
from pmfid.stream.checkpoint import read_snapshot
from pmfid.stream.groups import Pace, Prepared
from tests.spark.streams import block_of, estimates_of, in_one_process, parts_of, rows_of

PACE = Pace(window=0.6, every=0.1)


@pytest.fixture(scope="module")
def rows() -> list[tuple[str, bytes]]:
    return rows_of(4, 12.0)


def restarted(plan: StreamPlan, batches: list[list[tuple[str, bytes]]]) -> tuple[dict[int, bytes], pl.DataFrame]:
    """Return the output of `in_one_process` with a new shard for each batch, whose blocks come in any order."""
    bodies, tables = dict[int, bytes](), list[pl.DataFrame]()
    for k, batch in enumerate(batches):
        mixed = Random(k).sample(batch, len(batch))
        for number in sorted({shard_of(name, plan.shards) for name, _ in mixed}):
            shard = StreamShard(plan, number, bodies.get(number))
            shard.take([data for name, data in mixed if shard_of(name, plan.shards) == number])
            bodies[number] = shard.save_state()
            tables.append(table_of(shard))
    return bodies, pl.concat(tables)


def test_restarts_and_other_batches_give_the_same_bits(prepared: Prepared, rows: list[tuple[str, bytes]]) -> None:
    whole, expected = in_one_process(StreamPlan(prepared, PACE, 1), [rows])
    for shards, files in ((1, 7), (3, 4)):
        bodies, table = restarted(StreamPlan(prepared, PACE, shards), parts_of(rows, files))
        assert estimates_of(table).equals(estimates_of(expected), null_equal=True)
        ours = States.from_bodies(bodies, prepared.digest)
        theirs = States.from_bodies(whole, prepared.digest)
        assert ours.axes == theirs.axes
        for name in ours.axes:
            one, other = (s.monitor(name, prepared, PACE).get_state() for s in (ours, theirs))
            assert one == other, name


def test_what_a_wrong_order_of_files_loses_is_counted(prepared: Prepared) -> None:
    """Spark reads files of the same age in any order, which does not matter within one batch. With a batch for each
    file, blocks out of order by more than the window count as late."""
    plan = StreamPlan(prepared, PACE, 1)
    data = [encode(replace(block_of("x1", 1.0), first=first)) for first in (0, 100, 200)]
    mixed = [data[0], data[2], data[1]]
    together = StreamShard(plan, 0)
    together.take(mixed)
    assert together.count_samples()["samples"] == 300
    assert "dropped_late" not in together.count_samples()

    counted, body = dict[str, float](), None
    for message in mixed:
        shard = StreamShard(plan, 0, body)
        shard.take([message])
        body = shard.save_state()
        for name, value in shard.count_samples().items():
            counted[name] = counted.get(name, 0) + value
    assert counted["samples"] == 200
    assert counted["dropped_late"] == counted["missing"] == 100


def test_a_batch_that_comes_again_changes_nothing(prepared: Prepared, rows: list[tuple[str, bytes]]) -> None:
    plan = StreamPlan(prepared, PACE, 1)
    first = StreamShard(plan, 0)
    first.take([data for _, data in rows])
    again = StreamShard(plan, 0, first.save_state())
    again.take([data for _, data in rows])
    assert "samples" not in again.count_samples()
    assert again.count_samples()["dropped_duplicate"] > 0
    assert read_snapshot(again.save_state()).groups[0].state == read_snapshot(first.save_state()).groups[0].state


def test_what_is_no_block_is_counted_and_the_rest_is_done(prepared: Prepared) -> None:
    plan = StreamPlan(prepared, PACE, 1)
    shard = StreamShard(plan, 0)
    good = encode(block_of("good"))
    bad = bytearray(encode(block_of("bad")))
    bad[-9] ^= 1
    shard.take([b"", b"rubbish", bytes(bad), good, good[:30]])
    counted = shard.count_samples()
    assert counted["samples"] == 100
    assert counted["unusable_crc"] == 1
    assert sum(value for name, value in counted.items() if name.startswith("unusable")) >= 3


def test_an_axis_by_the_name_of_another_one_is_refused(prepared: Prepared) -> None:
    plan = StreamPlan(prepared, PACE, 5)
    own = next(f"a{k}" for k in range(99) if shard_of(f"a{k}", 5) == 2)
    other = next(f"a{k}" for k in range(99) if shard_of(f"a{k}", 5) == 3)
    shard = StreamShard(plan, 2)
    shard.take([encode(block_of(own)), encode(block_of(other))])
    assert shard.count_samples() == {"samples": 100.0, "unusable_name": 1.0}
    assert read_snapshot(shard.save_state()).groups[0].axes == (own,)


def test_numbers_of_axes_are_those_of_no_other_shard(prepared: Prepared) -> None:
    plan = StreamPlan(prepared, PACE, 3)
    names = [f"a{k}" for k in range(12)]
    bodies, _ = restarted(plan, [[(n, encode(block_of(n))) for n in part] for part in (names[:5], names)])
    numbers = np.concatenate([read_snapshot(body).groups[0].seats["seat"] for body in bodies.values()])
    assert np.unique(numbers).size == len(names)
    assert numbers.min() > 0


def test_states_go_through_a_service_and_back(
    prepared: Prepared, rows: list[tuple[str, bytes]], tmp_path: Path
) -> None:
    """A state moves from 3 shards into the folder of a service and into 2 other shards without an effect."""
    before, after = parts_of(rows, 2)
    straight, _ = in_one_process(StreamPlan(prepared, PACE, 1), [before, after])
    bodies, _ = in_one_process(StreamPlan(prepared, PACE, 3), [before])
    States.from_bodies(bodies, prepared.digest).write(tmp_path / "state", prepared, PACE)
    found = States.from_folder(tmp_path / "state", prepared.digest)
    plan = StreamPlan(prepared, PACE, 2)
    begun = found.bodies(plan)
    ended = dict[int, bytes]()
    for number in range(2):
        shard = StreamShard(plan, number, begun.get(number))
        shard.take([data for name, data in after if shard_of(name, 2) == number])
        ended[number] = shard.save_state()
    moved, stayed = States.from_bodies(ended, prepared.digest), States.from_bodies(straight, prepared.digest)
    assert moved.axes == stayed.axes == [f"axis-{k}" for k in range(4)]
    for name in moved.axes:
        states = [states.monitor(name, prepared, PACE).get_state() for states in (moved, stayed)]
        assert states[0] == states[1], name


def test_some_axes_alone_are_written(prepared: Prepared, rows: list[tuple[str, bytes]], tmp_path: Path) -> None:
    bodies, _ = in_one_process(StreamPlan(prepared, PACE, 3), [rows])
    states = States.from_bodies(bodies, prepared.digest)
    assert states.write(tmp_path / "state", prepared, PACE, ["axis-2"]) == 1
    assert States.from_folder(tmp_path / "state", prepared.digest).axes == ["axis-2"]
    with pytest.raises(UsageError, match="not contain the axis 'axis-22'"):
        states.write(tmp_path / "state", prepared, PACE, ["axis-22"])
    with pytest.raises(UsageError, match="another configuration"):
        States.from_folder(tmp_path / "state", "0" * 64)


def test_a_changed_configuration_is_refused_with_a_remedy(tmp_path: Path) -> None:
    settings = StreamSettings("digest", 4, 0.5, 1.0, "blocks")
    for _ in range(2):
        begun(tmp_path, settings)
    for changed in (replace(settings, config="other"), replace(settings, shards=5), replace(settings, source="there")):
        with pytest.raises(UsageError, match=r"the stream began with another .*give"):
            begun(tmp_path, changed)
    with pytest.raises(UsageError, match="results of another stream"):
        begun(tmp_path, settings, checkpoint="new")
    (tmp_path / "else").mkdir()
    (tmp_path / "else" / "a.txt").write_text("")
    with pytest.raises(UsageError, match="contains other files"):
        begun(tmp_path, settings, out="else")
    with pytest.raises(UsageError, match="is not a checkpoint"):
        begun(tmp_path, settings, checkpoint="else")
    with pytest.raises(UsageError, match="another folder"):
        begun(tmp_path, settings, out="checkpoint")
    assert [path.name for path in (tmp_path / "else").iterdir()] == ["a.txt"]


def test_one_stream_at_a_time_has_a_checkpoint(tmp_path: Path) -> None:
    settings = StreamSettings("digest", 4, 0.5, 1.0, "blocks")
    with (
        open_folder(tmp_path / "checkpoint", tmp_path / "out", settings),
        pytest.raises(UsageError, match="another stream already uses"),
    ):
        begun(tmp_path, settings)
    begun(tmp_path, settings)


def begun(folder: Path, settings: StreamSettings, checkpoint: str = "checkpoint", out: str = "out") -> Folder:
    with open_folder(folder / checkpoint, folder / out, settings) as found:
        return found


def test_a_folder_that_cannot_be_made_is_said(tmp_path: Path) -> None:
    settings = StreamSettings("digest", 4, 0.5, 1.0, "blocks")
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match=r"give|choose"):
        begun(tmp_path, settings, checkpoint="file/below")
    with pytest.raises(UsageError, match=r"give|choose"):
        begun(tmp_path, settings, out="file/below")


def test_a_failure_of_spark_is_said_with_what_helps(tmp_path: Path) -> None:
    (tmp_path / "spark.log").write_text("java.lang.OutOfMemoryError: Java heap space\n")  # file of an earlier run
    log = SparkLog(tmp_path)
    assert "restore a copy" in log.problem(ValueError("Incomplete log file in the offset commit log"))
    said = log.problem(ValueError("[FAILED_READ_FILE] a.parquet\n  File x\njava.io.IOException: no such file\n  at y"))
    assert "stopped: java.io.IOException: no such file; correct the cause" in said
    with open(log.path, "a") as file:
        file.write('Exception in thread "x" java.lang.OutOfMemoryError: Java heap space\n')
    assert "SPARK_DRIVER_MEMORY=8g" in log.problem(ValueError("EOFError"))


def test_a_batch_written_again_replaces_itself(prepared: Prepared, tmp_path: Path) -> None:
    settings = StreamSettings("digest", 1, 0.5, 1.0, "blocks")
    folder = begun(tmp_path, settings)
    shard = StreamShard(StreamPlan(prepared, PACE, 1), 0)
    shard.take([encode(block_of("a"))])
    (tmp_path / "out" / "estimates" / "batch-0000000000.parquet.7.part").write_bytes(b"half")
    for _ in range(2):
        folder.write(0, table_of(shard))
    begun(tmp_path, settings)
    files = sorted(path.name for path in (tmp_path / "out" / "estimates").iterdir())
    assert files == ["batch-0000000000.parquet"]
    assert pl.read_parquet(tmp_path / "out" / "estimates" / files[0]).height == 10


def test_a_monitor_is_copied_and_pickled_with_its_state(prepared: Prepared) -> None:
    block = block_of("a", 20.0)
    monitor = copy.deepcopy(prepared.setup.monitor)
    monitor.run(block.u[:1000], block.counts[:1000])
    other = pickle.loads(pickle.dumps(monitor))
    assert other.get_state() == monitor.get_state()
    a, b = (one.run(block.u[1000:], block.counts[1000:]) for one in (monitor, other))
    assert a.theta.tobytes() == b.theta.tobytes()
    assert other.configuration_number == prepared.setup.monitor.configuration_number


def test_fleets_are_joined_from_their_states(prepared: Prepared) -> None:
    monitor, block = prepared.setup.monitor, block_of("a", 3.0)
    one, other = MonitorFleet(monitor, 1), MonitorFleet(monitor, 2)
    one.run([0], block.u[None], block.counts[None])
    assert other.join(one.get_state()) == range(2, 3)
    assert other.monitor(2).get_state() == one.monitor(0).get_state()
    with pytest.raises(UsageError):
        other.join(b"rubbish")
    assert other.axes == 3

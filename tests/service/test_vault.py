"""Checkpoints: two generations, damaged files set aside, and disks that are full, read-only or not owned."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from threading import current_thread
from typing import Any

import numpy as np
import pytest

from pmfid import durable as module
from pmfid.errors import UsageError
from pmfid.service import keeping
from pmfid.service.arrangement import arrange_groups
from pmfid.service.keeping import Checkpoints
from pmfid.service.sinks.queued import Queued
from pmfid.simulation import CART_DT
from pmfid.stream.checkpoint import StateBuffer, Vault, read_snapshot, snapshot
from pmfid.stream.delivery import Block, Delivery
from pmfid.stream.engine import StreamEngine
from pmfid.stream.groups import Pace, Prepared
from pmfid.stream.outcome import Counters, EstimateRows, Notice
from tests.patience import PATIENCE
from tests.tuned import set_tuning

Report = list[dict[str, Any]]


def as_text(body: bytes) -> str:
    """Read a state that this test has written."""
    if not body.startswith(b"state "):
        raise ValueError("it is no state")
    return body.decode()


def written(folder: Path, *bodies: bytes) -> None:
    vault = Vault(folder)
    vault.load(as_text, lambda reported: None)
    for body in bodies:
        vault.write([body[:3], body[3:]])
    vault.close()


def loaded(folder: Path) -> tuple[str | None, Report]:
    reported: Report = []
    vault = Vault(folder)
    found = vault.load(as_text, reported.append)
    vault.close()
    return found, reported


def flip(data: bytes, place: int) -> bytes:
    return data[:place] + bytes([data[place] ^ 4]) + data[place + 1 :]


#: Damages of a file by their kind.
DAMAGE: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda data: b"",
    "cut short": lambda data: data[:-1],
    "cut in the head": lambda data: data[:20],
    "one more byte": lambda data: data + b"x",
    "a bit of the body": lambda data: flip(data, len(data) - 2),
    "a bit of the sequence number": lambda data: flip(data, 16),
    "a bit of the length": lambda data: flip(data, 25),
    "a bit of the checksum": lambda data: flip(data, 13),
    "another version": lambda data: flip(data, 8),
    "zeros": lambda data: bytes(len(data)),
}


def test_the_newest_is_taken_and_two_generations_are_kept(tmp_path: Path) -> None:
    assert loaded(tmp_path / "a" / "b") == (None, [])
    written(tmp_path, b"state 1", b"state 2", b"state 3")
    written(tmp_path, b"state 4")
    assert loaded(tmp_path) == ("state 4", [])
    assert sorted(path.name for path in tmp_path.glob("checkpoint*")) == ["checkpoint-0", "checkpoint-1"]


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE)
def test_a_damaged_one_is_set_aside_and_the_older_one_is_taken(
    tmp_path: Path, damage: Callable[[bytes], bytes]
) -> None:
    written(tmp_path, b"state 1", b"state 2")
    newest = tmp_path / "checkpoint-0"
    newest.write_bytes(damage(newest.read_bytes()))
    found, reported = loaded(tmp_path)
    assert found == "state 1"
    assert [(what["event"], what["damaged"]) for what in reported] == [("checkpoint", "checkpoint-0.damaged-1")]
    assert (tmp_path / "checkpoint-0.damaged-1").exists()
    written(tmp_path, b"state 5")
    assert loaded(tmp_path) == ("state 5", [])


def test_with_neither_the_service_starts_again(tmp_path: Path) -> None:
    written(tmp_path, b"state 1", b"other 2")
    (tmp_path / "checkpoint-1").write_bytes(b"PMFIDCKP and nothing else")
    found, reported = loaded(tmp_path)
    assert found is None
    assert len(reported) == 2


def test_a_folder_has_one_service(tmp_path: Path) -> None:
    first = Vault(tmp_path)
    with pytest.raises(UsageError, match="another service already uses"):
        Vault(tmp_path)
    first.close()
    Vault(tmp_path).close()
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match=r"\[service\] state: .*choose a folder"):
        Vault(tmp_path / "file")


# --- the engine's state -----------------------------------------------------------------------------------------------


def engine_of(prepared: Prepared, window: float = 0.0) -> StreamEngine:
    engine = StreamEngine(Counters())
    engine.set_groups(arrange_groups([], {"x1": prepared, "x2": prepared}, Pace(window, 1.0))[0])
    return engine


def block(first: int, n: int = 10, axis: str = "x1") -> Block:
    return Block(axis, 0, first, 0.01 * first, CART_DT, np.sin(np.arange(n) + first), np.arange(first, first + n))


def test_a_snapshot_is_read_as_it_was_and_nothing_else_is(prepared: Prepared) -> None:
    engine = engine_of(prepared, 0.5)
    engine.process([Delivery("source", [block(0, 60), block(80), block(120), block(5, 70, "x2")], mark={"at": 7})])
    body = b"".join(snapshot(engine))
    found = read_snapshot(body)
    (group,) = [one.restore_group(prepared, Pace(0.5, 1.0)) for one in found.groups]
    again = StreamEngine(Counters())
    found.restore(again)
    again.set_groups([group])
    assert [b.first for b in group.seats[0].order.held] == [80, 120]
    assert snapshot(again)[2:] == snapshot(engine)[2:]
    assert again.marks == {"source": {"at": 7}}
    rng = np.random.default_rng(0)
    for cut in rng.integers(0, len(body), 60).tolist():
        with pytest.raises(ValueError, match=r".*"):
            _restored(body[:cut], prepared)


def _restored(body: bytes, prepared: Prepared) -> None:
    for one in read_snapshot(body).groups:
        one.restore_group(prepared, Pace())


class Broken:
    """A sink that accepts no rows until `works` is true."""

    name, works = "alarms", False

    def open(self) -> None:
        if not self.works:
            raise OSError(errno.ECONNREFUSED, "nobody is there")

    def put(self, outcomes: list[EstimateRows | Notice]) -> None:
        """Accept the rows."""

    def close(self) -> None: ...


def test_alarms_that_a_sink_does_not_have_yet_survive(prepared: Prepared) -> None:
    engine, sink, reported = engine_of(prepared), Broken(), Report()
    queued = Queued(sink, engine.counters, reported.append)
    engine.unwritten = lambda: {queued.name: queued.unwritten()}
    queued.start()
    alarm = Notice("x1", 7, 1.5, {"event": "alarm", "parameter": "mass"})
    queued.notice(alarm)
    queued.notice(Notice("x1", 8, 1.5, {"event": "state", "state": "settling"}))
    assert read_snapshot(b"".join(snapshot(engine))).unwritten == {"alarms": [alarm]}
    sink.works = True
    queued.close(10.0)
    assert read_snapshot(b"".join(snapshot(engine))).unwritten == {}


def test_a_disk_that_is_full_costs_checkpoints_not_the_watch(
    prepared: Prepared, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    counters, reported, done = Counters(), Report(), list[int]()
    keeper = Checkpoints(Vault(tmp_path), 0.0, counters, reported.append)
    engine = engine_of(prepared)
    engine.keeper = keeper

    def full(number: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def checkpoint(k: int) -> None:
        engine.process([Delivery("source", [block(10 * k)], lambda: done.append(k))])
        engine.urgent = True
        keeper.offer(engine)
        with keeper._changed:
            assert keeper._changed.wait_for(lambda: keeper._job is None, PATIENCE)

    checkpoint(0)
    with monkeypatch.context() as patch:
        patch.setattr(module.os, "fsync", full)
        checkpoint(1)
        checkpoint(2)
    checkpoint(3)
    keeper.offer(engine, last=True)
    assert done == [0, 1, 2, 3]
    assert [("works" in what, what.get("problem", "").split(";")[0]) for what in reported] == [
        (False, "no checkpoint can be written: No space left on device"),
        (True, ""),
    ]
    values = {name: value for (name, _), value in counters.values().items()}
    assert values["pmfid_checkpoint_errors_total"] == 2
    assert values["pmfid_checkpoint_working"] == 1
    vault = Vault(tmp_path)
    found = vault.load(read_snapshot, reported.append)
    vault.close()
    assert found is not None
    assert found.groups[0].restore_group(prepared, Pace()).numbers.tolist() == [40, 0]
    assert not list(tmp_path.glob("*.part"))


def test_a_large_state_is_not_written_all_the_time(
    prepared: Prepared, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now, made = [100.0], list[float]()
    monkeypatch.setattr(keeping, "monotonic", lambda: now[0])
    vault = Vault(tmp_path)

    def slow(chunks: list[bytes]) -> None:
        made.append(now[0])
        now[0] += 2.0

    monkeypatch.setattr(vault, "write", slow)
    keeper = Checkpoints(vault, 1.0, Counters(), Report().append)
    engine = engine_of(prepared)
    for k in range(60):
        now[0] += 0.5
        engine.changes += 1
        keeper.offer(engine)
        with keeper._changed:
            assert keeper._changed.wait_for(lambda: keeper._job is None, PATIENCE)
        if k == 50:
            engine.urgent = True
    keeper.offer(engine, last=True)
    # the fourth request comes from a user and is saved at once
    assert [b - a for a, b in pairwise(made)] == [10.0, 10.0, 10.0, 3.0, 6.0]


def test_deliveries_wait_for_a_checkpoint_that_has_them(prepared: Prepared, tmp_path: Path) -> None:
    done, reported = list[int](), Report()
    keeper = Checkpoints(Vault(tmp_path), 3600.0, Counters(), reported.append)
    engine = engine_of(prepared)
    engine.keeper = keeper
    for k in range(3):
        engine.process([Delivery("source", [block(10 * k)], lambda k=k: done.append(k))])
        keeper.offer(engine)
    assert done == []
    keeper.offer(engine, last=True)
    assert done == [0, 1, 2]
    assert reported == []


def test_an_alarm_that_a_sink_got_is_in_no_checkpoint_for_long_though_nothing_else_comes(
    prepared: Prepared, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_tuning(monkeypatch, keeping, keeping_rest=0.0)
    keeper, engine = Checkpoints(Vault(tmp_path), 0.0, Counters(), Report().append), engine_of(prepared)
    waiting = [Notice("x1", 7, 0.0, {"event": "alarm"})]
    engine.unwritten = lambda: {"hook": list(waiting)}
    engine.urgent = True
    for _ in range(3):
        keeper.offer(engine)
        with keeper._changed:
            assert keeper._changed.wait_for(lambda: keeper._job is None, PATIENCE)
        waiting.clear()
    assert keeper.vault.sequence == 2, "one with the alarm, one without, and no more"
    keeper.offer(engine, last=True)


def test_the_engine_does_not_wait_for_new_memory(
    prepared: Prepared, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_tuning(monkeypatch, keeping, keeping_large=0)
    keeper, makers = Checkpoints(Vault(tmp_path), 0.0, Counters(), Report().append), list[str]()
    grow = StateBuffer.grow

    def noted(room: StateBuffer, size: int) -> None:
        makers.append(current_thread().name)
        grow(room, size)

    monkeypatch.setattr(StateBuffer, "grow", noted)
    engine, done = engine_of(prepared), list[int]()
    engine.keeper = keeper
    for k in range(3):
        engine.process([Delivery("source", [block(10 * k)], lambda k=k: done.append(k))])
        engine.urgent = True
        keeper.offer(engine)
        with keeper._changed:
            assert keeper._changed.wait_for(lambda: keeper._job is None, PATIENCE)
        assert done == list(range(k + 1 if k else 0))
    keeper.offer(engine, last=True)
    assert makers == ["checkpoints"]
    (saved,) = read_snapshot(b"".join(snapshot(engine))).groups
    vault = Vault(tmp_path)
    found = vault.load(read_snapshot, Report().append)
    vault.close()
    assert found is not None
    assert bytes(found.groups[0].state) == bytes(saved.state)

"""The states in the file of a service: damaged files are set aside, and a full disk costs only checkpoints."""

from __future__ import annotations

import errno
import resource
import signal
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pmfid.service.arrangement import arrange_groups
from pmfid.service.keeping import Checkpoints
from pmfid.service.sinks.queued import Queued
from pmfid.simulation import CART_DT
from pmfid.stream.checkpoint import draft, read_snapshot
from pmfid.stream.delivery import Block, Delivery
from pmfid.stream.engine import StreamEngine
from pmfid.stream.groups import Pace, Prepared
from pmfid.stream.outcome import Counters, EstimateRows, Notice
from pmfid.stream.store import FILE, Vault
from tests.patience import PATIENCE
from tests.refusals import refused
from tests.service.feed import alarm, notice
from tests.service.kills import killed_after

Report = list[dict[str, Any]]


def as_text(body: bytes, alarms: list[Notice]) -> str:
    """Read a state that this test has written, and the numbers of the notices of alarms."""
    if not body.startswith(b"state "):
        raise ValueError("it is no state")
    return " ".join([body.decode(), *(str(one.number) for one in alarms)])


def written(folder: Path, *bodies: bytes) -> None:
    vault = Vault(folder)
    vault.load(as_text, lambda reported: None)
    for body in bodies:
        vault.write([body[:3], body[3:]])
    vault.close()


def loaded(folder: Path) -> tuple[str | None, Report]:
    reported: Report = []
    with closing(Vault(folder)) as vault:
        return vault.load(as_text, reported.append), reported


def flip(data: bytes, place: int) -> bytes:
    return data[:place] + bytes([data[place] ^ 4]) + data[place + 1 :]


#: Damages of a file by their kind.
DAMAGE: dict[str, Callable[[bytes], bytes]] = {
    "cut short": lambda data: data[:-4096],
    "cut in the head": lambda data: data[:20],
    "a bit of the body": lambda data: flip(data, data.index(b"te 2") + 3),
    "no file of SQLite": lambda data: b"x" * len(data),
}


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE)
def test_a_damaged_file_is_set_aside(tmp_path: Path, damage: Callable[[bytes], bytes]) -> None:
    written(tmp_path, b"state 1", b"state 2")
    path = tmp_path / FILE
    path.write_bytes(damage(path.read_bytes()))
    found, reported = loaded(tmp_path)
    assert found is None
    assert [(what["event"], what["damaged"]) for what in reported] == [("checkpoint", f"{FILE}.damaged-1")]
    assert (tmp_path / f"{FILE}.damaged-1").exists()
    written(tmp_path, b"state 5")
    assert loaded(tmp_path) == ("state 5", [])


def test_a_folder_has_one_service(tmp_path: Path) -> None:
    first = Vault(tmp_path)
    refused(("another service already uses", lambda: Vault(tmp_path)))
    first.close()
    Vault(tmp_path).close()
    (tmp_path / "file").write_text("")
    refused((r"\[service\] state: .*choose a folder", lambda: Vault(tmp_path / "file")))


# --- notices ----------------------------------------------------------------------------------------------------------


def of(folder: Path, query: str) -> list[tuple[Any, ...]]:
    with closing(sqlite3.connect(folder / FILE)) as database:
        return database.execute(query).fetchall()


@contextmanager
def full_at(size: int) -> Iterator[None]:
    """Limit the size of files, as a full disk does."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, ignored)


def test_alarms_acknowledgements_and_configurations_have_views(tmp_path: Path) -> None:
    configured = notice(3, "configuration", config="cart.toml", digest="ab12")
    known = notice(4, "acknowledged", alarm=1, note="seen; DROP TABLE notices")
    with closing(Vault(tmp_path)) as vault:
        vault.write([b"state 1"], [alarm(1), notice(2, "gap", missing=5), configured])
        vault.write([], [known])
    assert loaded(tmp_path) == ("state 1 1 4", [])
    assert of(tmp_path, "SELECT number, axis, parameter, relative, changed_at, unit FROM alarms") == [
        (1, "x1", "mass", 0.2, 11.0, "kg")
    ]
    assert of(tmp_path, "SELECT a.number, k.note FROM acknowledgements k JOIN alarms a ON a.id = k.alarm") == [
        (1, "seen; DROP TABLE notices")
    ]
    assert of(tmp_path, "SELECT axis, config, digest FROM configurations") == [("x1", "cart.toml", "ab12")]
    events = [event for (event,) in of(tmp_path, "SELECT event FROM notices ORDER BY id")]
    assert events == ["alarm", "gap", "configuration", "acknowledged"]


WRITER = """
import sys
from pathlib import Path
from pmfid.stream.store import Vault
from tests.service.feed import alarm
vault = Vault(Path(sys.argv[1]))
for number in range(1, 10**6, 3):
    vault.write([b"state %d" % number], [alarm(number), alarm(number + 1), alarm(number + 2)])
    print(number + 2, flush=True)
"""


@pytest.mark.parametrize("lines", [1, pytest.param(40, marks=pytest.mark.long)])
def test_after_a_kill_states_and_notices_fit_together(tmp_path: Path, lines: int) -> None:
    last = int(killed_after(WRITER, lines, str(tmp_path))[-1])
    numbers = [number for (number,) in of(tmp_path, "SELECT number FROM alarms ORDER BY id")]
    assert len(numbers) in (last, last + 3), "all of a write or none"
    assert numbers == list(range(1, len(numbers) + 1))
    state, _ = loaded(tmp_path)
    assert state is not None
    assert state.split()[:2] == ["state", str(len(numbers) - 2)]
    assert of(tmp_path, "PRAGMA integrity_check") == [("ok",)]


# --- the engine's state -----------------------------------------------------------------------------------------------


def engine_of(prepared: Prepared, window: float = 0.0) -> StreamEngine:
    engine = StreamEngine(Counters())
    engine.set_groups(arrange_groups([], {"x1": prepared, "x2": prepared}, Pace(window, 1.0))[0])
    return engine


def block(first: int, n: int = 10, axis: str = "x1") -> Block:
    return Block(axis, 0, first, 0.01 * first, CART_DT, np.sin(np.arange(n) + first), np.arange(first, first + n))


def test_a_snapshot_is_read_as_it_was_and_nothing_else_is(prepared: Prepared) -> None:
    engine = engine_of(prepared, 0.5)
    engine.process([Delivery("source", [block(0, 60), block(80), block(120), block(5, 70, "x2")])])
    body = b"".join(draft(engine).chunks())
    found = read_snapshot(body)
    (group,) = [one.restore_group(prepared, Pace(0.5, 1.0)) for one in found.groups]
    again = StreamEngine(Counters())
    found.restore(again)
    again.set_groups([group])
    assert [b.first for b in group.seats[0].order.held] == [80, 120]
    assert draft(again).chunks()[2:] == draft(engine).chunks()[2:]
    rng = np.random.default_rng(0)
    for cut in rng.integers(0, len(body), 60).tolist():
        with pytest.raises(ValueError, match=r".*"):
            _restored(body[:cut], prepared)


def _restored(body: bytes, prepared: Prepared) -> None:
    for one in read_snapshot(body).groups:
        one.restore_group(prepared, Pace(0.5, 1.0))


class Broken:
    """A sink that accepts no rows until `works` is true."""

    name, works, takes_rows = "alarms", False, True
    events: frozenset[str] | None = None

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
    queued.notice(alarm(7))
    queued.notice(notice(8, "state", state="settling"))
    assert read_snapshot(b"".join(draft(engine).chunks())).unwritten == {"alarms": [alarm(7)]}
    sink.works = True
    queued.close(10.0)
    assert read_snapshot(b"".join(draft(engine).chunks())).unwritten == {}


def wait_for_writer(keeper: Checkpoints) -> None:
    if keeper._job is not None:
        keeper._job.result(PATIENCE)


def test_a_disk_that_is_full_costs_checkpoints_not_the_watch(prepared: Prepared, tmp_path: Path) -> None:
    counters, reported, done = Counters(), Report(), list[int]()
    keeper = Checkpoints(Vault(tmp_path), 0.0, counters, reported.append, begun=True)
    engine = engine_of(prepared)
    engine.keeper = keeper

    def checkpoint(k: int) -> None:
        engine.process([Delivery("source", [block(10 * k)], lambda: done.append(k))])
        engine.urgent = True
        keeper.offer(engine)
        wait_for_writer(keeper)

    checkpoint(0)
    keeper.notice(alarm(1))
    with full_at(8192):
        checkpoint(1)
        keeper.notice(alarm(2))
        checkpoint(2)
    assert of(tmp_path, "SELECT count(*) FROM notices") == [(0,)]
    checkpoint(3)
    keeper.offer(engine, last=True)
    assert done == [0, 1, 2, 3]
    assert [("works" in what, what.get("problem", "").split(";")[0]) for what in reported] == [
        (False, f"no checkpoint can be written: {FILE}: disk I/O error"),
        (True, ""),
    ]
    values = {name: value for (name, _), value in counters.values().items()}
    assert values["pmfid_checkpoint_errors_total"] == 2
    assert values["pmfid_checkpoint_working"] == 1
    vault = Vault(tmp_path)
    found = vault.load(read_snapshot, reported.append)
    vault.close()
    assert found is not None
    assert [one.number for one in found.alarms] == [1, 2]
    assert found.groups[0].restore_group(prepared, Pace(0.5, 1.0)).numbers.tolist() == [40, 0]

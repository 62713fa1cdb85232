"""The history of a service: each alarm once, a batch completely or not at all, and present after a kill."""

from __future__ import annotations

import resource
import signal
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest

from pmfid.service.sinks.history import HistorySink
from pmfid.stream import store
from pmfid.stream.outcome import EstimateRows, Notice
from tests.service.feed import alarm, block, kindred, notice
from tests.service.kills import killed_after


def of(path: Path, query: str) -> list[tuple[Any, ...]]:
    with closing(sqlite3.connect(path)) as database:
        return database.execute(query).fetchall()


def written(path: Path, *outcomes: EstimateRows | Notice) -> None:
    sink = HistorySink(path)
    sink.open()
    sink.put(list(outcomes))
    sink.close()


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
    path = tmp_path / "alarms.sqlite"
    configured = notice(3, "configuration", config="cart.toml", digest="ab12")
    known = notice(4, "acknowledged", alarm=1, note="seen; DROP TABLE notices")
    written(path, alarm(1), block(kindred()), notice(2, "gap", missing=5), configured, known)
    assert of(path, "SELECT number, axis, parameter, relative, changed_at, unit FROM alarms") == [
        (1, "x1", "mass", 0.2, 11.0, "kg")
    ]
    assert of(path, "SELECT a.number, k.note FROM acknowledgements k JOIN alarms a ON a.id = k.alarm") == [
        (1, "seen; DROP TABLE notices")
    ]
    assert of(path, "SELECT axis, config, digest FROM configurations") == [("x1", "cart.toml", "ab12")]
    assert of(path, "SELECT number, event, json_extract(what, '$.missing') FROM notices ORDER BY id") == [
        (1, "alarm", None),
        (2, "gap", 5),
        (3, "configuration", None),
        (4, "acknowledged", None),
    ]
    assert of(path, "PRAGMA journal_mode") == [("wal",)]
    assert of(path, "PRAGMA user_version") == [(store.VERSION,)]


def test_what_comes_again_is_written_once(tmp_path: Path) -> None:
    path = tmp_path / "a.sqlite"
    written(path, alarm(1), alarm(2), notice(3, "acknowledged", alarm=2, note="known"))
    again = Notice("x1", 2, 1.8e9, alarm(2).what)  # found at another time, as after a restart
    written(path, again, notice(3, "acknowledged", alarm=2, note="known"), alarm(4))
    assert of(path, "SELECT number FROM alarms") == [(1,), (2,), (4,)]
    assert of(path, "SELECT count(*) FROM acknowledgements") == [(1,)]


def test_all_or_none_on_a_full_disk_and_all_when_there_is_room(tmp_path: Path) -> None:
    path = tmp_path / "a.sqlite"
    sink = HistorySink(path)
    sink.open()
    sink.put([alarm(1)])
    wal = path.with_name("a.sqlite-wal")
    many = [alarm(number, note="n" * 200) for number in range(2, 300)]
    with full_at(wal.stat().st_size + 20_000), pytest.raises(OSError, match=r"a\.sqlite: "):
        sink.put(many)
    assert of(path, "SELECT count(*) FROM alarms") == [(1,)]
    sink.open()
    sink.put(many)
    sink.close()
    assert of(path, "SELECT count(*) FROM alarms") == [(299,)]
    assert of(path, "PRAGMA integrity_check") == [("ok",)]


WRITER = """
import sys
from pathlib import Path
from pmfid.service.sinks.history import HistorySink
from tests.service.feed import alarm
sink = HistorySink(Path(sys.argv[1]))
sink.open()
for number in range(1, 10**6, 3):
    sink.put([alarm(number), alarm(number + 1), alarm(number + 2)])
    print(number + 2, flush=True)
"""


@pytest.mark.long
@pytest.mark.parametrize("lines", [1, 40])
def test_after_a_kill_all_that_was_put_is_there(tmp_path: Path, lines: int) -> None:
    path = tmp_path / "a.sqlite"
    last = int(killed_after(WRITER, lines, str(path))[-1])
    found = [number for (number,) in of(path, "SELECT number FROM alarms ORDER BY id")]
    assert found[:last] == list(range(1, last + 1))
    assert len(found) in (last, last + 3), "all of a put or none"
    written(path, *(alarm(number) for number in range(last - 2, last + 7)))
    assert of(path, "SELECT count(*), max(number) FROM alarms") == [(last + 6, last + 6)]
    assert of(path, "PRAGMA integrity_check") == [("ok",)]

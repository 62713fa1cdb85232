"""The history of a service: each alarm once, a batch completely or not at all, and present after a kill."""

from __future__ import annotations

import math
import resource
import signal
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest

from pmfid.service.sinks.history import HistorySink
from pmfid.service.sinks.queued import Queued
from pmfid.stream import store
from pmfid.stream.outcome import EstimateRows, Notice
from tests.patience import PATIENCE
from tests.refusals import refused
from tests.service.feed import Host, alarm, block, kindred, notice, until
from tests.service.kills import killed_after
from tests.tuned import set_tuning


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


def test_a_service_that_counts_from_one_again_loses_no_alarm(tmp_path: Path) -> None:
    path = tmp_path / "a.sqlite"
    written(path, alarm(1), notice(2, "acknowledged", alarm=1, note="old"))
    written(path, alarm(1, time=99.0), alarm(1, axis="x2"), notice(2, "acknowledged", alarm=1, note="new"))
    assert of(path, "SELECT axis, time FROM alarms") == [("x1", 12.5), ("x1", 99.0), ("x2", 12.5)]
    assert of(path, "SELECT a.time, k.note FROM acknowledgements k JOIN alarms a ON a.id = k.alarm") == [
        (12.5, "old"),
        (99.0, "new"),
    ]


def test_the_history_of_configurations_has_what_changed(tmp_path: Path) -> None:
    path = tmp_path / "a.sqlite"
    digests = ["aa", "aa", "bb", "bb", "aa"]
    for number, digest in enumerate(digests):
        written(path, notice(number, "configuration", axis="", config="cart.toml", digest=digest, wall=number))
        written(path, notice(100 + number, "configuration", axis="", config="cell.toml", digest="cc"))
        written(path, notice(200 + number, "configuration", axis="", config="cart.toml", problem="it cannot be read"))
    assert of(path, "SELECT config, digest FROM configurations ORDER BY id") == [
        ("cart.toml", "aa"),
        ("cell.toml", "cc"),
        ("cart.toml", "bb"),
        ("cart.toml", "aa"),
    ]


def test_numbers_that_are_none_and_alarms_that_are_not_there(tmp_path: Path) -> None:
    path = tmp_path / "a.sqlite"
    written(
        path, alarm(1, std=math.inf, relative=math.nan), notice(2, "acknowledged", alarm=None), notice(3, "x", axis="")
    )
    assert of(path, "SELECT std, relative FROM alarms") == [(None, None)]
    assert of(path, "SELECT alarm, note FROM acknowledgements") == [(None, "")]


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


def test_a_history_that_cannot_be_written_tells_and_goes_on_by_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_tuning(monkeypatch, "pmfid.service.sinks.queued", queued_first_pause=0.01)
    host = Host(tmp_path)
    (tmp_path / "a.sqlite").mkdir()
    outlet = Queued(HistorySink(tmp_path / "a.sqlite"), host.counters, host.tell)
    outlet.start()
    outlet.notice(alarm(1))
    outlet.rows(block(kindred()))
    assert until(lambda: host.reported)
    (tmp_path / "a.sqlite").rmdir()
    assert until(lambda: len(host.reported) == 2)
    assert outlet.close(PATIENCE)
    assert "a.sqlite" in host.reported[0]["problem"]
    assert host.reported[1]["works"]
    assert of(tmp_path / "a.sqlite", "SELECT number FROM alarms") == [(1,)]


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="this system has no /proc, where nobody can make files")
def test_a_folder_that_is_read_only_is_an_error_that_may_pass() -> None:
    refused(("unable to open", HistorySink(Path("/proc/a.sqlite")).open), kind=OSError)


def test_files_of_others_are_left_alone(tmp_path: Path) -> None:
    text, other, newer = (tmp_path / name for name in ("text", "other", "newer"))
    text.write_text("no database, and long enough to be taken for one " * 30)
    with closing(sqlite3.connect(other)) as database:
        database.execute("CREATE TABLE alarms (a)")
    with closing(sqlite3.connect(newer)) as database:
        database.execute(f"PRAGMA application_id = {store.APPLICATION}")
        database.execute(f"PRAGMA user_version = {store.VERSION + 1}")
    for path, problem in ((text, "not a database"), (other, "another program"), (newer, "another version")):
        before = path.read_bytes()
        refused((problem, HistorySink(path).open), kind=OSError)
        assert path.read_bytes() == before


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

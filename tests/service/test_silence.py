"""A silent axis, source or sink raises one alarm until it is back, also over restarts."""

from __future__ import annotations

import json
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pmfid.cli.serve_lines import line
from pmfid.service.arrangement import arrange_groups
from pmfid.service.metrics import exposition
from pmfid.service.plant import SINKS, load_plant
from pmfid.service.run import Service
from pmfid.service.sinks.history import HistorySink
from pmfid.service.sinks.plain import NoticeLog
from pmfid.service.sinks.queued import Queued
from pmfid.service.web.board import Board
from pmfid.simulation import CART_DT
from pmfid.stream.checkpoint import read_snapshot, snapshot
from pmfid.stream.delivery import Block, Delivery
from pmfid.stream.engine import StreamEngine
from pmfid.stream.groups import Pace, Prepared
from pmfid.stream.outcome import Counters, Notice
from pmfid.stream.store import FILE
from pmfid.stream.tuning import TUNING
from studies.service.processes import service
from tests.patience import PATIENCE
from tests.service.broker import Broker, needs_broker, stopped_brokers  # noqa: F401 a fixture
from tests.service.feed import Faulty, Host, kindred, notice, queue_of, standard_input, until
from tests.service.feed import block as rows_of
from tests.service.test_alarm_in_time import EXAMPLES, plant_of
from tests.service.test_mqtt_sink import Link, sink_of
from tests.service.test_page_browser import at_overview
from tests.service.test_serve import Acting, Events, events, folder  # noqa: F401 a fixture
from tests.service.web_servers import web_server
from tests.tuned import set_tuning

LIMIT = 60.0


@dataclass
class Sink:
    """A sink whose state a test sets."""

    name: str = "db"
    state: bool | None = True

    def works(self, since: float) -> bool | None:
        return self.state


@dataclass
class Outlet:
    """An outlet that keeps the notices."""

    reported: list[Notice] = field(default_factory=list)

    def rows(self, rows: object) -> None: ...

    def notice(self, notice: Notice) -> None:
        self.reported.append(notice)


@dataclass
class Watched:
    """An engine whose time a test sets."""

    prepared: Prepared
    axes: Sequence[str] = ("x1", "x2", "x3")
    limit: float = LIMIT

    def __post_init__(self) -> None:
        self.outlet, self.sink, self.at, self.first = Outlet(), Sink(), 1000.0, dict.fromkeys(self.axes, 0)
        self.engine = self._engine()
        self.engine.set_groups(arrange_groups([], dict.fromkeys(self.axes, self.prepared), Pace(0.0, 1.0))[0])
        self.engine.silence.tick(self.at)

    def _engine(self) -> StreamEngine:
        engine = StreamEngine(Counters(), [self.outlet])
        engine.silence.limit, engine.silence.sources, engine.silence.sinks = self.limit, ("hall", "lab"), [self.sink]
        return engine

    def run(self, seconds: float, *axes: str, source: str = "hall", other: str = "lab") -> None:
        """Let these axes send through one source for some seconds, while the other source sends unknown names."""
        for _ in range(round(seconds)):
            self.at += 1.0
            self.engine.silence.tick(self.at)
            items = [self._block(name) for name in axes]
            if items:
                self.engine.process([Delivery(source, items)])
            if other:
                self.engine.process([Delivery(other, [])])
            self.engine.silence.look(self.engine.groups)

    def _block(self, axis: str) -> Block:
        first = self.first[axis]
        self.first[axis] += 5
        return Block(axis, 0, first, np.nan, CART_DT, np.zeros(5), np.arange(first, first + 5))

    def again(self) -> None:
        """Restart from a checkpoint of this moment."""
        found = read_snapshot(b"".join(snapshot(self.engine)))
        self.engine = self._engine()
        found.restore(self.engine)
        groups = [one.restore_group(self.prepared, Pace(0.0, 1.0)) for one in found.groups]
        self.engine.set_groups(arrange_groups(groups, dict.fromkeys(self.axes, self.prepared), Pace(0.0, 1.0))[0])

    def taken(self) -> list[tuple[str, str, str]]:
        """Return the new notices as (event, kind of the silent object, its name)."""
        reported, self.outlet.reported = self.outlet.reported, []
        kinds = ("alarm", "cleared")
        return [(n.what["event"], n.what["silent"], n.what["name"]) for n in reported if n.what["event"] in kinds]

    def level(self, name: str, **labels: str) -> float:
        return self.engine.counters.values()[name, tuple(labels.items())]


@pytest.fixture
def watched(prepared: Prepared) -> Watched:
    return Watched(prepared)


def test_an_axis_that_stops_is_an_alarm_once_until_it_sends(watched: Watched) -> None:
    watched.run(100, "x1", "x2", "x3")
    assert watched.taken() == []
    watched.run(LIMIT, "x1", "x3")
    assert watched.taken() == []
    watched.run(200, "x1", "x3")
    assert watched.taken() == [("alarm", "axis", "x2")]
    assert watched.level("pmfid_axes_silent", group="axis.toml") == 1
    watched.run(1, "x1", "x2", "x3")
    assert watched.taken() == [("cleared", "axis", "x2")]
    assert watched.level("pmfid_axes_silent", group="axis.toml") == 0
    watched.run(LIMIT + 1, "x1", "x3")
    assert watched.taken() == [("alarm", "axis", "x2")], "and once more in the next silence"


def test_an_axis_that_never_sends_is_silent_too(watched: Watched) -> None:
    watched.run(LIMIT + 2, "x1", "x3")
    assert watched.taken() == [("alarm", "axis", "x2")]


def test_an_axis_that_sends_what_cannot_be_used_is_silent(watched: Watched) -> None:
    watched.run(2, "x1", "x2", "x3")
    for _ in range(round(LIMIT) + 2):
        watched.first["x2"] = 0  # the same samples repeatedly
        watched.run(1, "x1", "x2", "x3")
    assert watched.taken() == [("alarm", "axis", "x2")]


def test_a_slow_axis_has_the_time_of_some_samples(watched: Watched) -> None:
    (group,) = watched.engine.groups
    group.dt = 30.0
    watched.engine.silence.sources = ("lab",)
    watched.run(149)
    assert [name for _, kind, name in watched.taken() if kind == "axis"] == []
    watched.run(3)
    assert [name for _, kind, name in watched.taken() if kind == "axis"] == ["x1", "x2", "x3"]


def test_a_source_that_hands_over_nothing_is_an_alarm_once(watched: Watched) -> None:
    watched.run(10, "x1", "x2", "x3")
    watched.run(LIMIT + 5, "x1", "x2", "x3", other="")
    assert watched.taken() == [("alarm", "source", "lab")]
    assert watched.level("pmfid_source_silent", source="lab") == 1
    assert watched.level("pmfid_source_silent", source="hall") == 0
    watched.run(1, "x1", "x2", "x3")
    assert watched.taken() == [("cleared", "source", "lab")]
    assert watched.level("pmfid_source_silent", source="lab") == 0


def test_a_sink_that_takes_nothing_is_an_alarm_once(watched: Watched) -> None:
    watched.run(10, *watched.axes)
    watched.sink.state = False
    watched.run(LIMIT + 100, *watched.axes)
    assert watched.taken() == [("alarm", "sink", "db")]
    assert watched.level("pmfid_sink_silent", sink="db") == 1
    watched.sink.state = True
    watched.run(2, *watched.axes)
    assert watched.taken() == [("cleared", "sink", "db")]


def test_a_restart_neither_repeats_nor_forgets_an_alarm(watched: Watched) -> None:
    watched.run(1, *watched.axes)
    watched.sink.state = False
    watched.run(LIMIT + 5, "x1", other="")
    first = watched.taken()
    assert sorted(first) == [
        ("alarm", "axis", "x2"),
        ("alarm", "axis", "x3"),
        ("alarm", "sink", "db"),
        ("alarm", "source", "lab"),
    ]
    watched.sink.state = None  # without an order to write yet
    watched.again()
    watched.run(2, "x1", other="")
    assert watched.taken() == []
    assert watched.level("pmfid_axes_silent", group="axis.toml") == 2
    assert watched.level("pmfid_source_silent", source="lab") == watched.level("pmfid_sink_silent", sink="db") == 1
    board = Board([], Counters())
    for one in watched.engine.notices.replay_alarms(watched.engine.notices.alarms.all()):
        board.notice(one)
    assert [alarm.cleared for alarm in board.news().alarms] == [None] * 4, "the page shows them as open"
    watched.run(3 * LIMIT, "x1", other="")
    assert watched.taken() == []
    watched.sink.state = True
    watched.run(2, *watched.axes)
    assert sorted(watched.taken()) == [("cleared", kind, name) for _, kind, name in sorted(first)]
    watched.again()
    watched.run(2, *watched.axes)
    assert watched.taken() == []
    assert all(alarm.cleared for alarm in watched.engine.notices.alarms.all())


def test_what_is_removed_has_no_alarm_any_more(watched: Watched) -> None:
    watched.run(LIMIT + 2, "x1", "x3")
    assert watched.taken() == [("alarm", "axis", "x2")]
    left = dict.fromkeys(("x1", "x3"), watched.prepared)
    watched.engine.set_groups(arrange_groups(watched.engine.groups, left, Pace(0.0, 1.0))[0])
    watched.run(1, "x1", "x3")
    assert watched.taken() == [("cleared", "axis", "x2")]


def test_a_process_that_stood_still_does_not_take_its_own_pause_for_silence(watched: Watched) -> None:
    watched.run(10, *watched.axes)
    watched.at += 3600
    watched.run(1)
    watched.run(1, *watched.axes)
    assert watched.taken() == []


def test_an_axis_that_restarts_stays_silent_until_it_sends(watched: Watched) -> None:
    watched.run(LIMIT + 2, "x1", "x3")
    seat = watched.engine.seat("x2")
    assert seat is not None
    seat.restart_numbers()
    watched.run(LIMIT + 2, "x1", "x3")
    assert watched.taken() == [("alarm", "axis", "x2")]


def test_many_axes_at_once_share_an_alarm(prepared: Prepared) -> None:
    axes = [f"c{k}" for k in range(TUNING.notices_most + 1)]
    watched = Watched(prepared, [*axes, "c"])
    watched.run(1, *axes, "c")
    watched.run(LIMIT + 5, "c")
    assert watched.taken() == [("alarm", "axes", f"{len(axes)} axes")]
    watched.run(2, *axes[1:], "c")
    assert watched.taken() == [], "one is silent still"
    watched.run(1, axes[0], "c")
    assert watched.taken() == [("cleared", "axes", f"{len(axes)} axes")]


def test_a_silent_source_is_one_alarm_that_names_its_axes(watched: Watched) -> None:
    watched.run(2, "x1", "x2")
    watched.run(2, "x1")
    watched.run(1, "x3", source="lab", other="hall")
    watched.run(LIMIT - 3, "x3", source="lab", other="")
    watched.run(20, "x3", source="lab", other="")
    (alarm,) = [notice.what for notice in watched.outlet.reported if notice.what["event"] == "alarm"]
    assert (alarm["silent"], alarm["name"], alarm["axes"]) == ("source", "hall", ["x1", "x2"])
    assert "hall delivered nothing for 60 s, so 2 axes have no data (x1, x2); check" in alarm["problem"]
    assert watched.level("pmfid_axes_silent", group="axis.toml") == 2
    watched.taken()
    watched.again()
    watched.run(3 * LIMIT, "x3", source="lab", other="")
    assert watched.taken() == [], "a restart changes nothing"
    watched.run(LIMIT + 3, "x1", other="lab")
    assert watched.taken() == [("cleared", "source", "hall"), ("alarm", "axis", "x3"), ("alarm", "axis", "x2")]


def test_axes_without_any_data_are_those_of_a_source_that_never_delivered(watched: Watched) -> None:
    watched.run(LIMIT + 3, other="lab")
    assert watched.taken() == [("alarm", "source", "hall")]


def test_nothing_is_silent_with_a_limit_of_0(prepared: Prepared) -> None:
    watched = Watched(prepared, limit=0.0)
    watched.run(5000)
    assert watched.taken() == []


def test_an_acknowledged_silence_is_no_other_alarm(watched: Watched) -> None:
    watched.run(LIMIT + 2, "x1", "x3")
    (alarm,) = [one for one in watched.outlet.reported if one.what["event"] == "alarm"]
    watched.engine.acknowledge(alarm.number, "night")
    watched.engine.tick(0.0)
    (known,) = [one for one in watched.outlet.reported if one.what["event"] == "acknowledged"]
    link = Link()
    sink = sink_of(link)
    sink.put([notice(1, "alarm", axis="x2"), alarm, known])
    assert link.retained()["pmfid/hall-3/alarms/x2"] != b""
    assert link.retained()["pmfid/hall-3/alarms/x2/silent"] == b""


# --- outlets of the alarms --------------------------------------------------------------------------------------------


@pytest.fixture
def reported(watched: Watched) -> list[Notice]:
    """Return the alarms of an axis, a source and a sink, and the ends of these alarms."""
    watched.run(1, *watched.axes)
    watched.sink.state = False
    watched.run(LIMIT + 2, "x1", "x3", other="")
    watched.sink.state = True
    watched.run(2, *watched.axes)
    return [one for one in watched.outlet.reported if "silent" in one.what]


def test_the_broker_retains_it_until_it_is_over(reported: list[Notice]) -> None:
    link = Link()
    sink = sink_of(link, clear="never", events=False)
    sink.put(reported[:3])
    topics = [f"pmfid/hall-3/alarms/{one}/silent" for one in ("x2", "_sink/db", "_source/lab")]
    assert [bool(link.retained()[topic]) for topic in topics] == [True] * 3
    sink.put(reported[3:])
    assert [link.retained()[topic] for topic in topics] == [b""] * 3


def test_by_default_the_webhook_posts_both(reported: list[Notice], tmp_path: Path) -> None:
    with web_server() as server:
        section = SINKS["webhook"].model_validate({"kind": "webhook", "url": server.url})
        outlet = queue_of(section, "w", Host(tmp_path))
        outlet.start()
        for one in reported:
            outlet.notice(one)
        assert outlet.close(PATIENCE)
    events = [json.loads(body)["event"] for _, _, body in server.got]
    assert events == ["alarm"] * 3 + ["cleared"] * 3


def test_the_database_has_both(reported: list[Notice], tmp_path: Path) -> None:
    outlet = Queued(HistorySink(tmp_path / FILE), Counters(), [].append)
    outlet.start()
    for one in reported:
        outlet.notice(one)
    assert outlet.close(PATIENCE)
    assert events_in(tmp_path / FILE) == ["alarm"] * 3 + ["cleared"] * 3


def events_in(file: Path) -> list[str]:
    """Return the events of a database's notices."""
    with closing(sqlite3.connect(file)) as database:
        rows = database.execute("SELECT event FROM notices WHERE event IN ('alarm', 'cleared') ORDER BY id")
        return [event for (event,) in rows]


def test_the_log_says_it_for_people(reported: list[Notice]) -> None:
    lines = sorted(line(one) for one in reported)
    assert lines[0].startswith("ALARM  the sink db accepted nothing for 60 s; check")
    assert lines[1].startswith("ALARM  the source lab delivered nothing for 60 s; check")
    assert lines[2].startswith("the alarm of sink db is over after 6")
    assert lines[3].startswith("the alarm of source lab is over after 6")
    assert lines[4].startswith("x2  ALARM  no usable sample for 60 s; check")
    assert lines[5].startswith("x2  the alarm is over after 6")


def test_the_metrics_have_it_in_words(watched: Watched) -> None:
    watched.run(LIMIT + 5, other="")
    text = exposition(watched.engine.counters)
    assert 'pmfid_axes_silent{group="axis.toml"} 3.0\n' in text
    assert 'pmfid_source_silent{source="hall"} 1.0\n' in text
    assert 'pmfid_sink_silent{sink="db"} 0.0\n' in text


# --- a sink after its queue ------------------------------------------------------------------------------------------


def test_a_queue_knows_whether_its_sink_takes_what_it_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    set_tuning(monkeypatch, "pmfid.service.sinks.queued", queued_first_pause=0.01)
    sink, begun = Faulty(), time.monotonic()
    outlet = Queued(sink, Counters(), lambda reported: None)
    outlet.start()
    assert outlet.works(begun) is None, "nothing was given to it yet"
    sink.error = OSError("full")
    outlet.rows(rows_of(kindred()))
    assert until(lambda: outlet.works(time.monotonic()) is False)
    assert outlet.works(begun) is None, "it began after that"
    sink.error = None
    assert until(lambda: outlet.works(time.monotonic()) is True)
    outlet.close(PATIENCE)


def test_a_sink_that_hangs_does_not_work() -> None:
    sink = Faulty(hold=threading.Event())
    outlet = Queued(sink, Counters(), lambda reported: None)
    outlet.start()
    outlet.rows(rows_of(kindred()))
    assert until(lambda: outlet.works(time.monotonic()) is False)
    assert sink.hold is not None
    sink.hold.set()
    assert until(lambda: outlet.works(time.monotonic()) is True)
    outlet.close(PATIENCE)


def test_a_sink_that_refuses_all_it_is_given_does_not_work() -> None:
    sink = Faulty(error=ValueError("no"))
    outlet = Queued(sink, Counters(), lambda reported: None)
    outlet.start()
    outlet.rows(rows_of(kindred()))
    assert until(lambda: outlet.works(time.monotonic()) is False)
    time.sleep(0.05)
    assert outlet.works(time.monotonic()) is False
    outlet.close(PATIENCE)


# --- the whole service ------------------------------------------------------------------------------------------------

PLANT = """
[service]
silence = 1.0
window = 0.0
state = "kept"
[page]
enabled = false
[axes.x1]
config = "axis.toml"
[sources.log]
kind = "stdin"
axis = "x1"
[sinks.hook]
kind = "webhook"
url = "{url}"
events = ["alarm", "cleared"]
"""


def acting(place: Path) -> Acting:
    text = StringIO()
    return Acting(Service(lambda: load_plant(place / "plant.toml"), NoticeLog(text)), text)


def reported_in_order(one: Acting) -> list[tuple[str, str]]:
    """Return (silent object, event) of each notice."""
    return [(reported["silent"], reported["event"]) for reported in events(one.text.getvalue(), "alarm", "cleared")]


def test_a_service_tells_silence_once_over_a_restart_and_its_end(folder: Path) -> None:  # noqa: F811
    rows = (folder / "run.csv").read_text().splitlines(keepends=True)
    silent = {"sink": "alarm", "source": "alarm"}
    with web_server(500) as server:
        (folder / "plant.toml").write_text(PLANT.replace("{url}", server.url))
        first = acting(folder)
        with standard_input() as send:
            first.run(
                lambda: send("".join(rows[:200])), lambda: until(lambda: dict(reported_in_order(first)) == silent)
            )
        assert dict(reported_in_order(first)) == silent, "the alarm of the source stands for its axis"
        second = acting(folder)

        def back() -> None:
            shown = ("pmfid_sink_silent", (("sink", "hook"),))
            assert until(lambda: second.service.counters.values().get(shown) == 1)
            time.sleep(2.0)
            assert reported_in_order(second) == []
            server.answers[:] = [200]
            server.got.clear()
            send("".join([rows[0], *rows[200:400]]))

        with standard_input() as send:
            second.run(back, lambda: second.until("cleared", times=2))
    assert dict(reversed(reported_in_order(second))) == dict.fromkeys(("sink", "source"), "cleared")
    posted = [json.loads(body) for _, _, body in server.got]
    of_sink = [one["event"] for one in posted if one.get("silent") == "sink"]
    assert list(dict.fromkeys(of_sink)) == ["alarm", "cleared"], "once it works, it has it, too"
    kept = events_in(folder / "kept" / FILE)
    assert sorted(kept) == sorted(event for one in (first, second) for _, event in reported_in_order(one))


@pytest.mark.long
@needs_broker
@pytest.mark.usefixtures("stopped_brokers")
def test_the_plant_of_the_examples_is_silent_killed_and_back(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "broker").mkdir()
    broker = Broker(tmp_path / "broker").start()
    plant = plant_of(tmp_path, broker)
    with web_server() as server:
        more = f'[sinks.hook]\nkind = "webhook"\nurl = "{server.url}"\n'
        text = plant.read_text().replace("[service]\n", "[service]\nsilence = 10.0\n")
        plant.write_text(f"{text}\n{more}")
        with service(plant, tmp_path / "first.jsonl") as served:
            stopped = sent(broker, 15.0)
            assert until(lambda: len(server.got) == 1)
            time.sleep(5.0)
            assert served.total("pmfid_source_silent") == 1
            served.process.kill()
        alarms = events((tmp_path / "first.jsonl").read_text(), "alarm")
        with service(plant, tmp_path / "second.jsonl") as served:
            time.sleep(15.0)
            assert served.total("pmfid_source_silent") == 1
            assert len(server.got) == 1, "nothing is reported twice"
            sent(broker, 12.0)
            assert until(lambda: len(server.got) == 2)
            assert served.total("pmfid_axes_silent") == served.total("pmfid_source_silent") == 0
        posted = [json.loads(body)["event"] for _, _, body in server.got]
    by_sink = {
        "webhook": posted,
        "sqlite": events_in(next((tmp_path / "state").rglob("*.sqlite"))),
        "log": [e["event"] for name in ("first", "second") for e in both(tmp_path / f"{name}.jsonl")],
    }
    with capsys.disabled():
        late = [alarm["wall"] - stopped for alarm in alarms]
        counts = {
            name: f"{found.count('alarm')} alarms, {found.count('cleared')} over" for name, found in by_sink.items()
        }
        print(f"\n12 axes and their source silent: alarms {min(late):.1f} to {max(late):.1f} s after the last block")
        print(counts)
    assert {name: sorted(found) for name, found in by_sink.items()} == {name: ["alarm", "cleared"] for name in by_sink}


def sent(broker: Broker, seconds: float) -> float:
    """Let the twelve carts send for some seconds; return the time of their end."""
    words = [EXAMPLES / "plant_machines.py", "--port", broker.port, "--seconds", seconds, "--step", 1000]
    subprocess.run([sys.executable, *map(str, words)], check=True, capture_output=True)
    return time.time()


def both(log: Path) -> Events:
    return events(log.read_text(), "alarm", "cleared")


# --- the page ---------------------------------------------------------------------------------------------------------


def test_when_all_axes_are_silent_the_tiles_say_so_whatever_other_alarms_there_are() -> None:
    from tests.service.chromium import chromium, tab, violations
    from tests.service.chromium import until as shows
    from tests.service.fake_engine import FakePlant
    from tests.service.loopback import served

    plant = FakePlant(8)
    plant.run(5.0, time.monotonic() - 3600)
    for name in ("gantry-x1", "gantry-x2", "spindle-a"):
        plant.alarm(name)
    silent: dict[str, Any] = {"event": "alarm", "silent": "axis", "seconds": 60.0, "problem": "no usable sample"}
    number = plant.tell("gantry-y", **silent, name="gantry-y")
    plant.tell("", **{**silent, "silent": "source", "problem": "nothing came from the source hall"}, name="hall")
    with chromium() as browser, served(plant) as there, tab(browser) as page:
        at_overview(page, there)
        assert shows(page, "document.querySelector('.tile[data-kind=silent] .count').textContent === '8'")
        assert page.inner_text(".overview > .problem") == "No axis sends data"
        assert page.inner_text(".tile[data-kind=alarm] .count") == "3"
        page.click(".tile[data-kind=silent]")
        assert shows(page, "document.querySelectorAll('.rows .axis-name').length === 8")
        said = page.inner_text(".cards")
        assert "nothing came from the source hall" in said
        assert "statistic –" not in said
        assert page.inner_text("#alarmed").split()[0] == "5"
        plant.tell("gantry-y", event="cleared", alarm=number, silent="axis", name="gantry-y", seconds=3600.0)
        plant.run(1.0)
        assert shows(page, "document.querySelector('.tile[data-kind=silent] .count').textContent === '0'")
        assert shows(page, "document.querySelector('#alarmed').textContent.startsWith('4')")
        assert shows(page, "document.querySelector('.overview > .problem').hidden")
        assert violations(page) == []

"""A silent axis, source or sink raises one alarm until it is back, also over restarts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pytest

from pmfid.service.arrangement import arrange_groups
from pmfid.service.web.board import Board
from pmfid.simulation import CART_DT
from pmfid.stream.checkpoint import draft, read_snapshot
from pmfid.stream.delivery import Block, Delivery
from pmfid.stream.engine import StreamEngine
from pmfid.stream.groups import Pace, Prepared
from pmfid.stream.outcome import Counters, Notice
from tests.service.broker import Broker, needs_broker, stopped_brokers  # noqa: F401 a fixture
from tests.service.test_serve import Acting, Events, events, folder  # noqa: F401 a fixture

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
    seen: int = 0

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
        found = read_snapshot(b"".join(draft(self.engine).chunks()), self.published)
        self.engine = self._engine()
        found.restore(self.engine)
        groups = [one.restore_group(self.prepared, Pace(0.0, 1.0)) for one in found.groups]
        self.engine.set_groups(arrange_groups(groups, dict.fromkeys(self.axes, self.prepared), Pace(0.0, 1.0))[0])

    def taken(self) -> list[tuple[str, str, str]]:
        """Return the new notices as (event, kind of the silent object, its name)."""
        fresh, self.seen = self.published[self.seen :], len(self.published)
        return [(n.what["event"], n.what["silent"], n.what["name"]) for n in fresh]

    @property
    def published(self) -> list[Notice]:
        """The notices of alarms so far."""
        return [notice for notice in self.outlet.reported if notice.urgent]

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


def test_a_source_that_hands_over_nothing_is_an_alarm_once(watched: Watched) -> None:
    watched.run(10, "x1", "x2", "x3")
    watched.run(LIMIT + 5, "x1", "x2", "x3", other="")
    assert watched.taken() == [("alarm", "source", "lab")]
    assert watched.level("pmfid_source_silent", source="lab") == 1
    assert watched.level("pmfid_source_silent", source="hall") == 0
    watched.run(1, "x1", "x2", "x3")
    assert watched.taken() == [("cleared", "source", "lab")]
    assert watched.level("pmfid_source_silent", source="lab") == 0


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
    board = Board([])
    for one in watched.published:
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


def test_a_process_that_stood_still_does_not_take_its_own_pause_for_silence(watched: Watched) -> None:
    watched.run(10, *watched.axes)
    watched.at += 3600
    watched.run(1)
    watched.run(1, *watched.axes)
    assert watched.taken() == []


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

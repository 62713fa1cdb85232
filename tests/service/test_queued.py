"""The queue of every sink: bounded, never blocking, dropping the oldest rows first and alarms last."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pmfid.service.sinks import queued
from pmfid.service.sinks.queued import OutcomeQueue, Queued, QueueLimits, size_of
from pmfid.stream.outcome import EstimateRows, Notice
from tests.patience import PATIENCE
from tests.service.feed import Faulty, Host, alarm, block, kindred, notice, numbers, until
from tests.tuned import set_tuning

GROUP = kindred(10)


@pytest.fixture
def host(tmp_path: Path) -> Host:
    return Host(tmp_path)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shorten the pauses, so that a test can wait for them."""
    set_tuning(monkeypatch, queued, first_pause=0.005)
    set_tuning(monkeypatch, queued, longest_pause=0.02)


def started(sink: Faulty, host: Host, limits: QueueLimits | None = None) -> Queued:
    outlet = Queued(sink, host.counters, host.tell, limits)
    outlet.start()
    return outlet


# --- the content of the queue -----------------------------------------------------------------------------------------


@given(
    st.lists(st.sampled_from(["rows", "rows", "alarm", "gap", "take", "give back"]), max_size=60),
    st.integers(1, 6),
    st.integers(1, 5),
)
def test_what_waits_is_bounded_in_order_and_all_accounted_for(steps: list[str], rows: int, notices: int) -> None:
    size = size_of(block(GROUP))
    waiting = OutcomeQueue(QueueLimits(rows * size, notices))
    offered_rows = offered_notices = lost_rows = lost_notices = 0
    got: list[EstimateRows | Notice] = []
    taken: list[EstimateRows | Notice] = []
    for number, step in enumerate(steps, 1):
        if step == "take":
            taken = waiting.take(3)
            got += taken
            continue
        if step == "give back":
            lost = waiting.give_back(taken)
            got = got[: len(got) - len(taken)]
            taken = []
        else:
            is_rows = step == "rows"
            offered_rows += 10 * is_rows
            offered_notices += not is_rows
            one = block(GROUP, number) if is_rows else alarm(number) if step == "alarm" else notice(number, "gap")
            lost = waiting.add(one)
        lost_rows += lost["rows"]
        lost_notices += lost["notices"]
        assert waiting.size <= rows * size
        assert len(waiting.notices) <= notices
    got += waiting.take(1000)
    for kind in (EstimateRows, Notice):
        of_kind = numbers([one for one in got if isinstance(one, kind)])
        assert of_kind == sorted(of_kind)
    assert waiting.size == waiting.waiting_rows == len(waiting.notices) == 0
    assert len(got) == (offered_rows - lost_rows) // 10 + offered_notices - lost_notices


def test_the_oldest_rows_go_first_and_alarms_stay() -> None:
    waiting = OutcomeQueue(QueueLimits(3 * size_of(block(GROUP)), notices=3))
    for number in range(1, 11):
        waiting.add(block(GROUP, number))
        waiting.add(alarm(100 + number) if number in (1, 9) else notice(200 + number, "gap"))
    assert numbers(waiting.take(100)) == [101, 109, 210, 8, 9, 10]


# --- the engine's side ------------------------------------------------------------------------------------------------


def test_a_sink_that_hangs_does_not_hold_the_engine(host: Host) -> None:
    sink = Faulty(hold=threading.Event())
    outlet = started(sink, host, QueueLimits(100 * size_of(block(GROUP))))
    outlet.rows(block(GROUP, 1))
    assert until(lambda: sink.puts)
    offered, rows = 3000, block(GROUP, 2)
    for _ in range(offered):
        outlet.rows(rows)
    assert sink.puts == 1, "it has been hanging all the time"
    assert host.count("pmfid_dropped_rows_total", sink="s") == 10 * offered - 1000
    sink.hold.set()
    assert outlet.close(PATIENCE)
    assert sum(one.axis.size for one in sink.got) == 1010
    assert host.count("pmfid_sink_rows_total", sink="s") == 1010


# --- errors -----------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("quick")
def test_an_error_is_reported_once_and_the_end_of_it_too(host: Host) -> None:
    sink = Faulty(error=OSError(28, "No space left on device", "out.jsonl"))
    outlet = started(sink, host, QueueLimits(5 * size_of(block(GROUP))))
    for number in range(1, 11):
        outlet.rows(block(GROUP, number))
        outlet.notice(alarm(100 + number))
    assert until(lambda: host.count("pmfid_sink_errors_total", sink="s") >= 4)
    assert host.count("pmfid_sink_working", sink="s") == 0
    sink.error = None
    assert until(lambda: len(host.reported) == 2)
    assert outlet.close(PATIENCE)
    assert host.reported[0] == {
        "event": "sink",
        "sink": "s",
        "works": False,
        "problem": "No space left on device: out.jsonl",
    }
    assert host.reported[1] == {"event": "sink", "sink": "s", "works": True, "lost_rows": 50, "lost_notices": 0}
    assert host.count("pmfid_sink_working", sink="s") == 1
    assert sink.opened >= 5, "it is opened again before each attempt"
    assert [n for n in numbers(sink.got) if n > 100] == list(range(101, 111)), "no alarm is lost"
    assert [n for n in numbers(sink.got) if n < 100] == [6, 7, 8, 9, 10]


def test_what_a_sink_can_never_take_is_dropped_alone(host: Host) -> None:
    sink = Faulty(hold=threading.Event(), poison=4)
    outlet = started(sink, host)
    for number in range(1, 9):
        outlet.notice(alarm(number))
    sink.hold.set()
    assert outlet.close(PATIENCE)
    assert numbers(sink.got) == [1, 2, 3, 5, 6, 7, 8]
    assert host.count("pmfid_refused_total", sink="s") == 1
    assert [reported["problem"] for reported in host.reported] == ["refused: ValueError: number 4 is poison"]
    assert host.count("pmfid_sink_errors_total", sink="s") == 0


# --- the end ----------------------------------------------------------------------------------------------------------


def test_closing_ends_in_time_also_where_the_sink_hangs(host: Host) -> None:
    sink = Faulty(hold=threading.Event())
    outlet = started(sink, host, QueueLimits(take=1))
    outlet.rows(block(GROUP, 1))
    assert until(lambda: sink.puts)
    for number in range(2, 5):
        outlet.rows(block(GROUP, number))
    assert not outlet.close(0.05)
    assert host.count("pmfid_dropped_rows_total", sink="s") == 30
    sink.hold.set()
    assert until(lambda: sink.closed), "and it is closed as soon as it answers"


def test_what_is_kept_for_a_sink_is_what_it_may_still_get(host: Host) -> None:
    sink = Faulty(error=OSError(28, "No space left on device"))
    outlet = started(sink, host, QueueLimits(notices=5))
    for number in range(1, 21):
        outlet.notice(alarm(number))
    assert until(lambda: host.reported)
    assert outlet.close(PATIENCE)
    assert sorted(one.number for one in outlet.unwritten()) == [16, 17, 18, 19, 20], "also after its end"
    assert host.count("pmfid_dropped_notices_total", sink="s") == 20
    written = started(Faulty(), host)
    written.notice(alarm(1))
    assert written.close(PATIENCE)
    assert written.unwritten() == []

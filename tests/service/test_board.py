"""The board gives its readers the rows and notices of the engine."""

from __future__ import annotations

from dataclasses import replace
from threading import Thread

import numpy as np
import pytest

from pmfid.service.tuning import TUNING
from pmfid.service.web.api import Feed
from pmfid.service.web.board import Board, Panel, Records, row_bytes
from pmfid.stream.outcome import Counters, EstimateRows, Kindred, Notice
from tests.service.fake_engine import FakePlant


def kindred(*axes: str, names: tuple[str, ...] = ("mass", "friction")) -> Kindred:
    return Kindred("cart.toml", names, ("kg", "N"), 0.01, np.array([2.0, 5.0]), axes)


def rows_of(
    group: Kindred, axis: list[int], number: list[int], *, time: list[float] | None = None, received: float = 100.0
) -> EstimateRows:
    """Return rows whose mass is 2 + number / 100."""
    m = len(axis)
    theta = np.column_stack([2 + np.array(number) / 100, np.full(m, 5.0)])
    return EstimateRows(
        group, np.array(axis), np.array(number), np.array(time or number, float), np.arange(m, dtype=float),
        np.arange(m), theta, np.full((m, 2), 0.1), np.zeros(m), np.arange(m, dtype=np.uint32),
        np.ones(m, np.uint8), received,
    )  # fmt: skip


def board_of(*groups: Kindred, **options: float) -> Board:
    return Board(groups, Counters(), **options)


def test_the_last_row_of_each_axis_counts() -> None:
    group = kindred("a", "b", "c")
    board = board_of(group)
    board.rows(rows_of(group, [2, 0, 2, 0], [1, 1, 2, 2]))
    (found,) = board.news().groups
    assert found.axis.tolist() == [0, 2]
    assert found.value.tolist() == [2.02, 2.02]
    assert found.status.tolist() == [3, 2]
    assert found.deviation.tolist() == pytest.approx([0.01, 0.01])


def test_news_tell_each_change_once() -> None:
    group = kindred("a", "b")
    board = board_of(group)
    board.rows(rows_of(group, [0, 1], [1, 1]))
    first = board.news()
    board.rows(rows_of(group, [1], [2]))
    second = board.news(first.version)
    assert second.groups[0].axis.tolist() == [1]
    assert board.news(second.version).groups[0].axis.size == 0


def test_history_keeps_a_row_in_every_seconds_and_forgets_the_oldest() -> None:
    group = kindred("a", "b")
    board = board_of(group, budget=2 * 32 * row_bytes(group), every=1.0)
    for k in range(200):
        board.rows(rows_of(group, [0], [k], time=[0.25 * k]))
    history = board.history("a")
    assert history is not None
    assert history["time"].tolist() == [float(k) for k in range(18, 50)]
    assert board.history("b").size == 0  # type: ignore[union-attr]
    assert board.history("nobody") is None


def test_a_clock_that_was_set_back_does_not_end_the_history() -> None:
    group = kindred("a")
    board = board_of(group)
    for time in (100.0, 101.0, 5.0, 5.5, 6.0):
        board.rows(rows_of(group, [0], [1], time=[time]))
    assert board.history("a")["time"].tolist() == [100.0, 101.0, 5.0, 6.0]  # type: ignore[index]


def test_memory_is_what_the_budget_says() -> None:
    group = kindred(*(f"cell-{i}" for i in range(1000)))
    small, large = Panel(group, 50), Panel(group, 10**9)
    assert small.depth == 50
    assert large.depth == TUNING.panel_most
    kept = board_of(group, budget=8e6)._panels[0]._kept
    assert 7e6 < kept.nbytes <= 8e6


def test_what_is_kept_can_be_changed_before_the_start() -> None:
    group = kindred("a")
    board = board_of(group)
    board.rows(rows_of(group, [0], [1]))
    board.keep(50 * row_bytes(group))
    assert board._panels[0].depth == 50
    assert board.history("a").size == 1  # type: ignore[union-attr]


def test_a_trend_grows_to_a_day_and_then_moves_on() -> None:
    group = kindred("a", "b")
    board = board_of(group)
    interval, _ = board.trends(0, np.array([0]))
    moment, spans = 0.0, []
    for _ in range(400):
        moment += 600.0
        board.rows(rows_of(group, [0], [1], received=moment))
        interval, trend = board.trends(0, np.array([0, 1]))
        spans.append(interval * trend.shape[1])
    assert interval == TUNING.panel_coarsest
    assert 0.4 * TUNING.panel_points * TUNING.panel_coarsest < max(spans) <= TUNING.panel_points * TUNING.panel_coarsest
    assert np.isnan(trend[1]).all()
    assert np.isfinite(trend[0, -1])


def test_a_trend_of_rows_in_a_steady_rhythm_has_no_holes() -> None:
    group = kindred("a")
    board = board_of(group, every=1.0)
    for k in range(500):
        board.rows(rows_of(group, [0], [k], received=50 + 1.03 * k))
    assert np.isfinite(board.trends(0, np.array([0]))[1]).all()


def test_a_long_silence_costs_no_time() -> None:
    group = kindred("a")
    board = board_of(group)
    board.rows(rows_of(group, [0], [1], received=1.0))
    board.rows(rows_of(group, [0], [1], received=1e9))  # steps of 2 s up to this time would take minutes
    assert np.isfinite(board.trends(0, np.array([0]))[1][0, -1])


def test_nothing_is_known_without_a_standard_deviation() -> None:
    group = kindred("a")
    board = board_of(group)
    board.rows(replace(rows_of(group, [0], [1]), std=np.full((1, 2), np.inf)))
    assert np.isnan(board.news().groups[0].deviation[0])


def alarm(number: int, axis: str = "a") -> Notice:
    return Notice(axis, number, 1e9 + number, {"event": "alarm", "parameter": "mass", "change": 0.1})


def test_an_alarm_is_reported_once_acknowledged_and_settled() -> None:
    board = board_of(kindred("a", "b"))
    board.notice(alarm(7))
    seen = board.news().version
    board.notice(alarm(7))  # the same notice as after a restart
    board.notice(Notice("a", 8, 5.0, {"event": "settled", "time": 3.0, "parameters": {"mass": {"value": 2.1}}}))
    board.notice(Notice("a", 9, 6.0, {"event": "acknowledged", "alarm": 7, "note": "seal changed"}))
    (found,) = board.news().alarms
    assert (found.number, found.note, found.acknowledged) == (7, "seal changed", 6.0)
    assert found.settled == {"time": 3.0, "parameters": {"mass": {"value": 2.1}}}
    assert [alarm.number for alarm in board.news(seen).alarms] == [7]


def test_a_change_that_goes_on_settles_its_alarm_again() -> None:
    board = board_of(kindred("a"))
    board.notice(alarm(1))
    for number, rate in ((2, None), (3, 0.5), (4, None)):
        rates = {} if rate is None else {"rate": rate}
        board.notice(Notice("a", number, 9.0, {"event": "settled", "time": float(number), "parameters": {}, **rates}))
    assert board.news().alarms[0].settled == {"time": 3.0, "parameters": {}, "rate": 0.5}


def test_of_too_many_alarms_the_known_ones_go_first() -> None:
    board = board_of(kindred("a"))
    for number in range(1, 2001):
        board.notice(alarm(number))
    board.notice(Notice("a", 5000, 6.0, {"event": "acknowledged", "alarm": 1500, "note": ""}))
    board.notice(alarm(6000))
    assert board.alarm(1500) is None
    assert board.alarm(1) is not None
    board.notice(alarm(6001))
    assert board.alarm(1) is None
    assert len(board.news().alarms) == 2000


def test_acknowledging_what_is_no_alarm_changes_nothing() -> None:
    board = board_of(kindred("a"))
    board.notice(Notice("a", 1, 6.0, {"event": "acknowledged", "alarm": None, "problem": "there is no alarm 12"}))
    assert board.news().alarms == []


def test_who_follows_gets_every_row_of_one_axis_bit_by_bit() -> None:
    group, taken = kindred("a", "b"), list[Records]()
    counters = Counters()
    board = Board([group], counters)
    board.follow("b", lambda rows: taken.append(rows) or 7)  # type: ignore[func-returns-value]
    assert board.list_followed() == {"b"}
    rows = rows_of(group, [0, 1, 1, 1], [1, 1, 2, 3])
    board.rows(rows)
    board.rows(rows_of(group, [0], [2]))
    assert [one["theta"].tobytes() for one in taken] == [rows.theta[1:].tobytes()]
    assert taken[0]["number"].tolist() == [1, 2, 3]
    assert counters.values()["pmfid_page_rows_dropped_total", ()] == 7
    board.leave("b")
    board.leave("b")
    board.rows(rows)
    assert len(taken) == 1
    assert board.list_followed() == frozenset()


def test_new_groups_keep_what_is_known_of_axes_that_stay() -> None:
    before = kindred("a", "b")
    board = board_of(before)
    board.rows(rows_of(before, [0, 1], [3, 4]))
    after = kindred("b", "c")
    other = Kindred("disc.toml", ("inertia", "drag"), ("kg m2", ""), 0.01, np.array([1.0, 1.0]), ("a",))
    layout = board.layout
    board.arrange([after, other])
    assert board.layout > layout
    assert board.history("b")["number"].tolist() == [4]  # type: ignore[index]
    assert board.history("c").size == 0  # type: ignore[union-attr]
    assert board.history("a").size == 0, "its parameters are others now"  # type: ignore[union-attr]
    assert [group.axis.tolist() for group in board.news().groups] == [[0], []]
    assert board.trends(0, np.array([0, 1]))[1][:, -1].tolist() == pytest.approx([0.02, np.nan], nan_ok=True)


def test_rows_of_a_group_that_nobody_announced_find_a_place() -> None:
    board = board_of(kindred("a", "b"), kindred("z"))
    changed = kindred("b", "a")
    board.rows(rows_of(changed, [0], [5]))
    assert [group.axes for group in board.groups] == [("z",), ("b", "a")]
    assert board.history("b")["number"].tolist() == [5]  # type: ignore[index]


def test_set_as_reference_makes_what_is_normal_for_one_axis() -> None:
    group = kindred("a", "b")
    board = board_of(group)
    board.rows(rows_of(group, [0, 1], [50, 50]))
    layout = board.layout
    board.notice(Notice("a", 1, 0.0, {"event": "reference", "problem": "nothing is known yet"}))
    assert board.layout == layout
    board.notice(Notice("a", 2, 0.0, {"event": "reference", "nominal": {"mass": 2.5, "friction": 5.0}}))
    assert board.layout > layout, "pages read the plant again"
    assert board.list_referred() == [{0: [2.5, 5.0]}]
    assert board.news().groups[0].deviation.tolist() == pytest.approx([0.0, 0.25])
    board.arrange([kindred("b", "a")])
    assert board.list_referred() == [{1: [2.5, 5.0]}]
    board.arrange([kindred("b", "a")], {"b": (3.0, 6.0)})
    assert board.list_referred() == [{0: [3.0, 6.0]}], "what the engine says of all of them"


def test_an_engine_and_readers_in_other_threads_do_not_disturb_each_other() -> None:
    plant = FakePlant(12)
    board, problems = plant.board, []

    def look() -> None:
        version = 0
        for _ in range(200):
            try:
                news = board.news(version)
                version = news.version
                feed = Feed()
                board.follow("gantry-y", feed.put)
                board.history("gantry-y")
                feed.take()
                board.leave("gantry-y")
            except Exception as error:
                problems.append(error)

    readers = [Thread(target=look) for _ in range(3)]
    for reader in readers:
        reader.start()
    while any(reader.is_alive() for reader in readers):
        plant.run(1.0)
    assert problems == []
    assert board.list_followed() == frozenset()

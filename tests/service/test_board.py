"""The board gives its readers the rows and notices of the engine."""

from __future__ import annotations

import numpy as np

from pmfid.service.web.board import Board, row_type
from pmfid.stream.outcome import EstimateRows, Kindred, Notice


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
    return Board(groups, **options)


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
    board = board_of(group, budget=2 * 32 * row_type(len(group.names)).itemsize, every=1.0)
    for k in range(200):
        board.rows(rows_of(group, [0], [k], time=[0.25 * k]))
    kept, nothing = board.follow("a", -1), board.follow("b", -1)
    assert kept is not None
    assert nothing is not None
    assert kept[0]["time"].tolist() == [float(k) for k in range(18, 50)]
    assert nothing[0].size == 0
    assert board.follow("nobody", -1) is None


def alarm(number: int, axis: str = "a") -> Notice:
    return Notice(axis, number, 1e9 + number, {"event": "alarm", "parameter": "mass", "change": 0.1})


def test_an_alarm_is_reported_once_acknowledged_and_settled() -> None:
    board = board_of(kindred("a", "b"))
    board.notice(alarm(7))
    seen = board.news().version
    board.notice(alarm(7))  # the same notice as after a restart
    values = {"time": 3.0, "parameters": {"mass": {"value": 2.1}}, "changes": [{"parameter": "mass", "relative": 0.1}]}
    board.notice(Notice("a", 8, 5.0, {"event": "settled", **values}))
    board.notice(Notice("a", 9, 6.0, {"event": "acknowledged", "alarm": 7, "note": "seal changed"}))
    (found,) = board.news().alarms
    assert (found.number, found.note, found.acknowledged) == (7, "seal changed", 6.0)
    assert found.settled == values
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

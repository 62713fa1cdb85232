"""The choice of samples for a segment: rests do not count, and a few moves may follow one another."""

from __future__ import annotations

import numpy as np
import pytest

from pmfid.estimators.results import Tracks
from pmfid.fleet.segments import Share, lasting_status, settled_std, shares_of
from pmfid.fleet.tuning import TUNING
from pmfid.status import Status
from pmfid.types import Counts

SETTLED, QUARTER, SPAN = 20, 250, 20_000


def moves(rests: list[int], length: int = 100) -> Counts:
    """Return counts of moves in alternating directions, each after its rest [samples]."""
    steps = np.concatenate([np.r_[np.zeros(rest, int), np.full(length, (-1) ** k)] for k, rest in enumerate(rests)])
    return np.r_[0, np.cumsum(steps), np.full(5 * TUNING.segments_long * SETTLED, steps.sum())]


def shares(counts: Counts) -> list[Share]:
    return list(shares_of(counts, SETTLED, QUARTER, SPAN))


def test_motion_without_long_rests_is_cut_as_it_stands() -> None:
    counts = moves([TUNING.segments_long * SETTLED - 1] * 30)[: -5 * TUNING.segments_long * SETTLED]
    places = np.concatenate([one.places for one in shares(counts)])
    assert np.array_equal(places, np.arange(places.size))
    assert all(one.repeats == 1 for one in shares(counts))
    assert counts.size - places.size < 2 * QUARTER


@pytest.mark.parametrize("rest", [500, 3000, 9000])
def test_every_move_is_in_one_segment_with_as_much_rest_as_settles(rest: int) -> None:
    counts = moves([rest] * 40)
    found = shares(counts)
    places = np.concatenate([one.places for one in found])
    assert np.unique(places).size == places.size
    moving = np.flatnonzero(np.diff(counts)) + 1
    assert np.isin(moving, places).all() or rest == 500  # the last samples of whole segments may also be too few
    assert places.size < moving.size + 40 * 2 * (SETTLED + 1) + 5 * SETTLED
    assert all(one.places[-1] - one.places[0] < SPAN for one in found)


def test_few_moves_follow_themselves_without_a_jump_and_count_once() -> None:
    one = shares(moves([3000, 3000, 3000]))[0]
    counts = one.counts(moves([3000, 3000, 3000]))
    assert counts.size == one.size == 4 * QUARTER
    assert np.abs(np.diff(counts)).max() == 1
    assert one.repeats == pytest.approx(one.size / one.places.size)
    assert one.repeats > 2


def test_a_move_that_is_shorter_than_the_filters_settle_is_not_repeated() -> None:
    repeats = [shares(moves([15_000] * 3, length))[1].repeats for length in (SETTLED + 2, SETTLED // 2)]
    assert repeats[0] > 10
    assert repeats[1] == 1


def test_an_axis_at_rest_has_a_segment_that_says_nothing() -> None:
    found = shares(np.zeros(40_000, np.int64))
    assert found
    assert all(one.size == QUARTER and one.repeats == 1 for one in found)


def tracks(theta: np.ndarray, status: np.ndarray, std: float) -> Tracks:
    """Return tracks of one axis and one parameter from theta and status (m,)."""
    m = theta.size
    ones = np.ones((1, m, 1))
    variance = np.full((1, m), std**2)
    return Tracks(("mass",), ("kg",), theta[None, :, None], ones, ones, np.zeros((1, m)), variance,
                  status[None].astype(np.uint32), 100 * np.arange(1, m + 1))  # fmt: skip


def test_an_estimate_that_still_moves_has_a_bar_that_says_so() -> None:
    still, moving = np.full(16, 2.0), 2.0 + 0.3 * np.exp(-np.arange(16) / 8)
    none = np.zeros(16, int)
    assert settled_std(tracks(still, none, 0.01))[0, 0] == pytest.approx(0.01)
    assert settled_std(tracks(moving, none, 0.01))[0, 0] > moving[-1] - 2.0


def test_an_equation_that_was_off_for_long_is_off() -> None:
    theta, off = np.full(16, 2.0), np.zeros(16, int)
    off[8:12] = Status.UNMODELLED
    assert lasting_status(tracks(theta, off, 0.01))[0] & Status.UNMODELLED
    off[8:11] = 0
    assert not lasting_status(tracks(theta, off, 0.01))[0] & Status.UNMODELLED

"""Blocks and lines of one axis arrive in any order: the output is sorted, without duplicates, and shows the gaps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pmfid.stream.delivery import Block, Lines
from pmfid.stream.groups import Timed
from pmfid.stream.order import UNKNOWN_GAP, ItemReport, Order, SamplePiece
from pmfid.stream.timeline import Line
from tests.service.orders import DT, sending_of

WINDOW = 100
SEEDS = st.integers(0, 2**32)
SOME = settings(max_examples=30, derandomize=True)


def put_in_order(blocks: Sequence[Block], window: int = WINDOW) -> tuple[list[SamplePiece], ItemReport]:
    """Return the pieces of the blocks in order of arrival, and the sum of the verdicts."""
    order, pieces, total = Order(DT, window), list[SamplePiece](), ItemReport()
    for turn, block in enumerate(blocks):
        verdict = order.take(block, 0.0, turn, pieces)
        if verdict is not None:
            total.dropped += verdict.dropped
            total.events += verdict.events
    return pieces, total


@dataclass(frozen=True)
class Step:
    """A sample in the form that the monitor receives."""

    lead: int
    apart: bool
    u: float
    counts: int
    time: float


def steps(pieces: Sequence[SamplePiece]) -> list[Step]:
    found = []
    for piece in pieces:
        for k, (u, counts) in enumerate(zip(piece.u.tolist(), piece.counts.tolist(), strict=True)):
            lead, apart = (piece.lead, piece.apart) if k == 0 else (0, False)
            found.append(Step(lead, apart and lead != 0, u, counts, piece.time + (piece.offset + k) * DT))
    return found


def block(first: int, n: int, epoch: int = 0, time: float = math.nan, dt: float = DT) -> Block:
    numbers = np.arange(first, first + n)
    return Block("x", epoch, first, time, dt, numbers + 0.5, numbers)


@SOME
@given(SEEDS)
def test_every_order_within_the_window_gives_the_same(seed: int) -> None:
    sending = sending_of(seed, WINDOW)
    first, _ = put_in_order(sending.arrived)
    second, _ = put_in_order(sending.shuffled(Random(seed)))
    n = min(len(steps(first)), len(steps(second)))
    assert steps(first)[:n] == steps(second)[:n]


def test_a_hole_is_a_gap_once_more_than_the_window_waits_after_it_and_then_late() -> None:
    pieces, verdict = put_in_order([block(0, 50), block(50, 51), block(120, 70), block(190, 40)])
    assert [(p.lead, p.u.size) for p in pieces] == [(0, 50), (0, 51), (19, 70), (0, 40)]
    assert [reported["event"] for reported in verdict.events] == ["gap"]
    _, verdict = put_in_order([block(0, 101), block(120, 110), block(101, 19), block(0, 10)])
    assert (verdict.dropped["late"], verdict.dropped["duplicate"]) == (19, 10)


def test_a_new_epoch_is_a_gap_of_known_length_where_the_clock_tells_and_else_unknown() -> None:
    later = [block(0, 10, time=5.0), block(0, 10, epoch=1, time=5.0 + 60 * DT)]
    back = [block(0, 10, time=5.0), block(0, 10, epoch=1, time=1.0)]
    for blocks, lead in ((later, 50), (back, UNKNOWN_GAP)):
        pieces, verdict = put_in_order(blocks, window=0)
        assert [(p.lead, p.apart) for p in pieces] == [(0, True), (lead, True)]
        assert [reported["event"] for reported in verdict.events] == ["epoch"]
    _, verdict = put_in_order([*later, block(10, 5, time=5.1)], window=0)
    assert verdict.dropped["late"] == 5


@pytest.mark.parametrize(("samples", "begins"), [(2**53, True), (9_000_000, True), (8_000_000, False)])
def test_numbers_beyond_a_day_begin_a_new_epoch(samples: int, begins: bool) -> None:
    pieces, verdict = put_in_order([block(0, 10), block(samples, 10), block(samples + 10, 10)], window=0)
    assert [event["event"] for event in verdict.events] == ["epoch" if begins else "gap"]
    assert [(piece.lead, piece.apart) for piece in pieces] == [
        (0, True),
        (UNKNOWN_GAP, True) if begins else (samples - 10, False),
        (0, False),
    ]


# --- lines ------------------------------------------------------------------------------------------------------------


def lines_in_order(lines: Sequence[Line], window: float) -> tuple[list[Step], ItemReport]:
    timed, pieces, total = Timed(DT, window, timed=True), list[SamplePiece](), ItemReport()
    for turn, line in enumerate(lines):
        verdict = timed.take(Lines("x", [line]), 0.0, turn, pieces)
        total.events += verdict.events
        total.dropped += verdict.dropped
        restored = Timed(DT, window, timed=True)
        restored.restore(timed.save_state())
        timed = restored
    found = []
    for piece in pieces:
        assert piece.times is not None
        for k, time in enumerate(piece.times.tolist()):
            found.append(Step(piece.lead if k == 0 else 0, False, float(piece.u[k]), int(piece.counts[k]), time))
    return found, total


@SOME
@given(SEEDS)
def test_lines_in_any_order_within_the_window_are_sorted(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sent = [Line(k * DT, float(rng.normal()), k) for k in range(120)]
    key = [k + rng.uniform(0, 40) for k in range(120)]
    arrived = [sent[k] for k in np.argsort(key)]
    found, _ = lines_in_order(arrived, 41 * DT)
    straight, _ = lines_in_order(sent, 0.0)
    assert found == straight[: len(found)]
    assert len(found) >= 120 - 42


def test_lines_that_come_again_after_a_restart_are_a_no_op() -> None:
    lines = [Line(k * DT, 0.5 * k, k) for k in range(200)]
    for window in (0.0, 10 * DT):
        timed, pieces = Timed(DT, window, timed=True), list[SamplePiece]()
        timed.take(Lines("x", lines[:150]), 0.0, 0, pieces)
        again = Timed(DT, window, timed=True)
        again.restore(timed.save_state())
        verdict = again.take(Lines("x", lines[120:]), 0.0, 1, pieces)
        assert verdict.events == []
        assert sum(verdict.lines.values()) == 30
        counts = np.concatenate([piece.counts for piece in pieces])
        assert counts.tolist() == list(range(counts.size))
        assert counts.size >= 199 - round(window / DT)
        assert [piece.lead for piece in pieces if piece.lead] == []


def test_lines_of_a_clock_that_was_set_back_go_on() -> None:
    lines = [Line(100 + k * DT, 1.0, k) for k in range(100)]
    lines += [Line(100 + k * DT - 3600, 1.0, k) for k in range(100, 300)]
    found, verdict = lines_in_order(lines, 10 * DT)
    assert [reported["event"] for reported in verdict.events if reported["event"] == "clock"] == ["clock"]
    assert len(found) > 280


def test_a_line_without_a_time_is_the_next_sample() -> None:
    """A bad line takes a sample period as well."""
    lines = [Line(math.nan, 1.0, 5) if k != 3 else Line(math.nan, math.nan, 0, "no number") for k in range(600)]
    timed, pieces = Timed(DT, 0.5, timed=False), list[SamplePiece]()
    verdict = timed.take(Lines("x", lines), 0.0, 0, pieces)
    (piece,) = pieces
    assert piece.times == pytest.approx(DT * np.arange(600))
    assert np.flatnonzero(np.isnan(piece.u)).tolist() == [3]
    assert [what["problem"] for what in verdict.events] == ["no number"]

"""Faults of loggers at any place: the next good lines count again, and one sentence refuses another sample period."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pmfid.config.axis import Axis, load_axis
from pmfid.errors import UsageError
from pmfid.service.wire.messages import LineSplitter
from pmfid.simulation import CART, CART_DT, Schedule
from pmfid.stream.lines import LineParser
from pmfid.stream.timeline import Line, Sample, Skipped, Timeline
from pmfid.stream.tuning import TUNING
from studies.monitoring.axis import INCREMENTS, changing
from studies.monitoring.pipe import write_axis
from tests.pipe_faults import FAULTS, HEADER, Row, Text, lines, restamped

SECONDS = 13.5
#: Good lines that a fault may cost.
COST = 10
#: Places of each fault: the beginning, a place before the clock is known, and some later places.
PLACES = [*range(5), *range(5, 50, 6)]


@pytest.fixture(scope="module")
def axis(tmp_path_factory: pytest.TempPathFactory) -> Axis:
    return load_axis(write_axis(tmp_path_factory.mktemp("axis"), 1.0))


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    u, counts = changing(Schedule(((0.0, CART),)), 5, INCREMENTS, SECONDS)
    return [(k * CART_DT, a, b) for k, (a, b) in enumerate(zip(u.tolist(), counts.tolist(), strict=True))]


def found(axis: Axis, body: Text) -> Iterator[Sample | Skipped]:
    splitter, parse, timeline = LineSplitter(), LineParser(HEADER, axis), Timeline(CART_DT)
    for text in splitter.feed(b"".join(body)):
        line = parse(text) if text.strip() else None
        yield from timeline.take(line) if line is not None else ()


@pytest.mark.parametrize("name", FAULTS)
def test_the_next_good_lines_count_again(axis: Axis, name: str) -> None:
    """At each place the lines after the fault arrive in order, once, and at their times; each line has its own
    count.
    """
    rng, fault = np.random.default_rng(len(name)), FAULTS[name]
    for k in (fault.first + place for place in PLACES):
        after = k + fault.lasts + COST
        size = after + max(30, fault.lasts)
        clean = [(i * CART_DT, 0.5 * i, i) for i in range(size)]
        back = clean[k][2] if "counter at 0" in name else 0
        samples = [s for s in found(axis, fault.do(clean, k, rng)) if isinstance(s, Sample)]
        counts = [s.counts for s in samples if s.u == 0.5 * (s.counts + back)]
        assert counts[after - size :] == [i - back for i in range(after, size)]
        assert [s.counts for s in samples][:k] == list(range(k))
        assert all(s.missing == 0 and s.jump == 0 for s in samples[after - size :])


def rated(rows: list[Row], step: float) -> Text:
    return lines([(1000.0 + k * step, u, c) for k, (_, u, c) in enumerate(rows)])


REFUSED: dict[str, tuple[Callable[[list[Row]], Text], str]] = {
    "8 ms": (lambda rows: rated(rows, 0.008), r"the lines come every 0\.008 s, the reference has 0\.01 s"),
    "20 ms": (lambda rows: rated(rows, 0.02), r"every 0\.02 s"),
    "5 ms": (lambda rows: rated(rows, 0.005), r"every 0\.005 s"),
    "12 ms": (lambda rows: rated(rows, 0.012), r"every 0\.012 s"),
    "9.9 ms": (lambda rows: rated(rows, 0.0099), r"every 0\.0099 s"),
    "10.3 ms": (lambda rows: rated(rows, 0.0103), r"every 0\.0103 s"),
    "time in ms": (lambda rows: rated(rows, 10.0), r"every 10 s.*must be in s"),
    "8 ms after a restart": (
        lambda rows: lines(rows[:300]) + lines([(k * 0.008, u, c) for k, (_, u, c) in enumerate(rows[300:])]),
        r"every 0\.008 s",
    ),
    "8 ms on the way": (
        lambda rows: lines(rows[:300]) + lines([(3 + k * 0.008, u, c) for k, (_, u, c) in enumerate(rows[300:])]),
        r"every 0\.008 s",
    ),
    "a clock that stands": (
        lambda rows: lines(restamped(rows, 300, lambda t: 3.0)),
        "does not continue the record",
    ),
    "random stamps": (
        lambda rows: lines(restamped(rows, 0, lambda t: float(np.random.default_rng(int(1e6 * t)).random()))),
        "the lines come every|does not continue the record",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_another_period_is_refused(axis: Axis, rows: list[Row], name: str) -> None:
    body, message = REFUSED[name]
    with pytest.raises(UsageError) as refused:
        list(found(axis, body(rows)))
    assert re.search(message, str(refused.value))


# --- the grid itself --------------------------------------------------------------------------------------------------

DT = 0.01


def take_all(timeline: Timeline, times: list[float]) -> list[Any]:
    return [one for k, t in enumerate(times) for one in timeline.take(Line(t, float(k), k))]


@settings(max_examples=60)
@given(
    st.floats(-1e6, 1e6),
    st.lists(st.floats(-0.3, 0.3), min_size=5, max_size=80),
)
def test_even_stamps_are_the_samples(start: float, off: list[float]) -> None:
    times = [start + DT * (k + error) for k, error in enumerate(off)]
    taken = take_all(Timeline(DT), times)
    assert [(s.time, s.counts, s.missing) for s in taken] == [(t, k, 0) for k, t in enumerate(times)]


@settings(max_examples=100)
@given(st.lists(st.floats(-1e9, 1e9) | st.integers(0, 200).map(lambda k: k * DT), max_size=120))
def test_every_line_is_reported_once(times: list[float]) -> None:
    """For any stamps, a line is a sample or skipped; counts and time stay in order between breaks."""
    timeline = Timeline(DT)
    taken: list[Any] = []
    try:
        taken = take_all(timeline, times)
    except UsageError:
        return
    samples = [s for s in taken if isinstance(s, Sample) and not np.isnan(s.u)]
    assert len({s.counts for s in samples}) == len(samples)
    waiting = len(times) - len(samples) - sum(isinstance(s, Skipped) for s in taken)
    assert 0 <= waiting < TUNING.timeline_late
    for before, now in pairwise(taken):
        if isinstance(before, Sample) and isinstance(now, Sample) and not (now.missing or now.jump):
            assert abs((now.time - before.time) / DT - 1) < 2


@settings(max_examples=60)
@given(st.integers(1, 200), st.integers(5, 60))
def test_a_gap_is_as_long_as_it_is(lost: int, before: int) -> None:
    times = [k * DT for k in range(before)] + [(k + lost) * DT for k in range(before, before + 20)]
    samples = [s for s in take_all(Timeline(DT), times) if isinstance(s, Sample)]
    assert [s.missing for s in samples if s.missing] == [lost]
    assert [s.counts for s in samples] == list(range(len(times)))

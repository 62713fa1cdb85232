"""What loggers do wrong: after each kind of fault, at random places, the next good lines count again and a change of
the mass is found, or the run is refused in one sentence."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pmfid.errors import UsageError
from pmfid.monitor.calibration import Calibration, calibrate
from pmfid.monitor.monitor import Monitor
from pmfid.session.config import Axis, load_axis
from pmfid.session.monitored.run import MonitoredRun, watch
from pmfid.session.monitored.sinks import Nowhere
from pmfid.session.monitored.stream import Stop, line_samples
from pmfid.session.monitored.timeline import MOST_STRAYS, REPEATED, Line, Sample, Skipped, Timeline
from pmfid.simulation import CART, CART_DT, Schedule
from studies.monitoring.axis import INCREMENTS, changing, make_riv, normal_work
from studies.monitoring.pipe import write_axis

HEADER = b"t,u,counts\n"
THETA = np.array([CART.mass, CART.viscous_friction, CART.coulomb_friction])
CHANGE, SECONDS = 8.0, 11.5
#: Good lines that a fault may cost.
COST = 10

Row = tuple[float, float, int]
Text = list[bytes]


def text(row: Row) -> bytes:
    return f"{row[0]:.12g},{row[1]!r},{row[2]}\n".encode()


def restamped(rows: list[Row], begin: int, stamp: Callable[[float], float], end: int | None = None) -> list[Row]:
    part = slice(begin, end)
    return [*rows[:begin], *((stamp(t), u, c) for t, u, c in rows[part]), *(rows[end:] if end is not None else [])]


@dataclass(frozen=True)
class Fault:
    """do: the lines with the fault from row k on; lasts: lines from k on that are not as they should be."""

    do: Callable[[list[Row], int, np.random.Generator], Text]
    lasts: int = 1


def lines(rows: list[Row]) -> Text:
    return [text(row) for row in rows]


def insert(what: bytes | Callable[[list[Row], int], Text]) -> Fault:
    def do(rows: list[Row], k: int, rng: np.random.Generator) -> Text:
        extra = [what] if isinstance(what, bytes) else what(rows, k)
        return [*lines(rows[:k]), *extra, *lines(rows[k:])]

    return Fault(do)


def in_place(what: Callable[[Row], bytes], count: int = 1) -> Fault:
    def do(rows: list[Row], k: int, rng: np.random.Generator) -> Text:
        return [*lines(rows[:k]), *(what(row) for row in rows[k : k + count]), *lines(rows[k + count :])]

    return Fault(do, count)


def stamp(change: Callable[[float], float], count: int | None = 1) -> Fault:
    def do(rows: list[Row], k: int, rng: np.random.Generator) -> Text:
        return lines(restamped(rows, k, change, None if count is None else k + count))

    return Fault(do, count or 1)


def order(places: list[int]) -> Fault:
    def do(rows: list[Row], k: int, rng: np.random.Generator) -> Text:
        part = [rows[k + place] for place in places]
        return lines([*rows[:k], *part, *rows[k + len(places) :]])

    return Fault(do, len(places))


def without(pick: Callable[[int], bool], count: int) -> Fault:
    def do(rows: list[Row], k: int, rng: np.random.Generator) -> Text:
        return lines([row for i, row in enumerate(rows) if not (k <= i < k + count and pick(i - k))])

    return Fault(do, count)


def starts_again(header: bytes, counts: bool) -> Fault:
    def do(rows: list[Row], k: int, rng: np.random.Generator) -> Text:
        (t0, _, c0), zero = rows[k], 1 if counts else 0
        again = [(t - t0, u, c - zero * c0) for t, u, c in rows[k:]]
        return [*lines(rows[:k]), *([header] if header else []), *lines(again)]

    return Fault(do)


def other_order(rows: list[Row], k: int, rng: np.random.Generator) -> Text:
    later = [f"{c},{t:.12g},{u!r}\n".encode() for t, u, c in rows[k:]]
    return [*lines(rows[:k]), b"counts,t,u\n", *later]


def jitter(rows: list[Row], k: int, rng: np.random.Generator) -> Text:
    later = [(t + 0.15 * CART_DT * float(rng.standard_normal()), u, c) for t, u, c in rows[k:]]
    return lines(rows[:k] + later)


def stall(rows: list[Row], k: int, rng: np.random.Generator) -> Text:
    """Sixty lines are written at once, stamped then."""
    late = rows[k + 60][0]
    burst = [(late + 1e-4 * rng.random(), u, c) for _, u, c in rows[k : k + 60]]
    return lines([*rows[:k], *burst, *rows[k + 60 :]])


def two_loggers(rows: list[Row], k: int, rng: np.random.Generator) -> Text:
    other = [(t + 777.7, u + 1, c + 5000) for t, u, c in rows[k : k + 200]]
    mixed = [row for pair in zip(rows[k : k + 200], other, strict=True) for row in pair]
    return lines([*rows[:k], *mixed, *rows[k + 200 :]])


FAULTS: dict[str, Fault] = {
    "a line twice": insert(lambda rows, k: [text(rows[k - 1])]),
    "a line five times": insert(lambda rows, k: 4 * [text(rows[k - 1])]),
    "the last ten lines again": insert(lambda rows, k: lines(rows[k - 10 : k])),
    "the last three lines again": insert(lambda rows, k: lines(rows[k - 3 : k])),
    "a line between two": insert(lambda rows, k: [text((rows[k][0] - 0.005, *rows[k][1:]))]),
    "a foreign line": insert(lambda rows, k: [text((123.4, 1.0, 77))]),
    "garbage": insert(b"garbage\n"),
    "a comment": insert(b"# calibrated by hand\n"),
    "an empty line": insert(b"\r\n"),
    "the header again": insert(HEADER),
    "columns in another order": Fault(other_order),
    "two lines swapped": order([1, 0]),
    "a line late by three": order([1, 2, 3, 0]),
    "three lines reversed": order([2, 1, 0]),
    "a stamp 6 ms late": stamp(lambda t: t + 0.006),
    "a stamp 6 ms early": stamp(lambda t: t - 0.006),
    "a clock 6 ms on": stamp(lambda t: t + 0.006, None),
    "a clock 6 ms back": stamp(lambda t: t - 0.006, None),
    "a clock 3 samples back": stamp(lambda t: t - 0.03, None),
    "a clock a second back": stamp(lambda t: t - 1, None),
    "a clock a minute on": stamp(lambda t: t + 60, None),
    "a clock a year on": stamp(lambda t: t + 3.2e7, None),
    "the logger at 0 again": starts_again(b"", counts=False),
    "the logger and the counter at 0 again": starts_again(HEADER, counts=True),
    "a stamp of 1e6": stamp(lambda t: 1e6),
    "three stamps of 1e6": stamp(lambda t: 1e6, 3),
    "a negative stamp": stamp(lambda t: -5.0),
    "a stamp of a second later": stamp(lambda t: t + 1),
    "a line lost": without(lambda i: True, 1),
    "a second lost": without(lambda i: True, 100),
    "every third line lost for a second": without(lambda i: i % 3 == 0, 100),
    "a line cut off": in_place(lambda row: text(row)[:6]),
    "two lines in one": in_place(lambda row: text(row)[:-1]),
    "no number": in_place(lambda row: b"%.12g,nan,3\n" % row[0]),
    "half a count": in_place(lambda row: b"%.12g,1.0,0.5\n" % row[0]),
    "no time": in_place(lambda row: b"nan,1.0,%d\n" % row[2]),
    "no text": in_place(lambda row: b"\xff\xfe\x00\x01,\x00\n"),
    "a line of 200 kB": in_place(lambda row: 200_000 * b"7" + b"\n"),
    "a second of garbage": in_place(lambda row: b"offline\n", 100),
    "a clock that stands for a third of a second": stamp(lambda t: 4.0, 30),
    "stamps that jitter by 15 %": Fault(jitter),
    "sixty lines at once": Fault(stall, 60),
    "every line twice": Fault(lambda rows, k, rng: lines(rows[:k]) + [x for r in rows[k:] for x in 2 * [text(r)]]),
    "two loggers in one pipe": Fault(two_loggers, 200),
}


@pytest.fixture(scope="module")
def axis(tmp_path_factory: pytest.TempPathFactory) -> Axis:
    return load_axis(write_axis(tmp_path_factory.mktemp("axis"), 1.0))


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    u, _ = normal_work(7, INCREMENTS, 0.05)
    return calibrate(make_riv(INCREMENTS), THETA, u, None, hours=1.0)


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    heavier = Schedule(((0.0, CART), (CHANGE, replace(CART, mass=1.2 * CART.mass))))
    u, counts = changing(heavier, 5, INCREMENTS, SECONDS)
    return [(k * CART_DT, a, b) for k, (a, b) in enumerate(zip(u.tolist(), counts.tolist(), strict=True))]


def found(axis: Axis, body: Text, dt: float = CART_DT) -> Iterator[Any]:
    return line_samples(io.BytesIO(HEADER + b"".join(body)), axis, dt, Stop())


def monitored(axis: Axis, calibration: Calibration, body: Text) -> MonitoredRun:
    monitor = Monitor(make_riv(INCREMENTS, THETA), calibration)
    return watch(found(axis, body), monitor, Nowhere(), lambda event: None)


@pytest.mark.parametrize("name", FAULTS)
def test_the_next_good_lines_count_again(axis: Axis, name: str) -> None:
    """Each line has a count of its own: those after the fault arrive, in order, once, and at their places."""
    rng, fault = np.random.default_rng(len(name)), FAULTS[name]
    for k in rng.integers(20, 300, 6):
        clean = [(i * CART_DT, 0.01 * i, i) for i in range(700)]
        after = int(k) + fault.lasts + COST
        back = clean[k][2] if "counter at 0" in name else 0
        samples = [s for s in found(axis, fault.do(clean, int(k), rng)) if isinstance(s, Sample)]
        counts = [s.counts for s in samples if not np.isnan(s.u) and s.u == pytest.approx(0.01 * (s.counts + back))]
        assert counts[-(700 - after) :] == [i - back for i in range(after, 700)]
        assert [s.counts for s in samples][:k] == list(range(k))
        assert all(s.missing == 0 and s.jump == 0 for s in samples[-(650 - after) :])


@pytest.mark.parametrize("name", FAULTS)
def test_the_change_is_found_behind_a_fault(axis: Axis, calibration: Calibration, rows: list[Row], name: str) -> None:
    rng, fault = np.random.default_rng(len(name)), FAULTS[name]
    for k in rng.integers(200, 600, 2):
        run = monitored(axis, calibration, fault.do(rows, int(k), rng))
        assert [alarm["parameter"] for alarm in run.alarms] == ["mass"]
        (alarm,) = run.alarms
        assert alarm["direction"] == "up"
        assert alarm["relative"] == pytest.approx(0.2, abs=0.07)
        assert run.problem == ""
        skipped = run.bad_lines + run.repeated_lines + run.comments + run.missing + run.clock_jumps
        quiet = ("6 ms", "jitter", "another order", "empty", "between", "swapped")
        assert skipped > 0 or any(word in name for word in quiet)


def test_the_first_stamp_may_be_wrong(axis: Axis, calibration: Calibration, rows: list[Row]) -> None:
    run = monitored(axis, calibration, FAULTS["a stamp of 1e6"].do(rows, 0, np.random.default_rng(0)))
    assert [alarm["parameter"] for alarm in run.alarms] == ["mass"]
    assert (run.clock_jumps, run.samples) == (1, len(rows))


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
    "decimal commas": (lambda rows: [line.replace(b".", b",") for line in lines(rows[1:])], "cells in place of 3"),
    "semicolons": (lambda rows: [line.replace(b",", b";") for line in lines(rows)], "1 cells in place of 3"),
    "a clock that stands": (lambda rows: lines(restamped(rows, 300, lambda t: 3.0)), "fits nowhere|cannot be used"),
    "random stamps": (
        lambda rows: lines(restamped(rows, 0, lambda t: float(np.random.default_rng(int(1e6 * t)).random()))),
        "lines cannot be used|the lines come every|fits nowhere",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_the_rest_is_refused_without_an_alarm(axis: Axis, calibration: Calibration, rows: list[Row], name: str) -> None:
    body, message = REFUSED[name]
    run = monitored(axis, calibration, body(rows))
    assert run.alarms == []
    with pytest.raises(UsageError, match=message):
        raise UsageError(run.problem)
    assert run.problem.count("\n") == 0


# --- the grid itself --------------------------------------------------------------------------------------------------

DT = 0.01


def take_all(timeline: Timeline, times: list[float]) -> list[Any]:
    taken = [one for k, t in enumerate(times) for one in timeline.take(Line(t, float(k), k))]
    return taken + timeline.end()


@settings(deadline=None, max_examples=60)
@given(
    st.floats(-1e6, 1e6),
    st.lists(st.floats(-0.3, 0.3), min_size=5, max_size=80),
)
def test_even_stamps_are_the_samples(start: float, off: list[float]) -> None:
    times = [start + DT * (k + error) for k, error in enumerate(off)]
    taken = take_all(Timeline(DT), times)
    assert [(s.time, s.counts, s.missing) for s in taken] == [(t, k, 0) for k, t in enumerate(times)]


@settings(deadline=None, max_examples=100)
@given(st.lists(st.floats(-1e9, 1e9) | st.integers(0, 200).map(lambda k: k * DT), max_size=120))
def test_every_line_is_told_once(times: list[float]) -> None:
    """Whatever the stamps: a line is a sample or skipped; counts and time stay in order between breaks."""
    timeline = Timeline(DT)
    taken: list[Any] = []
    try:
        taken = take_all(timeline, times)
    except UsageError:
        return
    samples = [s for s in taken if isinstance(s, Sample) and not np.isnan(s.u)]
    assert len({s.counts for s in samples}) == len(samples)
    assert len(samples) + sum(isinstance(s, Skipped) for s in taken) == len(times)
    for before, now in pairwise(taken):
        if isinstance(before, Sample) and isinstance(now, Sample) and not (now.missing or now.jump):
            assert abs((now.time - before.time) / DT - 1) < 2


@settings(deadline=None, max_examples=60)
@given(st.integers(1, 200), st.integers(5, 60))
def test_a_gap_is_as_long_as_it_is(lost: int, before: int) -> None:
    times = [k * DT for k in range(before)] + [(k + lost) * DT for k in range(before, before + 20)]
    samples = [s for s in take_all(Timeline(DT), times) if isinstance(s, Sample)]
    assert [s.missing for s in samples if s.missing] == [lost]
    assert [s.counts for s in samples] == list(range(len(times)))


def test_strays_without_end_are_refused() -> None:
    timeline = Timeline(DT)
    for _ in range(MOST_STRAYS):
        timeline.take(Line(0.0, 0.0, 0))
    with pytest.raises(UsageError, match="fits nowhere, the last 0 s: correct the time column"):
        timeline.take(Line(0.0, 0.0, 0))


def test_a_repetition_is_called_one() -> None:
    taken = take_all(Timeline(DT), [0.0, DT, DT, 2 * DT])
    assert [one.kind for one in taken if isinstance(one, Skipped)] == [REPEATED]


def test_a_refused_pipe_ends_with_its_totals(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Exit code 2, one line of refusal, and all that came before is written."""
    from click.testing import CliRunner

    from pmfid.cli.main import main

    path = write_axis(tmp_path, 60.0)
    monkeypatch.setenv("PMFID_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("pmfid.session.monitored.setup.simulated_hours", lambda hours: 0.5)
    body = [f"{0.008 * k:.3f},0,0\n".encode() for k in range(60)]
    arguments = ["monitor", "-", "--config", str(path), "--json", "--out", str(tmp_path / "x.csv")]
    result = CliRunner().invoke(main, arguments, input=HEADER + b"".join(body))
    assert result.exit_code == 2
    assert result.stderr.splitlines()[-1].startswith("pmfid: the lines come every 0.008 s")
    assert '"event": "end"' in result.stdout
    assert (tmp_path / "x.csv").read_text().count("\n") > 10

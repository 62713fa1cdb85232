"""Samples of a record that no motion explains: left out before anything is estimated.

The kernel judges a sample by those before it. A whole record shows those behind it as well, and methods that simulate
all of it need it whole: one wrong count would be in every comparison with the simulated position, one wrong input in
every sample behind it. So what no motion explains is replaced by what its neighbours say, and named.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pmfid.estimators.plants import plant_of
from pmfid.findings import Finding, codes, texts
from pmfid.session.config import Axis
from pmfid.session.records import Record
from pmfid.session.wrap import wrap_of
from pmfid.types import Counts, Floats

__all__ = ["RepairedRecord", "repair_record"]


#: A change of the counts is compared with the median of so many around it: that of a velocity which steps is on either
#: side of the step, and five wrong ones in a row do not move it. Its own steps are looked for as far around.
AROUND = 11
#: It may differ from that by so many counts, and so many times what it usually does and what the velocity does there.
COUNTS, TIMES = 10.0, 4.0
USUAL = 0.95
#: Wrong ones so close that they hide each other need another look.
PASSES = 4
#: With a larger part of such changes it is not single samples that are wrong.
MOST_CHANGES = 0.04
#: An input so many times all but MOST_INPUTS of the others is a spike, unless the velocity says more to it than so
#: many times what it usually does, over so many samples.
SPIKE, ANSWER, ANSWER_SAMPLES = 50.0, 3.0, 10
MOST_INPUTS = 0.01
#: Windows that are sorted at once: all of a long record would be eleven records.
CHUNK = 65_536
#: Rows that a sentence names.
NAMED = 4


@dataclass(frozen=True)
class RepairedRecord:
    """A record without what no motion explains, and what there is to say of that."""

    record: Record
    findings: tuple[Finding, ...] = ()

    @property
    def sentence(self) -> str:
        """All of it as one sentence."""
        return "; ".join(texts(self.findings))

    @property
    def status(self) -> tuple[str, ...]:
        return codes(self.findings)


@dataclass(frozen=True)
class _WrongRun:
    """Changes first to last - 1 of the counts that are no motion; `moved`: by how many counts the zero moved."""

    first: int
    last: int
    moved: int

    def rows(self, samples: int) -> NDArray[np.intp]:
        """Wrong readings of so many samples: those between the changes, and those in front of or behind them all."""
        return np.arange(0 if self.first == 0 else self.first + 1, samples if self.last == samples - 1 else self.last)


def repair_record(record: Record) -> RepairedRecord:
    """The record with wrong counts and spikes of the input on the line between their neighbours, and a counter that was
    set anew put back. A counter that wraps, and a record in which too much is wrong, stay as they are."""
    runs, counts = _find_runs(record.counts)
    moves = [run for run in runs if run.moved]
    if moves and wrap_of(record.counts) is not None:  # what comes back at once is no wrap
        runs, moves, counts = [], [], record.counts
    rows = sorted({int(row) for run in runs if run.moved == 0 for row in run.rows(counts.size)})
    spikes = _spikes(record.u, counts)
    left_out = [("count_jump", said) for said in (*_wrong(rows), *(_describe_shift(run) for run in moves[:NAMED]))]
    left_out += [("invalid_input", said) for said in _spiky(spikes)]
    if not left_out:
        return RepairedRecord(record)
    findings = tuple(Finding(code, said) for code, said in left_out)
    return RepairedRecord(replace(record, u=_bridge_input(record.u, spikes), counts=counts), findings)


def repair_as_configured(record: Record, axis: Axis) -> RepairedRecord:
    """The same, as far as the configuration lets anything be left out, and the model is that of a body that rests."""
    rests = plant_of(axis.model.make().equation).rests
    return repair_record(record) if axis.encoder.guard and rests else RepairedRecord(record)


def _find_runs(counts: Counts) -> tuple[list[_WrongRun], Counts]:
    """Runs of changes that are no motion, and the counts (n,) without them; none where something is left after all."""
    found, left = list[_WrongRun](), counts
    for _ in range(PASSES):
        runs = _runs(left)
        if not runs:
            return found, left
        found, left = found + runs, _repair_counts(left, runs)
    return [], counts


def _runs(counts: Counts) -> list[_WrongRun]:
    """Changes of the counts (n,) in a row that are no motion."""
    change = np.diff(counts).astype(np.float64)
    usual, limit = _predict_changes(change)
    wild = np.flatnonzero((np.abs(change - usual) > limit) & ~_goes_on(change, limit))
    if not 0 < wild.size <= max(2, MOST_CHANGES * change.size):
        return []
    near = np.split(wild, np.flatnonzero(np.diff(wild) > AROUND // 2) + 1)
    return [run for part in near for run in _split_runs(counts, part, usual, limit)]


def _goes_on(change: Floats, limit: Floats) -> NDArray[np.bool_]:
    """(n,): changes near either end of the record that lie on the line through the next two; those around, as in a
    mirror, do not show how a motion starts."""
    half, found = min(AROUND // 2, change.size - 2), np.zeros(change.size, dtype=bool)
    for own, near, next_one in ((slice(0, half), 1, 2), (slice(change.size - half, None), -1, -2)):
        line = 2 * np.roll(change, -near) - np.roll(change, -next_one)
        found[own] = np.abs(change - line)[own] <= limit[own]
    return found


def _split_runs(counts: Counts, wild: NDArray[np.intp], usual: Floats, limit: Floats) -> list[_WrongRun]:
    """The runs of changes `wild` (k,) close to each other: one if the counts come back behind it."""
    whole = _run(counts, int(wild[0]), int(wild[-1]) + 1, usual, limit)
    if whole.moved == 0:
        return [whole]
    parts = np.split(wild, np.flatnonzero(np.diff(wild) > 1) + 1)
    return [_run(counts, int(part[0]), int(part[-1]) + 1, usual, limit) for part in parts]


def _run(counts: Counts, first: int, last: int, usual: Floats, limit: Floats) -> _WrongRun:
    if first == 0 or last == counts.size - 1:  # nothing says that those at the end are right, or that the zero moved
        return _WrongRun(first, last, 0)
    beside = np.diff(counts)[[first - 1, last]]
    moved = int(counts[last]) - int(counts[first]) - round((last - first) * float(np.mean(beside)))
    if abs(moved) <= (last - first) * float(np.max(limit[first:last])):
        moved = 0
    return _WrongRun(first, last, moved)


def _predict_changes(change: Floats) -> tuple[Floats, Floats]:
    """What each change of the counts (n,) should be, and by how much it may differ: (n,)."""
    windows = _stack_neighbours(change)
    middle = np.concatenate([np.median(windows[k : k + CHUNK], axis=1) for k in range(0, len(windows), CHUNK)])
    steps = np.max(_stack_neighbours(np.abs(np.diff(middle, append=middle[-1:]))), axis=1)
    moving = middle != 0
    usual = float(np.quantile(np.abs(change - middle)[moving], USUAL)) if np.any(moving) else 0.0
    return middle, COUNTS + TIMES * (usual + steps)


def _stack_neighbours(values: Floats) -> Floats:
    """(n, AROUND) each of the values (n,) with those around it; at the ends as in a mirror."""
    half = min(AROUND // 2, values.size - 1)
    return np.lib.stride_tricks.sliding_window_view(np.pad(values, half, mode="reflect"), 2 * half + 1)


def _repair_counts(counts: Counts, runs: list[_WrongRun]) -> Counts:
    """The counts (n,), with the zero put back and wrong readings on the line between the good ones; at the ends of the
    record on that through the nearest two."""
    counts = counts.copy()
    for run in runs:
        counts[run.last :] -= run.moved
        wrong = run.rows(counts.size)
        if run.first == 0:
            left, right = run.last, run.last + 1
        elif run.last == counts.size - 1:
            left, right = run.first - 1, run.first
        else:
            left, right = run.first, run.last
        slope = (int(counts[right]) - int(counts[left])) / (right - left)
        counts[wrong] = counts[left] + np.round(slope * (wrong - left)).astype(np.int64)
    return counts


def _spikes(u: Floats, counts: Counts) -> NDArray[np.intp]:
    """Places of the input (n,) to which the counts (n,) do not answer."""
    size = np.abs(np.nan_to_num(u))  # in a gap nobody knows it
    large = np.flatnonzero(size > SPIKE * np.quantile(size, 1 - MOST_INPUTS, method="lower"))
    if large.size == 0 or counts.size < 4 * ANSWER_SAMPLES:
        return large[:0]
    travelled = np.pad(counts.astype(np.float64), 2 * ANSWER_SAMPLES, mode="edge")
    half = ANSWER_SAMPLES
    answer = np.abs(travelled[2 * half :] - 2 * travelled[half:-half] + travelled[: -2 * half])[half:-half]
    moving = answer[answer > 0]
    usual = float(np.quantile(moving, USUAL)) if moving.size else 0.0
    return large[answer[large] <= ANSWER * usual]


def _bridge_input(u: Floats, places: NDArray[np.intp]) -> Floats:
    """The input (n,) with those at places (k,) on the line between their neighbours."""
    good = np.setdiff1d(np.arange(u.size), places)
    return np.interp(np.arange(u.size), good, u[good]) if places.size else u


def _format_rows(rows: list[int]) -> str:
    """Rows from 1 on, as people count."""
    shown = ", ".join(str(row + 1) for row in rows[:NAMED])
    more = f" and {len(rows) - NAMED} more" if len(rows) > NAMED else ""
    return f"row{'s' * (len(rows) > 1)} {shown}{more}"


def _wrong(rows: list[int]) -> tuple[str, ...]:
    if not rows:
        return ()
    return (
        f"the counts of {_format_rows(rows)} fit no motion, and the other counts continue without them: left out; "
        "check the wiring, and if the axis did move so, give [encoder] guard = false",
    )


def _describe_shift(run: _WrongRun) -> str:
    return (
        f"the counts jump by {run.moved} at row {run.last + 1} and stay: taken for a counter that was set anew, and "
        "put back; if the axis did move so, give [encoder] guard = false"
    )


def _spiky(places: NDArray[np.intp]) -> tuple[str, ...]:
    if places.size == 0:
        return ()
    return (
        f"the input of {_format_rows(places.tolist())} is far beyond all others, and the counts do not follow: left "
        "out; if the drive did receive it, give [encoder] guard = false",
    )

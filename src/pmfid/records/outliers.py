"""Correction of counters that wrap, and of wrong samples."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pmfid.config.axis import Axis
from pmfid.estimators.plants import plant_of
from pmfid.findings import Finding, codes, texts
from pmfid.records.record import Record
from pmfid.records.tuning import TUNING
from pmfid.types import Counts, Floats

__all__ = ["Wrap", "wrap_of"]


@dataclass(frozen=True)
class Wrap:
    """The wrap of a counter.

    `span` is the range of the counter, `times` the number of wraps, and `row` the first wrap's row, counted from 1.
    """

    span: int
    times: int
    row: int

    @property
    def bits(self) -> int | None:
        """The width of the counter [bits], or None if its range is no power of two."""
        return self.span.bit_length() - 1 if self.span.bit_count() == 1 else None

    def describe_mistake(self, column: str, kind: str, resolution: float, unit: str) -> tuple[str, str]:
        """Return the mistake and its remedy for an output column of the given kind. `unit` is the unit of the
        resolution.
        """
        size = self.span if kind == "counts" else self.span * resolution
        what = f"the output column {column!r} wraps at {size:.4g}, the first time at row {self.row}"
        if kind == "counts" and self.bits is not None:
            return what, f"give [encoder] bits = {self.bits}"
        travel = self.span * resolution
        turns = round(travel / (2 * math.pi))
        whole = turns > 0 and abs(travel / (2 * math.pi * turns) - 1) < TUNING.whole_turns
        return (
            what,
            f'give [encoder] range = "{turns} rev"' if whole else f'give [encoder] range = "{travel:.9g} {unit}"',
        )


def wrap_of(counts: NDArray[np.int64]) -> Wrap | None:
    """Return the wrap of counts (n,), or None without a wrap.

    The largest changes of a wrapping counter are all nearly its range. After unwrapping, the largest changes fit a
    smooth motion.
    """
    change, extent = np.diff(counts), int(np.ptp(counts))
    jumps = np.abs(change) > extent / 2
    usual = int(np.max(np.abs(change[~jumps]), initial=0))
    if (
        extent < TUNING.outliers_least or not np.any(jumps) or usual == 0
    ):  # without motion between the jumps, the jumps are the motion
        return None
    for span in _spans(change, jumps, usual, extent):
        undone = (change + span // 2) % span - span // 2
        if not _smooth(change, undone, jumps, usual, span):
            continue
        found = Wrap(span, int(np.sum(undone != change)), int(np.argmax(undone != change)) + 2)
        # a single shift of a counter's zero may have any size
        return found if found.bits is not None or found.times > 1 else None
    return None


def _smooth(
    change: NDArray[np.int64], undone: NDArray[np.int64], jumps: NDArray[np.bool_], usual: int, span: int
) -> bool:
    """Return whether the motion after unwrapping is smooth, and whether its former jumps resemble the other changes."""
    rough, smooth = (float(np.sum(np.diff(series.astype(np.float64)) ** 2)) for series in (change, undone))
    alike = np.max(np.abs(undone[jumps])) <= 2 * usual + 2
    return bool(
        alike and np.max(np.abs(undone)) <= TUNING.outliers_room * span and smooth <= TUNING.outliers_smoother * rough
    )


def _spans(change: NDArray[np.int64], jumps: NDArray[np.bool_], usual: int, extent: int) -> list[int]:
    """Return the possible ranges of a counter, which are a power of two, and the jumps' size for periods such as a
    turn.
    """
    counter = 2 ** math.ceil(math.log2(extent + 1))
    sizes = np.abs(change[jumps])
    spans = [counter] if counter <= 2**TUNING.most_bits else []
    typical = round(float(np.median(sizes)) + float(np.median(np.abs(change[~jumps]))))
    return [*spans, max(typical, extent + 1)] if np.ptp(sizes) <= TUNING.outliers_alike * extent + 2 * usual else spans


@dataclass(frozen=True)
class RepairedRecord:
    """A record without the samples that no motion explains, and findings on these samples."""

    record: Record
    findings: tuple[Finding, ...] = ()

    @property
    def sentence(self) -> str:
        """All findings as one sentence."""
        return "; ".join(texts(self.findings))

    @property
    def status(self) -> tuple[str, ...]:
        return codes(self.findings)


@dataclass(frozen=True)
class _WrongRun:
    """A run of wrong changes of the counts, from `first` to `last` - 1. `moved` is the shift of the zero [counts]."""

    first: int
    last: int
    moved: int

    def rows(self, samples: int) -> NDArray[np.intp]:
        """Return the rows with wrong readings in a record of `samples` samples.

        The wrong rows lie between two changes, or between a change and an end of the record.
        """
        return np.arange(0 if self.first == 0 else self.first + 1, samples if self.last == samples - 1 else self.last)


def repair_record(record: Record) -> RepairedRecord:
    """Return the record without wrong counts, spikes of the input and shifts of a counter's zero.

    Wrong counts and spikes are interpolated, and shifts are reversed. A record with a counter that wraps, or with too
    many errors, remains unchanged.
    """
    runs, counts = _find_runs(record.counts, _paces_of(record))
    moves = [run for run in runs if run.moved]
    if moves and wrap_of(record.counts) is not None:  # a run without a shift returns at once and is no wrap
        runs, moves, counts = [], [], record.counts
    rows = sorted({int(row) for run in runs if run.moved == 0 for row in run.rows(counts.size)})
    spikes = _spikes(record.u, counts)
    shifts = (_describe_shift(run) for run in moves[: TUNING.outliers_named])
    findings = (*_wrong(rows), *shifts, *_spiky(spikes))
    if not findings:
        return RepairedRecord(record)
    return RepairedRecord(replace(record, u=_bridge_input(record.u, spikes), counts=counts), findings)


def repair_as_configured(record: Record, axis: Axis) -> RepairedRecord:
    """Return the repaired record if the configuration has the guard on and the plant can be at rest."""
    rests = plant_of(axis.model.make().equation).rests
    return repair_record(record) if axis.encoder.guard and rests else RepairedRecord(record)


def _paces_of(record: Record) -> Floats:
    """Return the time step (n - 1,) before each sample except the first, relative to the sample period."""
    return np.ones(record.counts.size - 1) if record.steps is None else record.steps.before[1:] / record.dt


def _find_runs(counts: Counts, paces: Floats) -> tuple[list[_WrongRun], Counts]:
    """Return runs of changes that are no motion, and the counts (n,) without them.

    The function returns no runs if wrong changes remain after all passes. The function also returns no runs if the
    counts within a very short step say nothing about the speed.
    """
    found, left = list[_WrongRun](), counts
    if np.min(paces, initial=1.0) < TUNING.outliers_pace:
        return [], counts
    for _ in range(TUNING.outliers_passes):
        runs = _runs(left, paces)
        if not runs:
            return found, left
        found, left = found + runs, _repair_counts(left, runs)
    return [], counts


def _runs(counts: Counts, paces: Floats) -> list[_WrongRun]:
    """Return runs of successive changes of the counts (n,) that are no motion."""
    change = np.diff(counts) / paces
    usual, limit = _predict_changes(change)
    wild = np.flatnonzero((np.abs(change - usual) > limit) & ~_goes_on(change, limit))
    if not 0 < wild.size <= max(2, TUNING.most_changes * change.size):
        return []
    near = np.split(wild, np.flatnonzero(np.diff(wild) > TUNING.outliers_around // 2) + 1)
    return [run for part in near for run in _split_runs(counts, paces, part, limit)]


def _goes_on(change: Floats, limit: Floats) -> NDArray[np.bool_]:
    """Mark the changes (n,) near either end of the record that lie on the line through the next two changes.

    At an end, the mirrored window does not show how a motion starts.
    """
    half, found = min(TUNING.outliers_around // 2, change.size - 2), np.zeros(change.size, dtype=bool)
    for own, near, next_one in ((slice(0, half), 1, 2), (slice(change.size - half, None), -1, -2)):
        line = 2 * np.roll(change, -near) - np.roll(change, -next_one)
        found[own] = np.abs(change - line)[own] <= limit[own]
    return found


def _split_runs(counts: Counts, paces: Floats, wild: NDArray[np.intp], limit: Floats) -> list[_WrongRun]:
    """Return the runs of neighbouring changes `wild` (k,), or a single run if the counts return after all of these
    changes.
    """
    whole = _run(counts, paces, int(wild[0]), int(wild[-1]) + 1, limit)
    if whole.moved == 0:
        return [whole]
    parts = np.split(wild, np.flatnonzero(np.diff(wild) > 1) + 1)
    return [_run(counts, paces, int(part[0]), int(part[-1]) + 1, limit) for part in parts]


def _run(counts: Counts, paces: Floats, first: int, last: int, limit: Floats) -> _WrongRun:
    if first == 0 or last == counts.size - 1:  # at an end of the record nothing shows a shift of the zero
        return _WrongRun(first, last, 0)
    speeds, time = (np.diff(counts) / paces)[[first - 1, last]], float(np.sum(paces[first:last]))
    moved = int(counts[last]) - int(counts[first]) - round(time * float(np.mean(speeds)))
    if abs(moved) <= time * float(np.max(limit[first:last])):
        moved = 0
    return _WrongRun(first, last, moved)


def _predict_changes(change: Floats) -> tuple[Floats, Floats]:
    """Return the predicted changes of the counts (n,), and the allowed deviations (n,)."""
    windows = _stack_neighbours(change)
    middle = np.concatenate(
        [
            np.median(windows[k : k + TUNING.outliers_chunk], axis=1)
            for k in range(0, len(windows), TUNING.outliers_chunk)
        ]
    )
    steps = np.max(_stack_neighbours(np.abs(np.diff(middle, append=middle[-1:]))), axis=1)
    moving = middle != 0
    usual = float(np.quantile(np.abs(change - middle)[moving], TUNING.outliers_usual)) if np.any(moving) else 0.0
    return middle, TUNING.outliers_counts + TUNING.outliers_times * (usual + steps)


def _stack_neighbours(values: Floats) -> Floats:
    """Return windows (n, outliers_around), one around each of the values (n,). At the ends, the windows mirror the
    values.
    """
    half = min(TUNING.outliers_around // 2, values.size - 1)
    return np.lib.stride_tricks.sliding_window_view(np.pad(values, half, mode="reflect"), 2 * half + 1)


def _repair_counts(counts: Counts, runs: list[_WrongRun]) -> Counts:
    """Return the counts (n,) without shifts of the zero, and with interpolated wrong readings.

    At the ends of the record, the counts are extrapolated from the nearest two.
    """
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
    """Return the samples of the input (n,) that are spikes, which the counts (n,) do not follow."""
    size = np.abs(np.nan_to_num(u))  # the input is unknown in a gap
    large = np.flatnonzero(size > TUNING.outliers_spike * np.quantile(size, 1 - TUNING.most_inputs, method="lower"))
    if large.size == 0 or counts.size < 4 * TUNING.answer_samples:
        return large[:0]
    travelled = np.pad(counts.astype(np.float64), 2 * TUNING.answer_samples, mode="edge")
    half = TUNING.answer_samples
    answer = np.abs(travelled[2 * half :] - 2 * travelled[half:-half] + travelled[: -2 * half])[half:-half]
    moving = answer[answer > 0]
    usual = float(np.quantile(moving, TUNING.outliers_usual)) if moving.size else 0.0
    return large[answer[large] <= TUNING.outliers_answer * usual]


def _bridge_input(u: Floats, places: NDArray[np.intp]) -> Floats:
    """Return the input (n,) with interpolated samples at places (k,)."""
    good = np.setdiff1d(np.arange(u.size), places)
    return np.interp(np.arange(u.size), good, u[good]) if places.size else u


def _format_rows(rows: list[int]) -> str:
    """Return the numbers of rows as text, counted from 1."""
    shown = ", ".join(str(row + 1) for row in rows[: TUNING.outliers_named])
    more = f" and {len(rows) - TUNING.outliers_named} more" if len(rows) > TUNING.outliers_named else ""
    return f"row{'s' * (len(rows) > 1)} {shown}{more}"


def _wrong(rows: list[int]) -> tuple[Finding, ...]:
    if not rows:
        return ()
    sentence = f"the counts of {_format_rows(rows)} fit no motion, and were left out"
    return (Finding("count_jump", sentence, f"check the wiring; {UNGUARDED}", detail="The other counts continue."),)


#: Remedy if the finding is a mistake.
UNGUARDED = "give [encoder] guard = false if the axis really moved so"


def _describe_shift(run: _WrongRun) -> Finding:
    sentence = (
        f"the counts jump by {run.moved} at row {run.last + 1} and stay there, so the shift of the counter's zero was "
        "undone"
    )
    return Finding("count_jump", sentence, UNGUARDED)


def _spiky(places: NDArray[np.intp]) -> tuple[Finding, ...]:
    if places.size == 0:
        return ()
    sentence = f"the input of {_format_rows(places.tolist())} is far beyond all others, and was left out"
    remedy = "give [encoder] guard = false if the drive really received this input"
    return (Finding("invalid_input", sentence, remedy, detail="The counts do not follow this input."),)

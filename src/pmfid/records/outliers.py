"""Correction of counters that wrap, and of wrong samples."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pmfid._stage import find_outliers
from pmfid.config.axis import Axis
from pmfid.estimators.plants import plant_of
from pmfid.estimators.stretches import parts_of
from pmfid.findings import Finding, Judged, texts
from pmfid.records.instants import MOST_INPUTS
from pmfid.records.record import Record
from pmfid.types import Counts, Flags, Floats

#: Largest change after unwrapping, relative to the range. `OUTLIERS_SMOOTHER` is the largest ratio of the roughness
#: after unwrapping to the roughness before.
OUTLIERS_ROOM = 0.25
OUTLIERS_SMOOTHER = 0.1
#: Largest relative difference between jumps of equal size.
OUTLIERS_ALIKE = 0.05
#: Largest relative difference between a range and a whole number of turns.
WHOLE_TURNS = 0.005
#: Largest width of a counter [bits]. `OUTLIERS_LEAST` is the smallest range of the counts, because within a smaller
#: range any motion may resemble a jump.
MOST_BITS = 32
OUTLIERS_LEAST = 8
#: Smallest ratio of a spike to the quantile 1 - `MOST_INPUTS` of the input. The input is no spike if the velocity
#: responds by more than a multiple of its usual change over `ANSWER_SAMPLES` samples. `OUTLIERS_USUAL` is the quantile
#: of the changes that counts as usual.
OUTLIERS_SPIKE = 50.0
OUTLIERS_ANSWER = 3.0
ANSWER_SAMPLES = 10
OUTLIERS_USUAL = 0.95
#: Number of rows that a sentence names.
OUTLIERS_NAMED = 4

#: Median of the size of a normal variable, in standard deviations.
NORMAL_MEDIAN = 0.6745


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
        whole = turns > 0 and abs(travel / (2 * math.pi * turns) - 1) < WHOLE_TURNS
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
        extent < OUTLIERS_LEAST or not np.any(jumps) or usual == 0
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
    return bool(alike and np.max(np.abs(undone)) <= OUTLIERS_ROOM * span and smooth <= OUTLIERS_SMOOTHER * rough)


def _spans(change: NDArray[np.int64], jumps: NDArray[np.bool_], usual: int, extent: int) -> list[int]:
    """Return the possible ranges of a counter, which are a power of two, and the jumps' size for periods such as a
    turn.
    """
    counter = 2 ** math.ceil(math.log2(extent + 1))
    sizes = np.abs(change[jumps])
    spans = [counter] if counter <= 2**MOST_BITS else []
    typical = round(float(np.median(sizes)) + float(np.median(np.abs(change[~jumps]))))
    return [*spans, max(typical, extent + 1)] if np.ptp(sizes) <= OUTLIERS_ALIKE * extent + 2 * usual else spans


@dataclass(frozen=True)
class RepairedRecord(Judged):
    """A record without the samples that no motion explains, and findings on these samples.

    `used` (n,) marks the counts that were measured and that no repair replaced. `shifted` (n,) marks the first count
    after each shift of the counter's zero.
    """

    record: Record
    used: Flags
    shifted: Flags
    findings: tuple[Finding, ...] = ()

    @property
    def sentence(self) -> str:
        """All findings as one sentence."""
        return "; ".join(texts(self.findings))


def repair_record(record: Record, max_speed: float | None = None) -> RepairedRecord:
    """Return the record without wrong counts, spikes of the input and shifts of a counter's zero.

    Wrong counts and spikes are interpolated, and shifts are reversed. `csrc/many/pmf_outliers.c` describes the rule. A
    counter that wraps remains unchanged. Readings beyond `max_speed` [unit of y per s] are always wrong.
    """
    counts, wrong, moved = _find_in_measured(record, _limit_of(record, max_speed))
    shifts = np.flatnonzero(moved)
    if shifts.size and wrap_of(record.counts) is not None:
        counts, wrong, shifts = record.counts, np.zeros_like(wrong), shifts[:0]
    rows = np.flatnonzero(wrong & (moved == 0)).tolist()
    spikes = _spikes(record.u, counts)
    undone = "and stay there, so the shift of the counter's zero was undone"
    first = shifts[:OUTLIERS_NAMED].tolist()
    jumps = (f"the counts jump by {int(moved[row])} at row {row + 1} {undone}" for row in first)
    named = (Finding("count_jump", text, UNGUARDED) for text in jumps)
    findings = (*_wrong(rows, _limit_of(record, max_speed) > 0), *named, *_spiky(spikes))
    if not findings:
        return _keep(record)
    used, shifted = _measured_in(record), np.zeros(record.counts.size, bool)
    used[rows], shifted[shifts] = False, True
    good = np.setdiff1d(np.arange(record.u.size), spikes)
    u = np.interp(np.arange(record.u.size), good, record.u[good]) if spikes.size else record.u
    return RepairedRecord(replace(record, u=u, counts=counts), used, shifted, findings)


def _keep(record: Record) -> RepairedRecord:
    return RepairedRecord(record, _measured_in(record), np.zeros(record.counts.size, bool))


def _measured_in(record: Record) -> Flags:
    return np.ones(record.counts.size, bool) if record.there is None else record.there.copy()


def _find_in_measured(record: Record, speed: float) -> tuple[Counts, Flags, Counts]:
    """Return the repaired counts (n,), a mask of the wrong ones, and the shifts of the zero at each sample.

    A missing count is no evidence. The function moves the values in a gap with the count before the gap. The motion is
    unknown in a gap of the input, so that each part between such gaps is judged alone.
    """
    places = np.arange(record.counts.size) if record.there is None else np.flatnonzero(record.there)
    wrong, moved, correction = np.zeros(record.counts.size, bool), np.zeros_like(record.counts), 0 * record.counts
    even, steps = np.arange(record.counts.size, dtype=np.float64), record.steps
    times = even if steps is None else np.cumsum(steps.before) / record.dt  # [sample periods]
    rounding = _rounding_of(record.counts[places])
    for part in parts_of(record.u):
        rows = places[slice(*np.searchsorted(places, (part.start, part.stop)))]
        repaired, wrong[rows], moved[rows] = find_outliers(record.counts[rows], times[rows], rounding, speed)
        correction[rows] = repaired - record.counts[rows] + np.cumsum(moved[rows])
    return record.counts - np.cumsum(moved) + correction, wrong, moved


def repair_as_configured(record: Record, axis: Axis) -> RepairedRecord:
    """Return the repaired record if the configuration has the guard on and the plant can be at rest."""
    rests = plant_of(axis.model.make().equation).rests
    if not (axis.encoder.guard and rests):
        return _keep(record)
    return repair_record(record, axis.encoder.make_encoder(record.resolution).max_speed)


def _limit_of(record: Record, max_speed: float | None) -> float:
    """Return the highest possible speed [counts per sample period], or 0 if it is unknown.

    A limit that most motion exceeds is a mistake, which the estimator names.
    """
    speed = (max_speed or 0.0) * record.dt / record.resolution
    changes = np.abs(np.diff(record.counts))
    moving = changes[changes > 0]
    return speed if moving.size and np.median(moving) <= speed + 1 else 0.0


def _rounding_of(counts: Counts) -> float:
    """Return the size of the counts' rounding error [counts], at least 1.

    An analogue sensor is noisier than its step. Fourth differences contain its noise, and hardly any motion. Their
    median ignores wrong counts. A uniform error of size s has the standard deviation s / sqrt(12).
    """
    noise = np.median(np.abs(np.diff(counts, 4))) / (NORMAL_MEDIAN * math.sqrt(70)) if counts.size > 4 else 0.0
    return max(1.0, math.sqrt(12) * float(noise))


def _spikes(u: Floats, counts: Counts) -> NDArray[np.intp]:
    """Return the samples of the input (n,) that are spikes, which the counts (n,) do not follow."""
    size = np.abs(np.nan_to_num(u))  # the input is unknown in a gap
    large = np.flatnonzero(size > OUTLIERS_SPIKE * np.quantile(size, 1 - MOST_INPUTS, method="lower"))
    if large.size == 0 or counts.size < 4 * ANSWER_SAMPLES:
        return large[:0]
    travelled = np.pad(counts.astype(np.float64), 2 * ANSWER_SAMPLES, mode="edge")
    half = ANSWER_SAMPLES
    answer = np.abs(travelled[2 * half :] - 2 * travelled[half:-half] + travelled[: -2 * half])[half:-half]
    moving = answer[answer > 0]
    usual = float(np.quantile(moving, OUTLIERS_USUAL)) if moving.size else 0.0
    return large[answer[large] <= OUTLIERS_ANSWER * usual]


def _format_rows(rows: list[int]) -> str:
    """Return the numbers of rows as text, counted from 1."""
    shown = ", ".join(str(row + 1) for row in rows[:OUTLIERS_NAMED])
    more = f" and {len(rows) - OUTLIERS_NAMED} more" if len(rows) > OUTLIERS_NAMED else ""
    return f"row{'s' * (len(rows) > 1)} {shown}{more}"


def _wrong(rows: list[int], limited: bool) -> tuple[Finding, ...]:
    if not rows:
        return ()
    check = "check the wiring and [encoder] max_speed" if limited else "check the wiring"
    sentence = f"the counts of {_format_rows(rows)} fit no motion, and were left out"
    return (Finding("count_jump", sentence, f"{check}; {UNGUARDED}", detail="The other counts continue."),)


#: Remedy if the finding is a mistake.
UNGUARDED = "give [encoder] guard = false if the axis really moved so"


def _spiky(places: NDArray[np.intp]) -> tuple[Finding, ...]:
    if places.size == 0:
        return ()
    sentence = f"the input of {_format_rows(places.tolist())} is far beyond all others, and was left out"
    remedy = "give [encoder] guard = false if the drive really received this input"
    return (Finding("invalid_input", sentence, remedy, detail="The counts do not follow this input."),)

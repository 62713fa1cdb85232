"""Segments of a history, and an estimate of each segment."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.configuration import like
from pmfid.estimators.fleet import Fleet
from pmfid.estimators.iv import IV, RIV
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.results import Tracks
from pmfid.estimators.stretches import parts_of
from pmfid.fleet.missing_forces import measure_forces
from pmfid.fleet.series import BACKWARD, FORWARD, ONE_SIZE, UNUSABLE
from pmfid.fleet.settings import Settings, quarter_of, record_at, recursive
from pmfid.fleet.tuning import TUNING
from pmfid.io.tables import Table
from pmfid.records.record import Record
from pmfid.status import Status
from pmfid.types import Counts, Flags, Floats


@dataclass(frozen=True)
class RecordPiece:
    """Rows of one axis and one hour without a gap.

    `start` is the time of the first sample [s]. `table` has the columns by their name in the data, with the time
    counted from the start.
    """

    axis: str
    start: float
    table: Table


@dataclass(frozen=True)
class Stretch:
    """Samples (n,) of one segment, without a gap.

    `samples` is their number in the record, including omitted rests. `lost` is the imputed part. `repeats` is
    the number of times that each of the n samples occurs. `group` is that of neighbours, one of which is searched for
    missing forces.
    `ages` (n,) are the ages of edges, if the data have them. `temperature` is the mean that friction follows, or NaN.
    """

    axis: str
    start: float
    end: float
    samples: int
    dt: float
    resolution: float
    u: Floats
    counts: Counts
    lost: float
    repeats: float
    group: tuple[str, float, int] = ("", 0.0, 0)
    ages: Floats | None = None
    temperature: float = math.nan


@dataclass(frozen=True)
class Share:
    """The samples of a segment by their numbers `places` (n,), repeated until they are `size` samples."""

    places: NDArray[np.intp]
    size: int

    @property
    def repeats(self) -> float:
        """Number of times that each sample is processed."""
        return self.size / self.places.size

    @property
    def rows(self) -> slice | NDArray[np.intp]:
        """The samples as a slice, if no sample lies between them, so that they need no copy."""
        first, end = int(self.places[0]), int(self.places[-1]) + 1
        return slice(first, end) if end - first == self.places.size else self.places

    def input(self, u: Floats) -> Floats:
        """Return the input (size,) of this share from the input (samples,) of the record."""
        own = u[self.rows]
        return own if own.size == self.size else np.resize(own, self.size)

    def counts(self, counts: Counts) -> Counts:
        """Return the counts (size,) of this share. Each repetition starts where the previous one ended."""
        own = counts[self.rows]
        if own.size == self.size:
            return own
        again = np.arange(self.size) // own.size
        return np.asarray(np.resize(own, self.size) + again * (own[-1] - own[0]))


def shares_of(counts: Counts, settled: int, quarter: int, span: int) -> Iterator[Share]:
    """Yield the shares of a part (n,) without a gap.

    `settled` is the number of samples in which the filters settle. `quarter` is the number of samples in a quarter of a
    whole segment. `span` is the largest distance in samples of motion in one segment.
    """
    edges = np.r_[0, np.flatnonzero(counts[1:] != counts[:-1]) + 1, counts.size]
    long = np.flatnonzero(np.diff(edges) > TUNING.segments_long * settled)
    if not long.size:
        yield from _share_samples(np.arange(counts.size), counts, 0, counts.size, settled, quarter)
        return
    kept = np.ones(counts.size, bool)
    for k in long:
        kept[edges[k] + settled : edges[k + 1] - settled] = False
    middles = (edges[long] + edges[long + 1]) // 2
    for low, high in _groups(np.r_[0, middles, counts.size], kept, TUNING.segments_whole * quarter, span):
        inside = np.flatnonzero(kept[low:high]) + low
        yield from _share_samples(inside, counts, low, high, settled, quarter)


def _groups(cuts: NDArray[np.intp], kept: Flags, enough: int, span: int) -> Iterator[tuple[int, int]]:
    """Yield groups between cuts (m,), each large enough for a segment, or limited by the span."""
    known = np.r_[0, np.cumsum(kept)]
    first = 0
    for k in range(1, cuts.size):
        last = k == cuts.size - 1
        full = known[cuts[k]] - known[cuts[first]] >= enough
        if last or full or cuts[k + 1] - cuts[first] > span:
            yield int(cuts[first]), int(cuts[k])
            first = k


def _share_samples(
    inside: NDArray[np.intp], counts: Counts, low: int, high: int, settled: int, quarter: int
) -> Iterator[Share]:
    """Yield the segments of a group from `low` to `high`. `inside` has the samples with information."""
    whole = TUNING.segments_whole * quarter
    rests = all(np.ptp(counts[part]) == 0 for part in (inside[:settled], inside[-settled:]))
    if inside.size >= whole or not rests:
        own = inside if inside.size >= quarter else np.arange(low, high)
        yield from (Share(own[part], part.stop - part.start) for part in _cut(own.size, quarter))
    elif np.ptp(counts[inside]) > 0 and inside.size >= TUNING.segments_between * settled:
        yield Share(inside, whole)
    elif high - low >= quarter:
        yield Share(np.arange(low, low + quarter), quarter)


def _cut(samples: int, quarter: int) -> list[slice]:
    """Return whole segments and the remainder. Each stretch has a whole number of quarters, so that many stretches have
    the same length.
    """
    size = TUNING.segments_whole * quarter
    found = [slice(start, start + size) for start in range(0, samples - size + 1, size)]
    start = len(found) * size
    rest = (samples - start) // quarter
    return (
        [*found, slice(start, start + rest * quarter)]
        if rest >= (TUNING.segments_rest if found else TUNING.segments_least)
        else found
    )


#: Estimates with one of these bits tell nothing of missing forces.
SEEN = UNUSABLE | int(Status.UNMODELLED | Status.FALLBACK | Status.DEAD_TIME)


def look_for_forces(
    stretches: Sequence[Stretch], theta: Floats, std: Floats, status: NDArray[np.uint32], settings: Settings
) -> list[list[float] | None]:
    """Return the missing forces of some stretches, and None for the others.

    The first good estimate of each group counts, from theta and std (m, p) and the status (m,). A list has the rows of
    `measure_forces` one after the other.
    """
    found: list[list[float] | None] = [None] * len(stretches)
    good = ((status & SEEN) == 0) & np.all(np.isfinite(std), axis=1)
    seen = set[tuple[str, float, int]]()
    for k in sorted(np.flatnonzero(good).tolist(), key=lambda k: (stretches[k].axis, stretches[k].start)):
        one = stretches[k]
        estimator = settings.adapt_estimator(one.dt, one.resolution)
        if one.group in seen or not isinstance(estimator, RIV):
            continue
        seen.add(one.group)
        u, counts, method = one.u[: TUNING.segments_most], one.counts[: TUNING.segments_most], like(IV, estimator)
        with np.errstate(all="ignore"):  # nothing is known of a motion beyond the range of numbers
            try:
                rows = measure_forces(u, counts, one.resolution, method, theta[k], one.repeats)
            except NotIdentifiableError:
                continue
        if np.all(np.isfinite(rows)) and np.all(rows[:, 1] > 0):
            found[k] = rows.ravel().tolist()
    return found


def settled_std(tracks: Tracks) -> Floats:
    """Return the standard deviations (n, p) at the end of the segments.

    The deviations are larger if the estimates still moved by more than chance explains. A biased start, or a change
    within the segment, is forgotten no faster than the samples.
    """
    std = tracks.theta_std[:, -1]
    moved = np.ptp(tracks.theta[:, _first_after(tracks, 4) :], axis=1)
    return np.asarray(np.hypot(std, np.maximum(moved - TUNING.segments_usual * std, 0.0)))


def lasting_status(tracks: Tracks) -> NDArray[np.uint32]:
    """Return the status (n,) at the end of the segments.

    The status includes UNMODELLED if a part of the second half had this bit. The verdict of the kernel concerns only
    the last motion.
    """
    off = (tracks.status[:, _first_after(tracks, 2) :] & Status.UNMODELLED) != 0
    wrong = np.mean(off, axis=1) >= TUNING.segments_off
    return np.asarray(tracks.status[:, -1] | np.where(wrong, Status.UNMODELLED, 0), np.uint32)


def evidence_gaps(u: Floats, counts: Counts) -> NDArray[np.uint32]:
    """Return status bits (n,) for effects that the inputs u and the counts (n, samples) cannot show."""
    there = counts[:, -1] - counts[:, 0]
    # One segment at a time fits into the processor's cache.
    travel = np.array([np.abs(np.diff(one)).sum() for one in counts])
    one_way = travel - np.abs(there) < 2 * TUNING.segments_back * travel
    way = np.where(one_way, np.where(there > 0, FORWARD, BACKWARD), 0)
    one_size = np.array([size.mean() > TUNING.segments_level * size.max() for size in map(np.abs, u)])
    return np.asarray(way | np.where(one_size, ONE_SIZE, 0), np.uint32)


def _first_after(tracks: Tracks, part: int) -> int:
    """Return the index of the first kept estimate after 1/part of the segment."""
    return (tracks.samples.size - 1) // part


def cut_stretches(piece: RecordPiece, settings: Settings) -> list[Stretch]:
    """Return the stretches of a piece. Raises UsageError for a piece that is no record, or too short for an
    estimate."""
    record = record_at(piece.table, settings.axis)
    quarter, settled = quarter_of(settings, record.dt), recursive(settings.estimator).settle_samples
    span = round(settings.span / record.dt)
    filled = None if record.there is None else ~record.there
    shares = (
        (whole.start, share)
        for whole in parts_of(record.u)
        for share in shares_of(record.counts[whole], settled, quarter, span)
    )
    found = [
        _stretch(piece, record, filled, first, share, k // TUNING.one_of) for k, (first, share) in enumerate(shares)
    ]
    if not found:
        raise UsageError(
            f"the longest stretch without a gap has {record.u.size} samples, too few: record at least "
            f"{quarter * record.dt:.3g} s without a gap"
        )
    return found


def _stretch(piece: RecordPiece, record: Record, filled: Flags | None, first: int, share: Share, group: int) -> Stretch:
    """Return a stretch whose share starts at the sample `first` of the record. `filled` marks the imputed samples."""
    begin, end = first + int(share.places[0]), first + int(share.places[-1]) + 1
    return Stretch(
        piece.axis,
        piece.start + begin * record.dt,
        piece.start + end * record.dt,
        end - begin,
        record.dt,
        record.resolution,
        share.input(record.u[first:]),
        share.counts(record.counts[first:]),
        0.0 if filled is None else float(filled[first:][share.rows].mean()),
        share.repeats,
        (piece.axis, piece.start, group),
        temperature=math.nan if record.temperature is None else float(record.temperature[first:][share.rows].mean()),
    )


def estimate_batch(
    stretches: Sequence[Stretch], estimator: RecursiveEstimator
) -> tuple[Floats, Floats, NDArray[np.uint32]]:
    """Return the parameters and their standard deviations (m, p), and the status (m,), of m stretches of one length."""
    u, counts = np.stack([one.u for one in stretches]), np.stack([one.counts for one in stretches])
    fleet = Fleet(estimator.start(), len(stretches), workers=1)
    tracks = fleet.run(u, counts, every=max(1, u.shape[1] // TUNING.segments_marks))
    theta = tracks.theta[:, -1]
    std = settled_std(tracks) * np.sqrt([[one.repeats] for one in stretches])
    return theta, std, lasting_status(tracks) | evidence_gaps(u, counts)

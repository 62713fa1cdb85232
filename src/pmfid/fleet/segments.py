"""Segments of a history, and an estimate of each segment."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pmfid._stage import bars
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.configuration import like
from pmfid.estimators.fleet import Fleet
from pmfid.estimators.iv import IV, RIV
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.redge import REdge
from pmfid.estimators.results import Tracks
from pmfid.estimators.stretches import parts_of
from pmfid.fleet.missing_forces import measure_forces
from pmfid.fleet.series import BACKWARD, FORWARD, ONE_SIZE, UNUSABLE
from pmfid.fleet.settings import Settings, quarter_of, record_at, recursive
from pmfid.fleet.tuning import TUNING
from pmfid.records.record import Record
from pmfid.status import Status
from pmfid.types import Counts, Flags, Floats


@dataclass(frozen=True)
class RecordPiece:
    """Rows of one axis and one hour without a gap.

    `start` is the time of the first sample [s]. `table` has the columns by their name in the data, with the time
    counted from the start.
    """

    start: float
    table: Mapping[str, Floats]


@dataclass(frozen=True)
class Stretch:
    """Samples (n,) of one segment, without a gap.

    `samples` is their number in the record, including omitted rests. `lost` is the imputed part. `repeats` is the
    number of times that each of the n samples occurs. `group` is that of neighbours, one of which is searched for
    missing forces. `temperature` is the mean that friction follows, or NaN. `ages` (n,) are the ages of edges, if the
    estimate uses them.
    """

    start: float
    end: float
    samples: int
    dt: float
    resolution: float
    u: Floats
    counts: Counts
    lost: float
    repeats: float
    group: tuple[float, int]
    temperature: float
    ages: Floats | None


@dataclass(frozen=True)
class Share:
    """The samples of a segment by their numbers `places` (n,), repeated until they are `size` samples."""

    places: NDArray[np.intp]
    size: int

    @property
    def repeats(self) -> float:
        """Number of times that each sample is processed."""
        return self.size / self.places.size

    def input(self, u: Floats) -> Floats:
        """Return the input (size,) of this share from the input (samples,) of the record."""
        return np.resize(u[self.places], self.size)

    def counts(self, counts: Counts) -> Counts:
        """Return the counts (size,) of this share. Each repetition starts where the previous one ended."""
        own = counts[self.places]
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
    enough = rest >= TUNING.segments_rest if found else rest > 0
    return [*found, slice(start, start + rest * quarter)] if enough else found


#: Estimates with one of these bits tell nothing of missing forces.
SEEN = UNUSABLE | int(Status.UNMODELLED | Status.FALLBACK | Status.DEAD_TIME)


@lru_cache(16)
def _make_search(estimator: RecursiveEstimator) -> IV:
    """Return the method that searches for missing forces. All axes share it, because its filters take long to make."""
    return like(IV, estimator)


def look_for_forces(
    stretches: Sequence[Stretch], theta: Floats, std: Floats, status: NDArray[np.uint32], settings: Settings
) -> list[list[float] | None]:
    """Return the missing forces of some stretches of an axis, and None for the others.

    The first good estimate of each group counts, from theta and std (m, p) and the status (m,). A list has the rows of
    `measure_forces` one after the other.
    """
    found: list[list[float] | None] = [None] * len(stretches)
    good = np.flatnonzero(((status & SEEN) == 0) & np.all(np.isfinite(std), axis=1)).tolist()
    seen = set[tuple[float, int]]()
    for k in sorted(good, key=lambda k: stretches[k].start):
        one = stretches[k]
        if one.group in seen or not isinstance(settings.estimator, RIV):
            continue
        seen.add(one.group)
        method = _make_search(recursive(settings.adapt_estimator(one.dt, one.resolution)))
        u, counts = one.u[: TUNING.segments_most], one.counts[: TUNING.segments_most]
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
    std, first = tracks.theta_std[:, -1], (tracks.samples.size - 1) // 4
    moved = np.ptp(tracks.theta[:, first:], axis=1)
    return np.asarray(np.hypot(std, np.maximum(moved - TUNING.segments_usual * std, 0.0)))


def lasting_status(status: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Return the status (n,) at the end of segments, from their status (n, times).

    The status includes UNMODELLED if a part of the second half had this bit. The verdict of the kernel concerns only
    the last motion.
    """
    off = (status[:, (status.shape[1] - 1) // 2 :] & Status.UNMODELLED) != 0
    wrong = np.mean(off, axis=1) >= TUNING.segments_off
    return np.asarray(status[:, -1] | np.where(wrong, Status.UNMODELLED, 0), np.uint32)


def evidence_gaps(u: Floats, counts: Counts) -> NDArray[np.uint32]:
    """Return status bits (n,) for effects that the inputs u and the counts (n, samples) cannot show."""
    there = counts[:, -1] - counts[:, 0]
    # One segment at a time fits into the processor's cache.
    travel = np.array([np.abs(np.diff(one)).sum() for one in counts])
    one_way = travel - np.abs(there) < 2 * TUNING.segments_back * travel
    way = np.where(one_way, np.where(there > 0, FORWARD, BACKWARD), 0)
    one_size = np.array([size.mean() > TUNING.segments_level * size.max() for size in map(np.abs, u)])
    return np.asarray(way | np.where(one_size, ONE_SIZE, 0), np.uint32)


def cut_stretches(piece: RecordPiece, settings: Settings) -> list[Stretch]:
    """Return the stretches of a piece. Raises UsageError for a piece that is no record, that is too short for an
    estimate, or whose ages of edges are unusable."""
    record = record_at(piece.table, settings.axis)
    quarter = quarter_of(settings, record.dt)
    if isinstance(settings.estimator, REdge):
        if record.ages is None:
            raise UsageError(record.notes[-1] if record.notes else "the ages of edges in this record cannot be used")
        n, least = record.u.size, TUNING.edges_least
        parts = _cut(n, quarter) or [slice(0, n)] if n >= least else []
        shares = [(0, Share(np.arange(part.start, part.stop), part.stop - part.start)) for part in parts]
    else:
        least, span = quarter, round(settings.span / record.dt)
        settled = recursive(settings.estimator).settle_samples
        shares = [
            (whole.start, share)
            for whole in parts_of(record.u)
            for share in shares_of(record.counts[whole], settled, quarter, span)
        ]
    if not shares:
        raise UsageError(
            f"the longest stretch without a gap has {record.u.size} samples, too few: record at least "
            f"{least * record.dt:.3g} s without a gap"
        )
    return [
        _stretch(piece, record, first, share, (piece.start, k // TUNING.one_of))
        for k, (first, share) in enumerate(shares)
    ]


def _stretch(piece: RecordPiece, record: Record, first: int, share: Share, group: tuple[float, int]) -> Stretch:
    """Return a stretch whose share starts at the sample `first` of the record."""
    begin, end = first + int(share.places[0]), first + int(share.places[-1]) + 1
    there, warm = record.there, record.temperature
    return Stretch(
        piece.start + begin * record.dt,
        piece.start + end * record.dt,
        end - begin,
        record.dt,
        record.resolution,
        share.input(record.u[first:]),
        share.counts(record.counts[first:]),
        0.0 if there is None else 1 - float(there[first:][share.places].mean()),
        share.repeats,
        group,
        math.nan if warm is None else float(warm[first:][share.places].mean()),
        None if record.ages is None else record.ages[first:][share.places],
    )


def estimate_batch(
    stretches: Sequence[Stretch], estimator: RecursiveEstimator | REdge
) -> tuple[Floats, Floats, NDArray[np.uint32]]:
    """Return the parameters and their standard deviations (m, p), and the status (m,), of m stretches of one length."""
    u, counts = np.stack([one.u for one in stretches]), np.stack([one.counts for one in stretches])
    if isinstance(estimator, REdge):
        theta, std, status = _estimate_edges(
            estimator, u, counts, np.stack([one.ages for one in stretches if one.ages is not None])
        )
    else:
        fleet = Fleet(estimator, len(stretches), workers=1)
        tracks = fleet.run(u, counts, every=max(1, u.shape[1] // TUNING.segments_marks))
        theta, status = tracks.theta[:, -1], lasting_status(tracks.status)
        std = settled_std(tracks) * np.sqrt([[one.repeats] for one in stretches])
    return theta, std, status | evidence_gaps(u, counts)


def _estimate_edges(
    estimator: REdge, u: Floats, counts: Counts, ages: Floats
) -> tuple[Floats, Floats, NDArray[np.uint32]]:
    """Return the same as `estimate_batch`, from inputs, counts and ages of edges (m, n)."""
    states = np.tile(np.frombuffer(estimator.kernel.raw_state(), np.uint8), (len(u), 1))
    theta, variance, _, known, status = estimator.kernel.run_many(states, u, counts, ages)
    last = np.ascontiguousarray(variance[:, -1])
    std = bars(last, np.ascontiguousarray(known[:, -1]), np.zeros_like(last))
    return theta[:, -1], std, lasting_status(status)

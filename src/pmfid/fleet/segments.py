"""Segments of a history, and an estimate of each segment."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from pmfid._stage import first_order
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.configuration import like
from pmfid.estimators.fleet import Fleet
from pmfid.estimators.iv import IV, RIV
from pmfid.estimators.least_squares import inverse_of, long_run_covariance
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.results import Tracks
from pmfid.estimators.stretches import parts_of
from pmfid.fleet.series import BACKWARD, FORWARD, LOOKED_AT, MOVED, ONE_SIZE, UNUSABLE
from pmfid.fleet.settings import Settings, quarter_of, record_at, recursive
from pmfid.fleet.tuning import TUNING
from pmfid.io.tables import Table
from pmfid.models.equation import VISCOUS_BACKWARD, VISCOUS_FORWARD, Equation
from pmfid.models.shapes import Square
from pmfid.records.record import Record
from pmfid.status import Status
from pmfid.types import Counts, Flags, Floats


@dataclass(frozen=True)
class RecordPiece:
    """Rows of one axis and one slice without a gap.

    `start` is the time of the first sample [s]. `table` has the columns by their name in the data, with the time
    counted from the start.
    """

    axis: str
    start: float
    table: Table


@dataclass(frozen=True)
class Stretch:
    """Samples (n,) of one segment, without a gap.

    `samples` is the slice of the record, including omitted rests. `lost` is the imputed part of the slice. `repeats` is
    the number of times that each of the n samples occurs. `looked_at` is true if the segment gets a second look.
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
    looked_at: bool = False
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


#: Estimates with one of these bits get no second look.
SEEN = UNUSABLE | int(Status.UNMODELLED | Status.FALLBACK | Status.DEAD_TIME)


def second_looks(
    stretches: Sequence[Stretch],
    estimator: RecursiveEstimator,
    theta: Floats,
    std: Floats,
    status: NDArray[np.uint32],
) -> NDArray[np.uint32]:
    """Return the status (m,) of stretches, with the results of a second look at some apparently good stretches.

    The estimates `theta` and their standard deviations `std` are (m, p).
    """
    if not isinstance(estimator, RIV):
        return status
    found, method = status.copy(), like(IV, estimator, prefilter_zeros=None)
    for k, stretch in enumerate(stretches):
        if stretch.looked_at and not status[k] & SEEN and np.all(np.isfinite(std[k])):
            found[k] |= LOOKED_AT | (MOVED if is_moved(stretch, method, theta[k], std[k]) else 0)
    return found


def is_moved(stretch: Stretch, method: IV, theta: Floats, std: Floats) -> bool:
    """Return whether unmodelled effects may move a parameter too far.

    The limit for theta (p,) comes from the standard deviation std (p,) and the tolerance.
    """
    allowed = np.maximum(TUNING.segments_noise * std, TUNING.segments_tolerance * np.abs(theta))
    with np.errstate(all="ignore"):  # nothing is known of a motion beyond the range of numbers
        try:
            moves = _moves(stretch, method, theta)
        except NotIdentifiableError:
            return False
    return bool(np.any(moves > allowed[:, None]))


def _moves(stretch: Stretch, method: IV, theta: Floats) -> Floats:
    """Return the change (p, k) of the parameters that each of k forces may cause."""
    u, counts = stretch.u[: TUNING.segments_most], stretch.counts[: TUNING.segments_most]
    columns = method.columns_at(theta, u, counts)
    speed = velocity(counts) * (stretch.resolution / stretch.dt)
    forces, plausible = _forces(method.equation, theta, speed, u)
    # Rows without gaps in memory take half of the time.
    filtered, phi, zeta = map(
        np.ascontiguousarray, (_filter_forces(forces, method)[:, columns.used], columns.phi.T, columns.zeta.T)
    )
    inverse = inverse_of(zeta @ phi.T)
    moves = -inverse @ (zeta @ filtered.T)
    score = filtered - np.linalg.lstsq(zeta @ zeta.T, zeta @ filtered.T)[0].T @ zeta
    scores = score * (columns.z - inverse @ (zeta @ columns.z) @ phi)
    information = np.sum(score * (filtered + moves.T @ phi), axis=1)
    variance = np.diagonal(long_run_covariance(scores.T, method.settle_samples)) * stretch.repeats
    size, size_std = scores.sum(axis=1) / information, np.sqrt(variance) / np.abs(information)
    asked = np.abs(size) > TUNING.segments_missed * size_std
    sizes = np.where(asked, np.abs(size), np.sqrt(believed_square(size, size_std, plausible)))
    return np.asarray(np.abs(moves) * sizes)


def _forces(equation: Equation, theta: Floats, speed: Floats, u: Floats) -> tuple[Floats, Floats]:
    """Return forces (k, n) per unit of their coefficients, and coefficients (k,) that a machine may plausibly have.

    The first force is an input that does not act in proportion. If the model has no nonlinear friction, the other force
    is friction that is not linear.
    """
    bent, usual = -equation.input_gain * u * np.abs(u) / _rms(u), _rms(speed[speed != 0])
    if any(isinstance(term.shape, Square) for term in equation.shaped):
        return bent[None], np.zeros(1)
    values = equation.role_values(theta)
    viscous = (values[VISCOUS_FORWARD] + values[VISCOUS_BACKWARD]) / 2
    return np.stack([bent, speed * np.abs(speed) / usual**2]), np.array([0.0, TUNING.segments_curved * viscous * usual])


def _filter_forces(forces: Floats, method: IV) -> Floats:
    """Return forces (k, n) after the filters of a method. Its columns come one sample later than the forces."""
    rate = 2 / method.dt
    pole, gain = (rate - method.cutoff) / (rate + method.cutoff), method.cutoff / (rate + method.cutoff)
    late = np.concatenate([np.zeros((forces.shape[0], 1)), forces[:, :-1]], axis=1)
    for stage in range(method.order):
        b = (0.0, 2 * gain) if stage == 0 else (gain, gain)
        late = np.array([first_order(row, pole, *b)[0] for row in late])
    return late


def _rms(signal: Floats) -> float:
    """Return the root mean square of a signal (n,)."""
    return float(np.sqrt(np.mean(signal**2)))


def velocity(counts: Counts) -> Floats:
    """Return counts per sample (n,), each averaged over the time of a few counts at the usual speed."""
    change = np.diff(counts, append=counts[-1]).astype(np.float64)
    width = 2 * math.ceil(TUNING.segments_counts / max(_rms(change), 1e-3) / 2) - 1
    if width < 3:
        return change
    total = np.cumsum(np.r_[np.zeros(width // 2 + 1), change, np.zeros(width // 2)])
    return np.asarray((total[width:] - total[:-width]) / width)


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
        _stretch(piece, record, filled, first, share, k % TUNING.one_of == 0) for k, (first, share) in enumerate(shares)
    ]
    if not found:
        raise UsageError(
            f"the longest stretch without a gap has {record.u.size} samples, too few: record at least "
            f"{quarter * record.dt:.3g} s without a gap"
        )
    return found


def _stretch(
    piece: RecordPiece, record: Record, filled: Flags | None, first: int, share: Share, looked_at: bool
) -> Stretch:
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
        looked_at,
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
    status = lasting_status(tracks) | evidence_gaps(u, counts)
    return theta, std, second_looks(stretches, estimator, theta, std, status)


def believed_square(size: Floats, std: Floats, plausible: Floats) -> Floats:
    """Return the mean squares (k,) of coefficients with estimates `size` (k,) and standard deviations `std` (k,).

    `plausible` (k,) is the usual size of each force. In a given machine, a force may also be absent.
    """
    prior, variance = plausible**2, std**2
    share = prior / (prior + variance)
    evidence = (np.log(variance / (prior + variance)) + share * (size / std) ** 2) / 2
    weight = expit(evidence + math.log(TUNING.segments_odds))
    return np.asarray(weight * (share * variance + (share * size) ** 2))

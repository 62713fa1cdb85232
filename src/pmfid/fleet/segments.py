"""Estimates of segments, many axes side by side: the heavy work of a history, and a function of the rows alone.

Each segment starts without a state, so its bits do not depend on other segments or axes. Errors of neighbouring
segments are independent, and a disturbance in one segment harms no other.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.bridges import parts_of
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.fleet.marks import MARKS, evidence_gaps, lasting_status, settled_std
from pmfid.fleet.rows import RecordPiece
from pmfid.fleet.second_look import second_looks
from pmfid.fleet.settings import Settings, quarter_of, record_at
from pmfid.fleet.shares import Share, shares_of
from pmfid.fleet.stretch import Stretch
from pmfid.fleet.survey import RowProblem
from pmfid.session.records import Record
from pmfid.types import Flags

if TYPE_CHECKING:
    import polars as pl

#: Samples of a batch at most [axes times samples].
BATCH = 2**22
#: One segment in ONE_OF of a piece has a second look.
ONE_OF = 16


@dataclass(frozen=True)
class Segments:
    """Estimates of segments and what could not be used.

    rows: axis, start and end [s], samples, dt [s], lost (part of the samples), status at the end, and each parameter
    with its standard deviation, in the order of axes and time.
    """

    rows: pl.DataFrame
    problems: tuple[RowProblem, ...]


def solve(pieces: Iterable[RecordPiece], settings: Settings) -> Segments:
    """The segments of pieces; what is no record is a problem of its axis."""
    import polars as pl

    problems = list[RowProblem]()
    groups: dict[tuple[float, float], list[Stretch]] = defaultdict(list)
    for piece in pieces:
        try:
            for stretch in _stretches(piece, settings):
                groups[stretch.dt, stretch.resolution].append(stretch)
        except (UsageError, NotIdentifiableError) as error:
            problems.append(RowProblem(piece.axis, "", "no_record", " ".join(str(error).split()), piece.start))
    frames = [empty(settings)]
    for (dt, resolution), stretches in groups.items():
        try:
            frames += _estimate_batches(stretches, settings.adapt_estimator(dt, resolution))
        except UsageError as error:
            reason = " ".join(str(error).split())
            problems += [RowProblem(one.axis, "", "no_estimate", reason, one.start) for one in stretches]
    return Segments(pl.concat(frames).sort("axis", "start"), tuple(problems))


def _stretches(piece: RecordPiece, settings: Settings) -> list[Stretch]:
    """Raises UsageError for a piece that is no record, or too short for an estimate."""
    record = record_at(piece.table, settings.axis)
    quarter, settled = quarter_of(settings, record.dt), settings.estimator.settle_samples
    span = round(settings.span / record.dt)
    filled = np.zeros(record.u.size, bool) if record.there is None else ~record.there
    shares = (
        (whole.start, share)
        for whole in parts_of(record.u)
        for share in shares_of(record.counts[whole], settled, quarter, span)
    )
    found = [_stretch(piece, record, filled, first, share, k % ONE_OF == 0) for k, (first, share) in enumerate(shares)]
    if not found:
        raise UsageError(
            f"{record.u.size} samples without a gap are too few: an estimate takes {quarter * record.dt:.3g} s of them"
        )
    return found


def _stretch(piece: RecordPiece, record: Record, filled: Flags, first: int, share: Share, looked_at: bool) -> Stretch:
    """first: sample of the record that the share counts from."""
    places = share.places + first
    begin, end = int(places[0]), int(places[-1]) + 1
    return Stretch(
        piece.axis,
        piece.start + begin * record.dt,
        piece.start + end * record.dt,
        end - begin,
        record.dt,
        record.resolution,
        share.input(record.u[first:]),
        share.counts(record.counts[first:]),
        float(filled[places].mean()),
        share.repeats,
        looked_at,
    )


def _estimate_batches(stretches: Sequence[Stretch], estimator: RecursiveEstimator) -> list[pl.DataFrame]:
    """Estimates of stretches, in batches of the same length."""
    groups: dict[int, list[Stretch]] = defaultdict(list)
    for one in stretches:
        groups[one.u.size].append(one)
    frames = []
    for size, group in groups.items():
        many = max(1, BATCH // size)
        frames += [_batch(group[start : start + many], estimator) for start in range(0, len(group), many)]
    return frames


def _batch(stretches: Sequence[Stretch], estimator: RecursiveEstimator) -> pl.DataFrame:
    import polars as pl

    u, counts = np.stack([one.u for one in stretches]), np.stack([one.counts for one in stretches])
    tracks = estimator.start().side_by_side(len(stretches), workers=1).run(u, counts, every=max(1, u.shape[1] // MARKS))
    theta = tracks.theta[:, -1]
    std = settled_std(tracks) * np.sqrt([[one.repeats] for one in stretches])
    columns: dict[str, object] = {
        "axis": [one.axis for one in stretches],
        "start": np.array([one.start for one in stretches]),
        "end": np.array([one.end for one in stretches]),
        "samples": np.array([one.samples for one in stretches]),
        "dt": np.array([one.dt for one in stretches]),
        "lost": np.array([one.lost for one in stretches]),
    }
    columns["status"] = second_looks(
        stretches, estimator, theta, std, lasting_status(tracks) | evidence_gaps(u, counts)
    )
    for i, name in enumerate(tracks.names):
        columns |= {name: theta[:, i], f"{name}_std": std[:, i]}
    return pl.DataFrame(columns)


def empty(settings: Settings) -> pl.DataFrame:
    """No segments, with their columns."""
    import polars as pl

    kinds: dict[str, type[pl.DataType]] = {"axis": pl.String, "start": pl.Float64, "end": pl.Float64}
    kinds |= {"samples": pl.Int64, "dt": pl.Float64, "lost": pl.Float64, "status": pl.UInt32}
    for name in settings.estimator.names:
        kinds |= {name: pl.Float64, f"{name}_std": pl.Float64}
    return pl.DataFrame(schema=kinds)

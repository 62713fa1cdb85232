"""Segments of a history with the ages of edges, and an estimate of each."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import polars as pl

from pmfid._stage import bars
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.redge import REdge
from pmfid.fleet.plan import RowProblem
from pmfid.fleet.segments import RecordPiece, Segments, empty, evidence_gaps
from pmfid.fleet.settings import Settings, record_at
from pmfid.fleet.tuning import TUNING
from pmfid.io.tables import column
from pmfid.records.record import Record
from pmfid.status import Status
from pmfid.types import Counts, Floats


@dataclass(frozen=True)
class EdgeStretch:
    """Samples u, counts and ages (n,) of one segment of an axis without a missing row. `start` is its time [s]."""

    axis: str
    start: float
    u: Floats
    counts: Counts
    ages: Floats


def solve_edges(pieces: Iterable[RecordPiece], settings: Settings) -> Segments:
    """Return the segments of pieces, each estimated on its own. A piece that is no record is a problem of its axis."""
    problems = list[RowProblem]()
    groups: dict[tuple[float, float, int], list[EdgeStretch]] = defaultdict(list)
    for piece in pieces:
        for whole in _split_at_missing_rows(piece, settings):
            try:
                record = record_at(whole.table, settings.axis)
                for stretch in _cut(whole, record, settings):
                    groups[record.dt, record.resolution, stretch.u.size].append(stretch)
            except (UsageError, NotIdentifiableError) as error:
                problems.append(RowProblem(piece.axis, "", "no_record", " ".join(str(error).split()), whole.start))
    frames = [empty(settings)]
    for (dt, resolution, size), group in groups.items():
        estimator = _adapt(settings, dt, resolution)
        many = max(1, TUNING.edges_batch // size)
        frames += [_estimate(group[first : first + many], estimator) for first in range(0, len(group), many)]
    return Segments(pl.concat(frames).sort("axis", "start"), tuple(problems))


def _split_at_missing_rows(piece: RecordPiece, settings: Settings) -> Iterator[RecordPiece]:
    """Yield the parts of a piece without a missing row, because a missing edge has no instant.

    A piece with too many of them has another clock, and stays whole.
    """
    name = settings.axis.record.time or ""
    time = column(piece.table, "time", name)
    steps = np.diff(time)
    apart = steps > TUNING.edges_apart * np.median(steps) if steps.size else steps > 0
    cuts = (np.flatnonzero(apart) + 1).tolist() if apart.size and apart.mean() <= TUNING.most_missing else []
    for low, high in zip([0, *cuts], [*cuts, time.size], strict=True):
        table = {key: np.asarray(values)[low:high] for key, values in piece.table.items()}
        yield replace(piece, start=piece.start + float(time[low]), table=table | {name: time[low:high] - time[low]})


def _cut(piece: RecordPiece, record: Record, settings: Settings) -> Iterator[EdgeStretch]:
    """Yield the segments of a record. Raises UsageError for a record that is too short, or whose ages are unusable."""
    if record.u.size < TUNING.edges_least:
        raise UsageError(
            f"the record has only {record.u.size} samples without a missing row; {TUNING.edges_least} are needed"
        )
    if record.ages is None:
        raise UsageError(record.notes[-1] if record.notes else "the ages of edges in this record cannot be used")
    size, n = max(1, round(settings.segment / record.dt)), record.u.size
    ends = list(range(size, n + 1, size)) or [n]
    if n - ends[-1] >= size / 2:
        ends.append(n)
    for first, end in zip([0, *ends[:-1]], ends, strict=True):
        samples = record.u[first:end], record.counts[first:end], record.ages[first:end]
        yield EdgeStretch(piece.axis, piece.start + first * record.dt, *samples)


def _adapt(settings: Settings, dt: float, resolution: float) -> REdge:
    """Return the estimator with another sample period [s] and resolution."""
    estimator = settings.estimator
    assert isinstance(estimator, REdge)
    return replace(estimator, dt=dt, encoder=replace(estimator.encoder, resolution=resolution))


def _estimate(stretches: Sequence[EdgeStretch], estimator: REdge) -> pl.DataFrame:
    """Return the estimates of stretches of one length."""
    u, counts, ages = (np.stack([getattr(one, name) for one in stretches]) for name in ("u", "counts", "ages"))
    start = np.frombuffer(estimator.kernel.raw_state(), np.uint8)
    states = np.tile(start, (len(stretches), 1))
    theta, variance, _, known, status = estimator.kernel.run_many(states, u, counts, ages)
    theta, last = theta[:, -1], np.ascontiguousarray(variance[:, -1])
    std = bars(last, np.ascontiguousarray(known[:, -1]), np.zeros_like(last))
    half = (status[:, u.shape[1] // 2 :] & Status.UNMODELLED) != 0
    often = np.where(np.mean(half, axis=1) >= TUNING.segments_off, int(Status.UNMODELLED), 0)
    size, first = u.shape[1], np.array([one.start for one in stretches])
    columns: dict[str, object] = {
        "axis": [one.axis for one in stretches],
        "start": first,
        "end": first + size * estimator.dt,
        "samples": np.full(len(stretches), size),
        "dt": np.full(len(stretches), estimator.dt),
        "lost": np.zeros(len(stretches)),
        "status": (status[:, -1] | often.astype(np.uint32) | evidence_gaps(u, counts)).astype(np.int64),
    }
    for i, name in enumerate(estimator.names):
        columns |= {name: theta[:, i], f"{name}_std": std[:, i]}
    return pl.DataFrame(columns)

"""Segments of a history with the ages of edges, and an estimate of each."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pmfid._stage import bars
from pmfid.errors import UsageError
from pmfid.estimators.redge import REdge
from pmfid.fleet.segments import RecordPiece, Stretch, evidence_gaps
from pmfid.fleet.settings import Settings, record_at
from pmfid.fleet.tuning import TUNING
from pmfid.io.tables import column
from pmfid.status import Status
from pmfid.types import Floats


def split_at_missing_rows(piece: RecordPiece, settings: Settings) -> Iterator[RecordPiece]:
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


def cut_edge_stretches(piece: RecordPiece, settings: Settings) -> Iterator[Stretch]:
    """Yield the stretches of a piece. Raises UsageError for a piece that is no record, that is too short, or whose ages
    are unusable."""
    record = record_at(piece.table, settings.axis)
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
        begin, dt, own = piece.start + first * record.dt, record.dt, slice(first, end)
        many, samples = end - first, (record.u[own], record.counts[own])
        facts = piece.axis, begin, begin + many * dt, many, dt, record.resolution
        warm = math.nan if record.temperature is None else float(record.temperature[own].mean())
        yield Stretch(*facts, *samples, 0.0, 1.0, ages=record.ages[own], temperature=warm)


def estimate_edge_batch(stretches: Sequence[Stretch], estimator: REdge) -> tuple[Floats, Floats, NDArray[np.uint32]]:
    """Return the parameters and their standard deviations (m, p), and the status (m,), of m stretches of one length."""
    u, counts, ages = (np.stack([getattr(one, name) for one in stretches]) for name in ("u", "counts", "ages"))
    start = np.frombuffer(estimator.kernel.raw_state(), np.uint8)
    states = np.tile(start, (len(stretches), 1))
    theta, variance, _, known, status = estimator.kernel.run_many(states, u, counts, ages)
    theta, last = theta[:, -1], np.ascontiguousarray(variance[:, -1])
    std = bars(last, np.ascontiguousarray(known[:, -1]), np.zeros_like(last))
    half = (status[:, u.shape[1] // 2 :] & Status.UNMODELLED) != 0
    often = np.where(np.mean(half, axis=1) >= TUNING.segments_off, int(Status.UNMODELLED), 0)
    return theta, std, status[:, -1] | often.astype(np.uint32) | evidence_gaps(u, counts)

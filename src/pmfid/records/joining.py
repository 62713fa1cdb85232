"""Several records as one record, and the longest part without a gap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pmfid.errors import UsageError
from pmfid.estimators.sample_steps import SampleSteps
from pmfid.records.clock import CLOCK_SAME_STEPS
from pmfid.records.gaps import GAPS_BRIDGED
from pmfid.records.record import Record
from pmfid.types import Counts, Flags, Floats


def join_records(records: Sequence[Record], place_matters: bool) -> Record:
    """Join the records, so that the counts of each record continue the counts of the previous record.

    The counter of a record may start anywhere. Raises UsageError for records with different sample periods, and for an
    axis with forces that depend on the position.
    """
    if len(records) == 1:
        return records[0]
    first = records[0]
    if place_matters:
        raise UsageError(
            "several records with unknown start positions make one estimate only if no force depends on the position; "
            "identify them one by one"
        )
    for record in records[1:]:
        if abs(record.dt / first.dt - 1) > CLOCK_SAME_STEPS:
            raise UsageError(
                f"{record.name} has a sample period of {record.dt:g} s, {first.name} one of {first.dt:g} s: identify "
                "them one by one"
            )
    parts = [_settle_part(first, 0, first=True)]
    for record in records[1:]:
        parts.append(_settle_part(record, int(parts[-1][1][-1]), first=False))
    u, counts, there, before = (np.concatenate(signal) for signal in zip(*parts, strict=True))
    steps = SampleSteps(before) if any(record.steps for record in records) else None
    joined = [f"{len(records)} records make one estimate: the motion of each starts separately"]
    if any(record.ages is not None for record in records):
        joined.append("the ages of edges are not used, because there are several records")
    notes = (*joined, *dict.fromkeys(f"{record.name}: {note}" for record in records for note in record.notes))
    name = ", ".join(record.name for record in records)
    return replace(first, u=u, counts=counts, there=there, notes=notes, name=name, steps=steps, ages=None)


def _settle_part(record: Record, start: int, *, first: bool) -> tuple[Floats, Counts, Flags, Floats]:
    """Return the input, the counts from `start` on, a mask of the measured samples, and the steps of one record.

    A gap precedes each record except the first.
    """
    there = np.ones(record.u.size, bool) if record.there is None else record.there
    before = np.full(record.u.size, record.dt) if record.steps is None else record.steps.before
    counts = record.counts - record.counts[0] + (record.counts[0] if first else start)
    if first:
        return record.u, counts, there, before
    apart = GAPS_BRIDGED + 1  # no line may bridge the records
    gap = np.full(apart, np.nan), np.full(apart, start), np.zeros(apart, bool)
    later = np.full(apart, record.dt)
    return np.r_[gap[0], record.u], np.r_[gap[1], counts], np.r_[gap[2], there], np.r_[later, before]


def unbroken(record: Record) -> Record:
    """Return the stretch of a record with a known input in which the counts (n,) change most often, with a note.

    A record without gaps is returned unchanged.
    """
    known = np.isfinite(record.u)
    edges = np.flatnonzero(np.diff(np.r_[0, known, 0]))
    if np.all(known) or edges.size == 0:
        return record
    pairs = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    first, last = max(
        pairs, key=lambda pair: (np.count_nonzero(np.diff(record.counts[slice(*pair)])), pair[1] - pair[0])
    )
    note = f"this method uses only the part without gaps that moves most: {last - first} of {record.u.size} samples"
    notes = (*record.notes, note)
    return replace(
        record,
        u=record.u[first:last],
        counts=record.counts[first:last],
        there=None if record.there is None else record.there[first:last],
        notes=notes,
        steps=None if record.steps is None else record.steps.part(first, last),
        ages=None,
    )


def make_even(record: Record) -> Record:
    """Return the record at even instants, for methods that need them, with the counts on lines between the samples.

    The input is its mean over each interval, so that no impulse is lost. A gap remains a gap.
    """
    if record.steps is None:
        return record
    times, first = record.times, record.counts[0]
    grid = np.arange(int(times[-1] / record.dt) + 1) * record.dt
    counts = np.rint(np.interp(grid, times, record.counts - first)).astype(np.int64) + first
    impulse = np.append(0.0, np.cumsum(np.nan_to_num(record.u[:-1]) * np.diff(times)))
    u = np.diff(np.interp(np.append(grid, grid[-1] + record.dt), times, impulse)) / record.dt
    row = np.searchsorted(times, grid, side="right") - 1
    u = np.where(np.isfinite(record.u[row]) & np.isfinite(record.u[np.minimum(row + 1, times.size - 1)]), u, np.nan)
    u[-1] = record.u[row[-1]]
    there = None if record.there is None else record.there[row] & np.isfinite(u)
    warm = None if record.temperature is None else np.interp(grid, times, record.temperature)
    return replace(record, u=u, counts=counts, there=there, steps=None, ages=None, temperature=warm)

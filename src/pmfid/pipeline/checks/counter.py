"""Checks for counters that repeat, wrap or miss counts."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pmfid.findings import Finding
from pmfid.pipeline.checks.view import CheckedLog, Stop
from pmfid.pipeline.guess.columns import IN_STEP
from pmfid.records.outliers import wrap_of

#: Limits for a column that changes only every k rows. `COUNTER_MOST` is the largest k, and `COUNTER_LEAST` is the
#: smallest number of changes. Among the rows that are multiples of k, at least the part `COUNTER_OFTEN` has a change.
COUNTER_MOST = 50
COUNTER_LEAST = 30
COUNTER_OFTEN = 0.3


def period_of(changes: NDArray[np.intp]) -> int:
    """Return the largest k for which the distances between the changes (m,) are multiples of k, or 1 if none exists.

    The array of changes holds the row number of each change. The distances of m random changes are all multiples of k
    with the probability k^(1 - m). A column with few changes may be in step by chance or by design. Therefore the
    function ignores a column of long steps.
    """
    if changes.size < COUNTER_LEAST:
        return 1
    rows = int(changes[-1] - changes[0]) + 1
    for k in range(COUNTER_MOST, 1, -1):
        step = np.bincount(changes % k, minlength=k).max()
        if step >= IN_STEP * changes.size and step >= COUNTER_OFTEN * rows / k:
            return k
    return 1


def forgotten_bits(log: CheckedLog) -> Iterator[Finding]:
    """Yield a finding if the counter still wraps, because its configured range is missing or too large."""
    wrap = wrap_of(log.record.counts) if log.axis.encoder.range is None else None
    if wrap is not None:
        config = log.axis.record
        sentence, remedy = wrap.describe_mistake(
            config.output, config.output_kind, log.record.resolution, log.axis.model.make().equation.motion.travel
        )
        yield Finding("wrapped", sentence, remedy, "wrong")


def held_output(log: CheckedLog) -> Iterator[Finding]:
    """Yield a finding if the counts are updated only every few samples."""
    every = period_of(np.flatnonzero(log.change))
    if every > 1:
        yield Finding(
            "held_output",
            f"the output column {log.axis.record.output!r} changes only at every {every}th row",
            f"keep every {every}th row, the first with a new value, or log the output at the record's rate",
            detail="The output is read more slowly than the record, so the motion seems to be late and to jump.",
        )


def find_frozen_counts(log: CheckedLog) -> Iterator[Finding]:
    """Yield a finding if the counts stop although the axis moves, at the end of their range or elsewhere."""
    counts, stops = log.record.counts, log.sudden_stops
    if not stops:
        return
    output = log.axis.record.output
    ends = [stop for stop in stops if counts[stop[0]] in (counts.min(), counts.max())]
    first = (ends or stops)[0]
    if ends:
        size = counts[first[0]] * (1 if log.axis.record.output_kind == "counts" else log.record.resolution)
        yield Finding(
            "clipped",
            f"the output column {output!r} stays at its limit {size:.6g} while the axis moves on, first in "
            f"{_rows(first)}",
            f"use rows {_format_free_rows(ends, counts.size)}, the longest part without this, or record within the "
            "range",
            detail=f"This happens {_times(ends)}. The range of the counter or sensor ends at this value.",
        )
        return
    yield Finding(
        "stuck",
        f"the output column {output!r} stands still while the axis moves on, first in {_rows(first)}",
        f"use rows {_format_free_rows(stops, counts.size)}, the longest part without this, and check the wiring",
        detail=f"This happens {_times(stops)}. The counter, or the program that reads it, was stuck.",
    )


def _rows(stop: Stop) -> str:
    return f"rows {stop[0] + 1} to {stop[1] + 1}"


def _times(stops: list[Stop]) -> str:
    return f"{len(stops)} time{'s' * (len(stops) > 1)}"


def _format_free_rows(stops: list[Stop], rows: int) -> str:
    """Return the longest range of rows without any of the stops, with 1 as the first row."""
    edges = [-1, *(edge for stop in stops for edge in stop), rows]
    first, last = max(zip(edges[::2], edges[1::2], strict=True), key=lambda pair: pair[1] - pair[0])
    return f"{first + 2} to {last}"

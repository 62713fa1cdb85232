"""Counts of an output: as they are logged, of a counter that wraps, or of a position in steps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pmfid.errors import UsageError
from pmfid.types import Counts, Floats

if TYPE_CHECKING:
    from pmfid.session.config import Axis

__all__ = ["DISTINCT", "MOST_WHOLE", "counts_of", "floor_counts", "unwrap_counts"]

# Beyond 2**53 neighbouring integers share one float64, and a count would be silently wrong.
_MAX_COUNT = 2.0**53
#: Rows that are tested for counts; whole numbers without exception, and more of them than this differ, are counts.
DISTINCT, MOST_WHOLE = 10_000, 20


def counts_of(output: Floats, axis: Axis) -> tuple[Counts, tuple[str, ...]]:
    """Counts (n,) of the output column (n,) [unit of y, or counts] as `axis` describes it, and notes for people. Raises
    UsageError for a column that is neither counts nor a position, and beyond 2**53 counts."""
    bits = axis.encoder.bits
    if axis.record.output_kind != "counts":
        if axis.record.output_kind == "position":
            _check_position(output, axis)
        # A position that is a multiple of the resolution in decimal often falls just below it in binary, and
        # a bare floor would lose a whole count: hence the tiny tolerance.
        counts = floor_counts(output, axis.encoder.resolution, 1e-6)
        return counts, ("bits is ignored, the output is a position",) if bits is not None else ()
    counts = _whole(output)
    return (counts, ()) if bits is None else _unwrap(counts, bits)


def _check_position(output: Floats, axis: Axis) -> None:
    """Refuses whole numbers as a position with a resolution below 1: such a column holds counts."""
    whole = np.array_equal(output, np.rint(output)) and np.unique(output[:DISTINCT]).size > MOST_WHOLE
    if whole and axis.encoder.resolution < 1 and axis.model.kind != "transfer_function":
        raise UsageError(
            f"the column {axis.record.output!r} has nothing but whole numbers, and is taken for a position in steps of "
            f'{axis.encoder.resolution:g}: give output_kind = "counts", or a resolution of 1 for a position in '
            "whole units"
        )


def _whole(output: Floats) -> Counts:
    rounded = np.rint(output)
    off = np.subtract(output, rounded)
    bad = np.flatnonzero((np.abs(off, out=off) > 1e-6) | (output >= _MAX_COUNT) | (output <= -_MAX_COUNT))
    del off  # of a long record it is a good part of the memory
    if len(bad):
        raise UsageError(
            f"counts must be integers below 2**53, got {output[bad[0]]:.9g} in row {bad[0] + 1}; "
            f'set output_kind = "position" if the column is a position, or export without a sign between thousands'
        )
    return rounded.astype(np.int64)


def floor_counts(y: Floats, step: float, tolerance: float) -> Counts:
    """Counts (n,) of a floor quantiser of a step, for positions y (n,), both in unit of y; tolerance: part of a step by
    which a position below an edge still belongs to it. Raises UsageError beyond 2**53 counts."""
    with np.errstate(over="ignore"):
        counts = np.floor(y / step + tolerance)
    bad = np.flatnonzero(np.abs(counts) >= _MAX_COUNT)
    if len(bad):
        raise UsageError(
            f"the position {y[bad[0]]:.9g} in row {bad[0] + 1} is more than 2**53 counts of {step:g}; "
            f"correct [encoder] resolution"
        )
    return counts.astype(np.int64)


def unwrap_counts(output: Floats, bits: int | None) -> Floats:
    """Counts (n,) as numbers, the wrap of a counter undone; missing ones stay missing."""
    if bits is None:
        return output
    unwrapped, there = output.copy(), np.isfinite(output)
    if np.any(there):
        unwrapped[there] = _unwrap(_whole(np.where(there, output, 0.0))[there], bits)[0]
    return unwrapped


def _unwrap(counts: Counts, bits: int) -> tuple[Counts, tuple[str, ...]]:
    """Undo the wrap of a counter of `bits` bits: every step is the shortest way round."""
    span = 2**bits
    raw = np.diff(counts)
    steps = (raw + span // 2) % span - span // 2
    wraps = int(np.count_nonzero(steps != raw))
    notes = [f"counter wrapped {wraps} time{'s' * (wraps != 1)} (undone)"] if wraps else []
    largest = int(np.max(np.abs(steps))) / span
    if largest > 0.25:
        notes.append(f"largest step is {largest:.0%} of the counter's range: from 50 % on, the wrap is ambiguous")
    return np.concatenate((counts[:1], counts[0] + np.cumsum(steps))), tuple(notes)

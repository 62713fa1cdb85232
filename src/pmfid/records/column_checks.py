"""Checks of the columns of a record: their lengths, kind and unit, and the rows that the user leaves out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from pmfid.config.record import RecordConfig
from pmfid.errors import UsageError
from pmfid.records.clock import LARGEST_NUMBER, MIN_SAMPLES, time_factor
from pmfid.types import COUNT_LIMIT, Counts, Flags, Floats
from pmfid.units import OUTPUTS, Quantity, column_unit

if TYPE_CHECKING:
    from pmfid.config.axis import Axis

#: Largest relative distance of a velocity from a multiple of a step, or of the step of a column from a resolution.
#: Logs have at least three digits. Differences of a column below `RECORD_ROUNDING` of its step come from its binary
#: rounding.
RECORD_WHOLE = 1e-3
RECORD_ROUNDING = 1e-6
#: Number of rows that are tested for steps and counts. A column holds counts if all tested numbers are whole and more
#: than `MOST_WHOLE` of them are distinct.
RECORD_DISTINCT = 20_000
MOST_WHOLE = 20


def check_position(output: Floats, axis: Axis) -> None:
    """Raise UsageError if a position with a resolution below 1 has only whole numbers, because such a column holds
    counts.
    """
    whole = np.array_equal(output, np.rint(output)) and np.unique(output[:RECORD_DISTINCT]).size > MOST_WHOLE
    named = axis.record.output_unit or column_unit(axis.record.output, OUTPUTS)
    if whole and not named and axis.encoder.resolution < 1 and axis.model.kind != "transfer_function":
        raise UsageError(
            f"the column {axis.record.output!r} has only whole numbers, and is read as a position in steps of "
            f'{axis.encoder.resolution:g}: give output_kind = "counts", or a resolution of 1 for a position in whole '
            "units"
        )


def check_counts(columns: Mapping[str, Floats], config: RecordConfig) -> None:
    """Raise UsageError for a column of counts that has fractions, and say so if the input has whole numbers instead."""
    there = np.isfinite(columns["output"])
    try:
        round_counts(columns["output"] if np.all(there) else columns["output"][there])
    except UsageError:
        u = columns["input"][np.isfinite(columns["input"])]
        if np.unique(u[:RECORD_DISTINCT]).size <= MOST_WHOLE or np.any(u != np.rint(u)):
            raise
        raise UsageError(
            f"the output column {config.output!r} has fractions, but the input column {config.input!r} has only "
            "whole numbers, like encoder counts: exchange input and output"
        ) from None


def check_step_unit(axis: Axis, output: Floats) -> None:
    """Raise UsageError for a position column without a unit whose steps are the number of a resolution with a unit."""
    step, config = axis.encoder.resolution, axis.record
    if not isinstance(step, Quantity) or step.unit.plain or step.unit.name not in OUTPUTS:
        return
    if config.output_kind != "position" or config.output_unit or column_unit(config.output, OUTPUTS):
        return
    steps, number = np.abs(np.diff(output[np.isfinite(output)])), float(step) / step.unit.factor
    least = float(np.min(steps[steps > RECORD_ROUNDING * number], initial=np.inf))
    if abs(least / number - 1) < RECORD_WHOLE:
        raise UsageError(
            f"the output column {config.output!r} seems to be in {step.unit.name}, because its steps are "
            f'{number:g}, as in [encoder] resolution: give [record] output_unit = "{step.unit.name}"'
        )


def round_counts(output: Floats) -> Counts:
    """Return counts (n,) as integers. Raises UsageError for fractions and beyond 2**53 counts."""
    rounded, most = np.rint(output), COUNT_LIMIT
    if np.array_equal(rounded, output) and -most < np.min(output, initial=0) and np.max(output, initial=0) < most:
        return rounded.astype(np.int64)
    off = np.subtract(output, rounded)
    bad = np.flatnonzero((np.abs(off, out=off) > 1e-6) | (output >= most) | (output <= -most))
    del off  # the mask of a long record takes much memory
    if len(bad):
        raise UsageError(
            f"counts must be integers below 2**53, got {output[bad[0]]:.9g} in row {bad[0] + 1}; "
            'set output_kind = "position" if the column is a position, or export without a thousands separator'
        )
    return rounded.astype(np.int64)


def check_lengths(columns: Mapping[str, Floats], keys: Mapping[str, str | None]) -> None:
    """Raise UsageError for columns that differ in length, and for too few samples."""
    lengths = {keys[key]: len(values) for key, values in columns.items()}
    if len(set(lengths.values())) > 1:
        raise UsageError(f"the columns differ in length: {lengths}; save them over the same samples")
    n = len(columns["input"])
    if n < MIN_SAMPLES:
        raise UsageError(f"the record has {n} sample{'s' * (n != 1)}, at least {MIN_SAMPLES} are needed; record longer")


def drop_extremes(values: Floats) -> Floats:
    """Return a column (n,) in which numbers beyond `LARGEST_NUMBER` are missing, as infinite numbers are.

    No sensor gives such numbers. They mark missing values, and their squares and differences overflow.
    """
    most = LARGEST_NUMBER
    if values.size == 0 or max(np.fmax.reduce(values), -np.fmin.reduce(values)) <= most:
        return values
    return np.where(np.abs(values) > most, np.nan, values)


def check_not_empty(label: str, values: Floats) -> None:
    """Raise UsageError for a column (n,) without a number."""
    if not (np.isfinite(values[0]) or np.any(np.isfinite(values))):
        raise UsageError(f"{label} is empty: missing, NaN or infinite in every row; name another column, or record it")


def left_out(
    time: Floats | None, samples: int, config: RecordConfig, mask: Floats | None
) -> tuple[Flags, tuple[str, ...]]:
    """Mark the rows (N,) that [record] mask and exclude leave out, and return notes for people.

    `mask` (N,) is the column that [record] mask names.
    """
    out, notes = np.zeros(samples, bool), []
    if mask is not None:
        out |= ~(mask == 0)
        notes.append(f"{np.count_nonzero(out)} rows are left out by the mask {config.mask!r}")
    if config.exclude:
        t = np.arange(samples) * (config.dt or 0.0) if time is None else time * time_factor(config)
        inside = np.zeros(samples, bool)
        for first, last in config.exclude:
            inside |= (t >= first) & (t <= last)
        notes.append(f"{np.count_nonzero(inside)} rows are left out by exclude")
        out |= inside
    return out, tuple(notes)

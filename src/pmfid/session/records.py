"""Records: read the input and the encoder counts from a file of any of the `formats`, and check them.

A record that leaves this module is evenly sampled and long enough to try; what stands in the place of samples that are
missing is said in `gaps`. Whether it moves enough to identify anything is not decided here. Rows in messages count from
1 at the first row of data.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pmfid.errors import UsageError
from pmfid.session.clock import named_unit, time_factor
from pmfid.session.config import NO_ENCODER
from pmfid.session.formats.reading import read_table
from pmfid.session.gaps.places import Laid, laid, left_out
from pmfid.session.gaps.standing import filled, missing_said
from pmfid.session.tables import Table, column, from_array, lookup, notes_of, times, unit_of, whole_name
from pmfid.transfer.experiment import Experiment
from pmfid.types import Counts, Flags, Floats

if TYPE_CHECKING:
    from pmfid.session.config import Axis, RecordConfig

__all__ = ["MIN_SAMPLES", "Record", "read_experiment", "read_record", "record_of"]

MIN_SAMPLES = 10
# Beyond 2**53 neighbouring integers share one float64, and a count would be silently wrong.
_MAX_COUNT = 2.0**53
#: Of so many rows, more than so many different whole numbers and nothing else are counts.
DISTINCT, MOST_WHOLE = 10_000, 20


@dataclass(frozen=True)
class Record:
    """One evenly sampled run of a drive.

    u: input, (n,), already scaled, NaN in gaps in which nobody knows it; counts: encoder counts, (n,), unwrapped; dt:
    sample period [s]; resolution: unit of y per count; notes: what was done to the data, for people; name: name of the
    file; there: (n,) the samples that were measured, None: all; for what stands in place of the others see
    `gaps`; doubt: (p,) by which part of themselves that may have moved parameters, None: nothing does.
    """

    u: Floats
    counts: Counts
    dt: float
    resolution: float
    notes: tuple[str, ...]
    name: str
    there: Flags | None = None
    doubt: Floats | None = None


def read_experiment(path: Path, axis: Axis) -> Experiment:
    """The record as it is, for a transfer function: any spacing, gaps, samples of the output that are missing (empty).

    Of output_kind = "counts" in units of the encoder's resolution. Raises UsageError naming the file and the remedy.
    """
    try:
        table = read_table(path)
        config, columns = _columns(axis.record, table)
        keys = {"input": config.input, "output": config.output, "time": config.time, "reference": config.reference}
        _check_lengths(columns, keys)
        scale, _ = _input_scale(table, config.input_scale)
        y, t = columns["output"], columns.get("time")
        t = None if t is None else t * _stated_factor(config)
        if config.output_kind == "counts":
            resolution = axis.encoder.resolution
            step = 1.0 if resolution == NO_ENCODER else resolution
            y = _scaled(_unwrapped(y, axis.encoder.bits) + 0.5, step, "[encoder] resolution")
        return Experiment(
            _scaled(columns["input"], scale),
            y,
            dt=config.dt if t is None else None,
            t=t,
            hold=config.hold,
            gap=config.gap,
            reference=columns.get("reference"),
            name=path.name,
        )
    except UsageError as error:
        raise UsageError(f"{path}: {' '.join(str(error).split())}") from None


def read_record(path: Path, axis: Axis, quantize: float | None = None) -> Record:
    """Read the record that `axis.record` describes from a file of one of the `formats`.

    With `quantize`, a step in unit of y, the position is counted anew by a coarser encoder of that step
    (floor quantiser, mean error -step/2). Raises UsageError naming the file, the column, the first bad row
    and the remedy. A constant input or a record without motion is not an error.
    """
    resolution = axis.encoder.resolution
    # written so that NaN fails too
    if quantize is not None and not resolution * (1 - 1e-9) <= quantize < np.inf:
        raise UsageError(
            f"quantize = {quantize:g} must be positive, finite and not finer than [encoder] resolution = "
            f"{resolution:g}; give a larger step"
        )
    try:
        return _build(read_table(path), axis, quantize, path.name)
    except UsageError as error:
        # one line, whatever the names in a damaged file contain
        raise UsageError(f"{path}: {' '.join(str(error).split())}") from None


def record_of(table: Table, axis: Axis, name: str = "record") -> Record:
    """The record in a table of columns that `axis.record` names. Raises UsageError as `read_record` does."""
    return _build(table, axis, None, name)


def _columns(config: RecordConfig, table: Table) -> tuple[RecordConfig, dict[str, Floats]]:
    """The columns that are named, and the configuration with the names that they have in the file, units and all, and
    with the unit of a time that is written as a date or a time of day."""
    names = {"input": config.input, "output": config.output, "time": config.time, "reference": config.reference}
    found = {key: whole_name(table, name) for key, name in names.items() if name is not None}
    columns = {key: column(table, key, name) for key, name in found.items() if key != "time"}
    changed: dict[str, str] = dict(found)
    if "time" in found:
        columns["time"], written = times(table, found["time"])
        if written and config.time_unit not in (None, "s"):
            raise UsageError(
                f"[record] time_unit = {config.time_unit!r}: the time column has dates or times of day; drop time_unit"
            )
        changed |= {"time_unit": "s"} if written else {}
    return config.model_copy(update=changed), columns


def _stated_factor(config: RecordConfig) -> float:
    """Seconds per unit of the time column of a transfer function, which may be slow or fast: a unit in the column's
    name is no more than a hint that one must be given."""
    unit = named_unit(config.time or "")
    if config.time_unit is None and unit not in (None, "s"):
        raise UsageError(
            f'[record] time = {config.time!r}: the name says {unit}; give [record] time_unit = "{unit}", or "s"'
        )
    return time_factor(config)


def _build(table: Table, axis: Axis, quantize: float | None, name: str) -> Record:
    config, columns = _columns(axis.record.model_copy(update={"reference": None}), table)
    keys = {"input": config.input, "output": config.output, "time": config.time}
    _check_lengths(columns, keys)
    for key, values in columns.items():
        _check_not_empty(f"{key} column {keys[key]!r}", values)
    scale, scale_notes = _input_scale(table, config.input_scale)
    rows, row_notes = _rows(table, config, columns)
    columns = {key: values[rows.rows] for key, values in columns.items()}
    counts, count_notes = _counts(columns["output"], axis)
    resolution = axis.encoder.resolution
    if quantize is not None:
        # y comes anew from the counts only where there is nothing better: a position is not floored twice
        y = columns["output"] if config.output_kind == "position" else counts.astype(np.float64) * resolution
        counts, resolution = _floor_counts(y, quantize, 1e-9), quantize
        count_notes += (f"position quantised anew with a step of {quantize:g}",)
    notes = notes_of(table) + _units_said(config) + scale_notes + row_notes + count_notes
    u = _scaled(columns["input"], scale)
    if rows.whole:
        return Record(u, counts, rows.dt, resolution, notes, name)
    u, counts, there = filled(u, counts, rows.places)
    return Record(u, counts, rows.dt, resolution, (*notes, missing_said(u, there)), name, there)


def _rows(table: Table, config: RecordConfig, columns: Mapping[str, Floats]) -> tuple[Laid, tuple[str, ...]]:
    """The rows that count, where they belong, and notes for people."""
    time, samples = columns.get("time"), columns["input"].size
    mask = None if config.mask is None else column(table, "mask", whole_name(table, config.mask))
    out, notes = left_out(time, samples, config, mask)
    signals = np.array([columns["input"], columns["output"]])
    repeated = np.r_[False, np.all(np.diff(signals, axis=1) == 0, axis=0)]
    rows = laid(time, ~out & np.all(np.isfinite(signals), axis=0), repeated, config)
    if rows.rows.size < MIN_SAMPLES:
        raise UsageError(
            f"{rows.rows.size} of {samples} rows have input and output and are not left out, at least "
            f"{MIN_SAMPLES} are needed; leave out less, or record longer"
        )
    return rows, (*notes, *rows.notes)


def _units_said(config: RecordConfig) -> tuple[str, ...]:
    """The units that the file itself gives for input and output, as rows of units and names have them."""
    found = {key: unit_of(name) for key, name in (("u", config.input), ("y", config.output))}
    said = " and ".join(f"{key} in {unit}" for key, unit in found.items() if unit)
    return (f"the file has {said}: input_gain and resolution must be for that",) if said else ()


def _check_lengths(columns: Mapping[str, Floats], keys: Mapping[str, str | None]) -> None:
    lengths = {keys[key]: len(values) for key, values in columns.items()}
    if len(set(lengths.values())) > 1:
        raise UsageError(f"the columns differ in length: {lengths}; save them over the same samples")
    n = len(columns["input"])
    if n < MIN_SAMPLES:
        raise UsageError(f"the record has {n} sample{'s' * (n != 1)}, at least {MIN_SAMPLES} are needed; record longer")


def _check_not_empty(label: str, values: Floats) -> None:
    if not np.any(np.isfinite(values)):
        raise UsageError(f"{label} is empty: missing, NaN or infinite in every row; name another column, or record it")


def _input_scale(table: Table, scale: float | str) -> tuple[float, tuple[str, ...]]:
    if not isinstance(scale, str):
        return scale, ()
    value = lookup(table, "input_scale", scale)
    if not isinstance(value, np.ndarray):
        raise UsageError(f"[record] input_scale = {scale!r} is a column and no scalar variable; give a number")
    array = from_array(f"[record] input_scale = {scale!r}", value)
    if array.size != 1 or not np.isfinite(array).all() or array.item() == 0:
        raise UsageError(
            f"[record] input_scale = {scale!r} is not a finite scalar other than zero (shape {array.shape}); "
            f"name a scalar variable, or give a number"
        )
    return array.item(), (f"input scaled by {scale} = {array.item():g}",)


def _scaled(column: Floats, scale: float, key: str = "[record] input_scale") -> Floats:
    with np.errstate(over="ignore"):  # looked at
        scaled = scale * column
    if np.any(np.isinf(scaled) & np.isfinite(column)):
        raise UsageError(
            f"{key} = {scale:g} takes the column beyond the range of numbers; it is a factor for every value of it"
        )
    return scaled


def _counts(output: Floats, axis: Axis) -> tuple[Counts, tuple[str, ...]]:
    bits = axis.encoder.bits
    if axis.record.output_kind == "position":
        _check_position(output, axis)
        # A position that is a multiple of the resolution in decimal often falls just below it in binary, and
        # a bare floor would lose a whole count: hence the tiny tolerance.
        counts = _floor_counts(output, axis.encoder.resolution, 1e-6)
        return counts, ("bits is ignored, the output is a position",) if bits is not None else ()
    counts = _whole(output)
    return (counts, ()) if bits is None else _unwrap(counts, bits)


def _check_position(output: Floats, axis: Axis) -> None:
    """Whole numbers of many steps each are counts, and no position with a resolution of a part of one."""
    whole = np.array_equal(output, np.rint(output)) and np.unique(output[:DISTINCT]).size > MOST_WHOLE
    if whole and axis.encoder.resolution < 1 and axis.model.kind != "transfer_function":
        raise UsageError(
            f"the column {axis.record.output!r} has nothing but whole numbers, and is taken for a position in steps of "
            f'{axis.encoder.resolution:g}: give output_kind = "counts", or a resolution of 1 for a position in '
            "whole units"
        )


def _whole(output: Floats) -> Counts:
    rounded = np.rint(output)
    bad = np.flatnonzero((np.abs(output - rounded) > 1e-6) | (np.abs(output) >= _MAX_COUNT))
    if len(bad):
        raise UsageError(
            f"counts must be integers below 2**53, got {output[bad[0]]:.9g} in row {bad[0] + 1}; "
            f'set output_kind = "position" if the column is a position, or export without a sign between thousands'
        )
    return rounded.astype(np.int64)


def _floor_counts(y: Floats, step: float, tolerance: float) -> Counts:
    with np.errstate(over="ignore"):
        counts = np.floor(y / step + tolerance)
    bad = np.flatnonzero(np.abs(counts) >= _MAX_COUNT)
    if len(bad):
        raise UsageError(
            f"the position {y[bad[0]]:.9g} in row {bad[0] + 1} is more than 2**53 counts of {step:g}; "
            f"correct [encoder] resolution"
        )
    return counts.astype(np.int64)


def _unwrapped(output: Floats, bits: int | None) -> Floats:
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

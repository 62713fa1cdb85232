"""Records: read the input and the encoder counts from a file of any of the `formats`, and check them.

A record that leaves this module is evenly sampled and long enough for an attempt; `gaps` describes how missing samples
are filled. Whether the motion suffices to identify anything is not decided here. Rows in messages count from 1 at the
first row of data.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pmfid.errors import UsageError
from pmfid.session.clock import named_unit, time_factor
from pmfid.session.conversion import Sections, conversion
from pmfid.session.counting import counts_of, floor_counts, unwrap_counts
from pmfid.session.formats.layout import Stated
from pmfid.session.formats.reading import read_table
from pmfid.session.formats.signals import ClockedSignals
from pmfid.session.gaps.places import PlacedRows, left_out, place_rows
from pmfid.session.gaps.standing import describe_missing, fill_gaps
from pmfid.session.record_config import NO_ENCODER, RecordConfig
from pmfid.session.tables import Table, column, from_array, lookup, notes_of, times, whole_name
from pmfid.session.travel import measure_travel
from pmfid.transfer.experiment import Experiment
from pmfid.types import Counts, Flags, Floats

if TYPE_CHECKING:
    from pmfid.session.config import Axis

__all__ = ["MIN_SAMPLES", "Record", "experiment_of", "read_experiment", "read_record", "record_of"]

MIN_SAMPLES = 10


@dataclass(frozen=True)
class Record:
    """One evenly sampled run of a drive.

    u: input, (n,), already scaled, NaN in gaps in which it is not known; counts: encoder counts, (n,), unwrapped; dt:
    sample period [s]; resolution: unit of y per count; notes: changes to the data, for people; name: name of the file;
    rotary: is the output an angle? there: (n,) the samples that were measured, None: all; `gaps` fills the others;
    doubt: (p,) relative error of parameters that filled samples may cause, None: no error.
    """

    u: Floats
    counts: Counts
    dt: float
    resolution: float
    notes: tuple[str, ...]
    name: str
    rotary: bool = False
    there: Flags | None = None
    doubt: Floats | None = None


def read_experiment(path: Path, axis: Axis) -> Experiment:
    """The record as it is, for a transfer function: any spacing, gaps, missing (empty) samples of the output.

    Counts are converted to travel. Raises UsageError naming the file and the remedy.
    """
    try:
        return experiment_of(read_table(path, Stated(axis.record.separator, axis.record.decimal)), axis, path.name)
    except UsageError as error:
        raise UsageError(f"{path}: {' '.join(str(error).split())}") from None


def experiment_of(table: Table, axis: Axis, name: str = "record") -> Experiment:
    """The experiment in a table of columns that `axis.record` names."""
    config, table, columns = _columns(axis.record, table)
    keys = {"input": config.input, "output": config.output, "time": config.time, "reference": config.reference}
    _check_lengths(columns, keys)
    scale, _ = _input_scale(table, config.input_scale)
    y, t = columns["output"], columns.get("time")
    t = None if t is None else t * _stated_factor(config)
    if config.output_kind == "counts":
        resolution = axis.encoder.resolution
        step = 1.0 if resolution == NO_ENCODER else resolution
        y = _scale_column(unwrap_counts(y, axis.encoder.bits) + 0.5, step, "[encoder] resolution")
    return Experiment(
        _scale_column(columns["input"], scale),
        y,
        dt=config.dt if t is None else None,
        t=t,
        hold=config.hold,
        gap=config.gap,
        reference=columns.get("reference"),
        name=name,
    )


def read_record(path: Path, axis: Axis, quantize: float | None = None) -> Record:
    """Read the record that `axis.record` describes from a file of one of the `formats`.

    With `quantize`, a step in unit of y, the position is quantised by a coarser encoder with that step
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
        return _build(read_table(path, Stated(axis.record.separator, axis.record.decimal)), axis, quantize, path.name)
    except UsageError as error:
        # one line, whatever the names in a damaged file contain
        raise UsageError(f"{path}: {' '.join(str(error).split())}") from None


def record_of(table: Table, axis: Axis, name: str = "record") -> Record:
    """The record in a table of columns that `axis.record` names. Raises UsageError as `read_record` does."""
    return _build(table, axis, None, name)


def _columns(config: RecordConfig, table: Table) -> tuple[RecordConfig, Table, dict[str, Floats]]:
    """The named columns, on one clock, and the configuration with the full names of the file. If the time column has
    dates or times of day, the configuration has its unit, too."""
    names = {"input": config.input, "output": config.output, "time": config.time, "reference": config.reference}
    found = {key: whole_name(table, name) for key, name in names.items() if name is not None}
    if isinstance(table, ClockedSignals):
        table = table.align(found["output"], tuple(found[key] for key in ("input", "reference") if key in found))
    columns = {key: column(table, key, name) for key, name in found.items() if key != "time"}
    changed: dict[str, str] = dict(found)
    if "time" in found:
        columns["time"], written = times(table, found["time"])
        if written and config.time_unit not in (None, "s"):
            raise UsageError(
                f"[record] time_unit = {config.time_unit!r}: the time column has dates or times of day; drop time_unit"
            )
        changed |= {"time_unit": "s"} if written else {}
    return config.model_copy(update=changed), table, columns


def _stated_factor(config: RecordConfig) -> float:
    """Seconds per unit of the time column of a transfer function. The process may be slow or fast, so a unit in the
    column's name is only a hint that the configuration must give one."""
    unit = named_unit(config.time or "")
    if config.time_unit is None and unit not in (None, "s"):
        raise UsageError(
            f'[record] time = {config.time!r}: the name says {unit}; give [record] time_unit = "{unit}", or "s"'
        )
    return time_factor(config)


def _build(table: Table, axis: Axis, quantize: float | None, name: str) -> Record:
    config, table, columns = _columns(axis.record.model_copy(update={"reference": None}), table)
    keys = {"input": config.input, "output": config.output, "time": config.time}
    _check_lengths(columns, keys)
    for key, values in columns.items():
        _check_not_empty(f"{key} column {keys[key]!r}", values)
    scale, scale_notes = _input_scale(table, config.input_scale)
    units = conversion(Sections(axis.record, axis.encoder, axis.model), config.input, config.output)
    rows, row_notes = _rows(table, config, columns)
    if rows.rows.size < len(columns["input"]):  # else a copy of each for nothing
        columns = {key: values[rows.rows] for key, values in columns.items()}
    columns.pop("time", None)
    y = _scale_column(columns["output"], units.y, "the unit of the output")
    travel, motion_notes = _measure_travel(y, rows, axis)
    counts, count_notes = counts_of(travel, axis)
    resolution = axis.encoder.resolution
    if quantize is not None:
        # y is computed from the counts only without a position, so that no position is floored twice
        y = travel if config.output_kind != "counts" else counts.astype(np.float64) * resolution
        counts, resolution = floor_counts(y, quantize, 1e-9), quantize
        count_notes += (f"position quantised again with a step of {quantize:g}",)
    if config.output_kind == "counts" and resolution == 1:
        count_notes += ("resolution is 1: lengths are in counts; give the travel of a count in [encoder]",)
    notes = notes_of(table) + units.notes + scale_notes + row_notes + motion_notes + count_notes
    u = _scale_column(columns["input"], scale * units.u)
    if rows.whole:
        return Record(u, counts, rows.dt, resolution, notes, name, units.kind == "rotary")
    u, counts, there = fill_gaps(u, counts, rows.places, bridged=config.output_kind != "velocity")
    return Record(
        u, counts, rows.dt, resolution, (*notes, describe_missing(u, there)), name, units.kind == "rotary", there
    )


def _measure_travel(y: Floats, rows: PlacedRows, axis: Axis) -> tuple[Floats, tuple[str, ...]]:
    """The travel (m,) of the used rows; a velocity is interpolated over missing rows."""
    if axis.record.output_kind != "velocity":
        return measure_travel(y, rows.dt, axis)
    whole, notes = measure_travel(np.interp(np.arange(rows.places[-1] + 1), rows.places, y), rows.dt, axis)
    return whole[rows.places], notes


def _rows(table: Table, config: RecordConfig, columns: Mapping[str, Floats]) -> tuple[PlacedRows, tuple[str, ...]]:
    """The used rows, their places on the grid, and notes for people."""
    time, samples = columns.get("time"), columns["input"].size
    mask = None if config.mask is None else column(table, "mask", whole_name(table, config.mask))
    out, notes = left_out(time, samples, config, mask)
    u, y = columns["input"], columns["output"]
    repeated = np.r_[False, (u[1:] == u[:-1]) & (y[1:] == y[:-1])]
    rows = place_rows(time, ~out & np.isfinite(u) & np.isfinite(y), repeated, config)
    if rows.rows.size < MIN_SAMPLES:
        raise UsageError(
            f"{rows.rows.size} of {samples} rows have input and output and are not left out, at least "
            f"{MIN_SAMPLES} are needed; leave out less, or record longer"
        )
    return rows, (*notes, *rows.notes)


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


def _scale_column(column: Floats, scale: float, key: str = "[record] input_scale") -> Floats:
    if scale == 1:  # no copy of a long record
        return column
    with np.errstate(over="ignore"):  # looked at
        scaled = scale * column
    if np.any(np.isinf(scaled) & np.isfinite(column)):
        raise UsageError(
            f"{key} = {scale:g} takes the column beyond the range of numbers; it is a factor for every value of it"
        )
    return scaled

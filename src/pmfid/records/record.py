"""A record with counts, input and time from the columns of a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pmfid.config.record import NO_ENCODER, RecordConfig, Sections, conversion
from pmfid.errors import UsageError
from pmfid.estimators.sample_steps import SampleSteps
from pmfid.io.csv_text import Stated
from pmfid.io.reading import read_table
from pmfid.io.tables import ClockedSignals, Table, column, from_array, lookup, notes_of, times, whole_name
from pmfid.linear.experiment import Experiment
from pmfid.records.clock import MIN_SAMPLES, PlacedRows, named_unit, place_rows, sample_period, time_factor
from pmfid.records.column_checks import (
    check_counts,
    check_lengths,
    check_not_empty,
    check_position,
    check_step_unit,
    drop_extremes,
    left_out,
    round_counts,
)
from pmfid.records.edge_ages import read_edge_ages
from pmfid.records.friction_column import read_slow_column
from pmfid.records.gaps import describe_missing, hold_input, place_samples
from pmfid.records.instants import Instants, find_instants, integrate_stamps
from pmfid.records.repeats import miss_stale_rows
from pmfid.records.topics import join_topics
from pmfid.records.travel import measure_travel
from pmfid.types import COUNT_LIMIT, Counts, Flags, Floats

if TYPE_CHECKING:
    from pmfid.config.axis import Axis


def counts_of(output: Floats, axis: Axis) -> tuple[Counts, tuple[str, ...]]:
    """Return the counts (n,) of the output column (n,) [unit of y, or counts] as `axis` describes it, and notes for
    people.

    Raises UsageError for a column that is neither counts nor a position, and beyond 2**53 counts.
    """
    bits = axis.encoder.bits
    if axis.record.output_kind != "counts":
        if axis.record.output_kind == "position":
            check_position(output, axis)
        counts = floor_counts(output, axis.encoder.resolution, 1e-6)
        return counts, ("bits is ignored, because the output is a position",) if bits is not None else ()
    counts = round_counts(output)
    return (counts, ()) if bits is None else _unwrap(counts, bits)


def floor_counts(y: Floats, step: float, tolerance: float) -> Counts:
    """Return the counts (n,) of a floor quantiser for positions y (n,), both in the unit of y.

    `tolerance` is the part of a step by which a position below an edge still belongs to the upper step. Positions that
    are counts already, rounded to a few decimals, get the edges that are farthest from them. Raises UsageError beyond
    2**53 counts.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        parts = y / step
        counts = np.floor(parts + (_edge_between(parts) or tolerance))
    bad = np.flatnonzero(np.abs(counts) >= COUNT_LIMIT)
    if len(bad):
        raise UsageError(
            f"the position {y[bad[0]]:.9g} in row {bad[0] + 1} is more than 2**53 counts of {step:g}; "
            f"correct [encoder] resolution"
        )
    return counts.astype(np.int64)


def _edge_between(parts: Floats) -> float | None:
    """Return the shift of positions (n,) [counts] by which all of them are farthest from whole numbers.

    The result is None unless the positions fill less than half of a count, as those of a count with rounding do.
    """
    finite = parts[np.abs(parts) < COUNT_LIMIT]
    bins = 64
    full = np.flatnonzero(np.bincount(((finite % 1.0) * bins).astype(np.intp) % bins, minlength=bins))
    if not full.size:
        return None
    gaps = np.diff(full, append=full[0] + bins)
    widest = int(np.argmax(gaps))
    if gaps[widest] <= bins // 2:
        return None
    return float(-((full[widest] + (gaps[widest] + 1) / 2) / bins) % 1.0)


def unwrap_counts(output: Floats, bits: int | None) -> Floats:
    """Return unwrapped counts (n,) as floats. Missing counts remain missing."""
    if bits is None:
        return output
    unwrapped, there = output.copy(), np.isfinite(output)
    if np.any(there):
        unwrapped[there] = _unwrap(round_counts(np.where(there, output, 0.0))[there], bits)[0]
    return unwrapped


def _unwrap(counts: Counts, bits: int) -> tuple[Counts, tuple[str, ...]]:
    """Unwrap a counter of `bits` bits, where every step takes the shortest way."""
    span = 2**bits
    raw = np.diff(counts)
    steps = (raw + span // 2) % span - span // 2
    notes = _describe_wraps(steps != raw)
    largest = int(np.max(np.abs(steps))) / span
    if largest > 0.25:
        notes.append(f"largest step is {largest:.0%} of the counter's range: from 50 % on, the wrap is ambiguous")
    return np.concatenate((counts[:1], counts[0] + np.cumsum(steps))), tuple(notes)


def _describe_wraps(wrapped: Flags) -> list[str]:
    wraps = int(np.count_nonzero(wrapped))
    return [f"counter wrapped {wraps} time{'s' * (wraps != 1)} (undone)"] if wraps else []


@dataclass(frozen=True)
class Record:
    """A run of a drive.

    `u` (n,) is the scaled input, with NaN where it is unknown. `counts` (n,) are the unwrapped encoder
    counts. `dt` is the sample period [s], and `resolution` is the unit of y per count. `notes` describe changes to the
    data. `name` is the name of the file. `rotary` says whether the output is an angle. `there` (n,) marks the measured
    outputs, or is None if all were measured. Other counts lie on a straight line. A record of an uneven clock has
    `steps`, the times between its samples, and its `jitter` is their root mean square deviation relative to the period.
    `drifts` says whether the period of the clock changes. `in_counts` says whether lengths are in counts, because the
    travel of a count is unknown.
    `ages` (n,) is the time from the last edge of the encoder to the sample [s], NaN without an edge, or None.
    `dt_error` is the relative standard error of the sample period, if the stamps scatter around an even grid.
    `input_unit` is the unit of u, or empty if neither column nor gain has one. `temperature` (n,) is the column that
    friction follows, in its unit, or None.
    """

    u: Floats
    counts: Counts
    dt: float
    resolution: float
    notes: tuple[str, ...]
    name: str
    rotary: bool = False
    there: Flags | None = None
    jitter: float = 0.0
    steps: SampleSteps | None = None
    drifts: bool = False
    in_counts: bool = False
    ages: Floats | None = None
    dt_error: float = 0.0
    input_unit: str = ""
    temperature: Floats | None = None

    @property
    def measured(self) -> Record:
        """The record in which each sample without a count is a gap."""
        if self.there is None:
            return self
        return replace(self, u=np.where(self.there, self.u, np.nan), there=None)

    @property
    def times(self) -> Floats:
        """The times (n,) of the samples [s], starting at 0."""
        if self.steps is None:
            return np.arange(self.u.size, dtype=np.float64) * self.dt
        return np.append(0.0, np.cumsum(self.steps.before[1:]))


def read_experiment(path: Path, axis: Axis) -> Experiment:
    """Read the unchanged record of a transfer function, with any spacing, gaps and missing (empty) outputs.

    The function converts counts to travel. Raises UsageError with the name of the file and the remedy.
    """
    try:
        return experiment_of(read_table(path, Stated(axis.record.separator, axis.record.decimal)), axis, path.name)
    except UsageError as error:
        raise UsageError(f"{path}: {' '.join(str(error).split())}") from None


def experiment_of(table: Table, axis: Axis, name: str = "record") -> Experiment:
    """Return the experiment in a table of columns that `axis.record` names."""
    config, table, columns = _columns(axis.record, table)
    keys = {"input": config.input, "output": config.output, "time": config.time, "reference": config.reference}
    check_lengths(columns, keys)
    scale, _ = _input_scale(table, config.input_scale)
    y, t = columns["output"], columns.get("time")
    t = None if t is None else t * _stated_factor(config)
    if config.output_kind == "counts":
        y = travel_of(y, axis)
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


def travel_of(counts: Floats, axis: Axis) -> Floats:
    """Return the middle (n,) of the step of each count, or NaN. Raises UsageError for fractions."""
    round_counts(counts[np.isfinite(counts)])
    step = 1.0 if axis.encoder.resolution == NO_ENCODER else axis.encoder.resolution
    return _scale_column(unwrap_counts(counts, axis.encoder.bits) + 0.5, step, "[encoder] resolution")


def read_record(path: Path, axis: Axis) -> Record:
    """Read the record that `axis.record` describes from a file of one of the `formats`.

    Raises UsageError with the file, the column, the first bad row and the remedy. A constant input or a record without
    motion is not an error.
    """
    try:
        return _build(read_table(path, Stated(axis.record.separator, axis.record.decimal)), axis, path.name)
    except UsageError as error:
        # The message has one line, even if names in a damaged file have several.
        raise UsageError(f"{path}: {' '.join(str(error).split())}") from None


def record_of(table: Table, axis: Axis, name: str = "record") -> Record:
    """Return the record in a table of columns that `axis.record` names. Raises UsageError as `read_record` does."""
    return _build(table, axis, name)


def _columns(config: RecordConfig, table: Table) -> tuple[RecordConfig, Table, dict[str, Floats]]:
    """Return the named columns on one clock, and the configuration with the full names of the file.

    If the time column has dates or times of day, the configuration also has its unit.
    """
    names = {"input": config.input, "output": config.output, "time": config.time, "reference": config.reference}
    found = {key: whole_name(table, name) for key, name in names.items() if name is not None}
    if isinstance(table, ClockedSignals):
        others = (*(found[key] for key in ("input", "reference") if key in found), *config.known_force)
        others += () if config.friction_temperature is None else (config.friction_temperature,)
        table = table.align(found["output"], others)
    columns = {key: drop_extremes(column(table, key, name)) for key, name in found.items() if key != "time"}
    changed: dict[str, str] = dict(found)
    if "time" in found:
        columns["time"], written = times(table, found["time"])
        columns["time"] = drop_extremes(columns["time"])
        if written and config.time_unit not in (None, "s"):
            raise UsageError(
                f"[record] time_unit = {config.time_unit!r}: the time column has dates or times of day; drop time_unit"
            )
        changed |= {"time_unit": "s"} if written else {}
    return config.model_copy(update=changed), table, columns


def _stated_factor(config: RecordConfig) -> float:
    """Return the seconds per unit of the time column of a transfer function.

    The process may be slow or fast. Therefore a unit in the column's name is only a hint that the configuration must
    confirm.
    """
    unit = named_unit(config.time or "")
    if config.time_unit is None and unit not in (None, "s"):
        raise UsageError(
            f'[record] time = {config.time!r}: the name says {unit}; give [record] time_unit = "{unit}", or "s"'
        )
    return time_factor(config)


def _build(table: Table, axis: Axis, name: str) -> Record:
    config, table, columns = _columns(axis.record.model_copy(update={"reference": None}), table)
    keys = {"input": config.input, "output": config.output, "time": config.time}
    check_lengths(columns, keys)
    for key, values in columns.items():
        check_not_empty(f"{key} column {keys[key]!r}", values)
    scale, scale_notes = _input_scale(table, config.input_scale)
    units = conversion(Sections(axis.record, axis.encoder, axis.model), config.input, config.output)
    columns["input"] = _subtract_known(table, axis, columns["input"], scale * units.u)
    warmth = axis.record.friction_temperature
    slow = None if warmth is None else read_slow_column(table, "friction_temperature", warmth, columns)
    columns, topic_notes = join_topics(columns)
    if config.output_kind == "counts":
        check_counts(columns, config)
    check_step_unit(axis, columns["output"])
    mask = None if config.mask is None else column(table, "mask", whole_name(table, config.mask))
    columns, found, clock_notes = _find_clock(axis, columns, units.y, mask)
    notes = notes_of(table) + topic_notes + units.notes + scale_notes + clock_notes
    u_scale = scale * units.u
    if found is not None:  # the rows to leave out are gaps now
        config, mask = config.model_copy(update={"mask": None, "exclude": ()}), None
    if found is None or found.even:
        record, stamps, rows = _place_on_grid(config, axis, columns, mask, found, (u_scale, units.y))
    else:
        record = _take_uneven(found, axis, (u_scale, units.y))
        stamps, rows = found.time, np.arange(record.u.size)
    lost = "" if record.there is None else "rows are missing"
    obstacle = lost if found is None else "the steps of the clock vary"
    ages, age_notes = read_edge_ages(table, axis.encoder, rows, obstacle)
    return replace(
        record,
        notes=notes + record.notes + age_notes,
        name=name,
        rotary=units.kind == "rotary",
        ages=ages,
        input_unit=units.input_unit,
        temperature=None if slow is None else slow.interpolate(stamps),
    )


def _place_on_grid(
    config: RecordConfig,
    axis: Axis,
    columns: dict[str, Floats],
    mask: Floats | None,
    clock: Instants | None,
    scales: tuple[float, float],
) -> tuple[Record, Floats, NDArray[np.intp]]:
    """Return the record of an even clock, the stamps (n,) of its samples, and the used rows.

    `scales` are the factors of input and output. `clock` is the even clock of late stamps.
    """
    rows, inputs, row_notes = _rows(config, columns, mask)
    if rows.rows.size < len(columns["input"]):  # without missing rows, a copy is needless
        columns = {key: values[rows.rows] for key, values in columns.items()}
    stamps = columns.get("time", rows.rows.astype(np.float64))
    stamps = stamps if rows.whole else np.interp(np.arange(rows.places[-1] + 1), rows.places, stamps)
    y = _scale_column(columns["output"], scales[1], "the unit of the output")
    travel, motion_notes = (y, ()) if clock is not None else _measure_travel(y, rows, axis)
    record = _count(_scale_column(columns["input"], scales[0]), travel, rows.dt, axis)
    notes = row_notes + motion_notes + record.notes
    if not rows.whole:
        inputs, bridged = _scale_column(inputs, scales[0]), config.output_kind != "velocity"
        u, counts, there = place_samples(record.u, record.counts, rows.places, inputs, bridged)
        notes = (*notes, describe_missing(u, there))
        record = replace(record, u=u, counts=counts, there=there)
    record = replace(record, notes=notes, dt_error=rows.dt_error)
    if clock is not None:
        record = replace(record, jitter=clock.jitter, drifts=clock.drifts, dt_error=clock.dt_error)
    return record, stamps, rows.rows


def _take_uneven(found: Instants, axis: Axis, scales: tuple[float, float]) -> Record:
    """Return the record at uneven instants. `scales` are the factors of input and output."""
    dt, notes = sample_period(found.period * np.arange(found.u.size) + found.time[0], axis.record)
    y = _scale_column(found.y, scales[1], "the unit of the output")
    record = _count(hold_input(_scale_column(found.u, scales[0]), found.time), y, dt, axis)
    steps = SampleSteps(np.append(dt, np.diff(found.time) * (dt / found.period)))
    there = None if np.all(found.there) else found.there
    notes += record.notes if there is None else (*record.notes, describe_missing(record.u, there))
    return replace(record, there=there, notes=notes, steps=steps, jitter=found.jitter, drifts=found.drifts)


def _count(u: Floats, travel: Floats, dt: float, axis: Axis) -> Record:
    """Return the record of an input u (n,) and a travel (n,)."""
    (counts, notes), resolution = counts_of(travel, axis), axis.encoder.resolution
    in_counts = axis.record.output_kind == "counts" and resolution == 1
    if in_counts:
        notes += ("resolution is 1: lengths are in counts; give the travel of a count in [encoder]",)
    return Record(u, counts, dt, resolution, notes, "", in_counts=in_counts)


def _find_clock(
    axis: Axis, columns: dict[str, Floats], y_scale: float, mask: Floats | None
) -> tuple[dict[str, Floats], Instants | None, tuple[str, ...]]:
    """Return the columns on an even clock, the samples of uneven stamps, and notes.

    The samples are None for even stamps. `y_scale` is the factor of the output. Rows that `mask` (n,) or [record]
    exclude leave out become gaps. The velocity of an uneven clock is integrated over its own steps. A record keeps its
    clock if its output has a range.
    """
    given, config, encoder = columns, axis.record, axis.encoder
    if "time" not in columns or encoder.range is not None:
        return columns, None, ()
    out, out_notes = left_out(columns["time"], columns["time"].size, config, mask)
    if np.any(out):
        columns = columns | {key: np.where(out, np.nan, columns[key]) for key in ("input", "output")}
    own = _integrate(axis, columns) if config.output_kind == "velocity" else _take_new(axis, columns, y_scale)
    if own is None:
        return given, None, ()
    columns, notes = own
    found = find_instants(columns["time"], columns["input"], columns["output"])
    if found is None:
        lost = np.isnan(columns["output"]) & ~out
        return given | {"output": np.where(lost, np.nan, given["output"])}, None, notes
    note = "the stamps scatter around an even grid like times of arrival, and the grid replaces them"
    if found.dt_error > 0:
        error = 100 * found.dt_error
        notes = (f"the period of the grid is known to {error:.1g} %; the intervals contain this error", *notes)
    if found.jitter:
        period = found.period * time_factor(config)
        note = f"the steps of the clock vary by {100 * found.jitter:.2g} %, around {period:.4g} s"
    if config.output_kind == "counts":
        apart = columns["output"] - given["output"]
        notes = (*notes, *_describe_wraps(np.diff(apart[np.isfinite(apart)]) != 0))
        found = replace(found, y=np.rint(found.y))
    columns = columns | {"time": found.time, "input": found.u, "output": found.y}
    return columns, found, (*out_notes, note, *notes)


def _integrate(axis: Axis, columns: dict[str, Floats]) -> tuple[dict[str, Floats], tuple[str, ...]] | None:
    """Return the columns with the integral of a velocity over the steps of its clock, and a note.

    The result is None for an even clock.
    """
    travel = integrate_stamps(columns["time"], columns["output"], columns["input"])
    if travel is None:
        return None
    note = "the velocity is integrated over the steps of the clock, along lines between samples"
    return columns | {"output": travel * time_factor(axis.record)}, (note,)


def _take_new(axis: Axis, columns: dict[str, Floats], y_scale: float) -> tuple[dict[str, Floats], tuple[str, ...]]:
    """Return the columns with an unwrapped counter and without old outputs, and notes."""
    config, encoder, notes = axis.record, axis.encoder, tuple[str, ...]()
    if config.output_kind == "position":
        check_position(columns["output"], axis)  # the check needs the values of the file
    if config.output_kind == "counts" and encoder.bits is not None:
        columns = columns | {"output": unwrap_counts(columns["output"], encoder.bits)}
    y, stale = miss_stale_rows(columns, 1.0 if config.output_kind == "counts" else encoder.resolution / y_scale)
    if stale:
        notes = (f"{stale / y.size:.0%} of the rows repeat the output of the row before: log only new values",)
    return columns | {"output": y}, notes


def _measure_travel(y: Floats, rows: PlacedRows, axis: Axis) -> tuple[Floats, tuple[str, ...]]:
    """Return the travel (m,) of the used rows. A velocity is interpolated over missing rows."""
    if axis.record.output_kind != "velocity":
        return measure_travel(y, rows.dt, axis)
    whole, notes = measure_travel(np.interp(np.arange(rows.places[-1] + 1), rows.places, y), rows.dt, axis)
    return whole[rows.places], notes


def _rows(
    config: RecordConfig, columns: Mapping[str, Floats], mask: Floats | None
) -> tuple[PlacedRows, Floats, tuple[str, ...]]:
    """Return the used rows with their places on the grid, the unscaled input (n,) of all rows, and notes for people."""
    time, samples = columns.get("time"), columns["input"].size
    out, notes = left_out(time, samples, config, mask)
    u, y = columns["input"], columns["output"]
    repeated = np.zeros(samples, bool)
    np.logical_and(u[1:] == u[:-1], y[1:] == y[:-1], out=repeated[1:])
    rows = place_rows(time, ~out & np.isfinite(u) & np.isfinite(y), repeated, config, y)
    if rows.rows.size < MIN_SAMPLES:
        raise UsageError(
            f"{rows.rows.size} of {samples} rows are usable, and at least {MIN_SAMPLES} are needed"
            f"; {np.sum(~np.isfinite(u))} rows lack a usable input, {np.sum(~np.isfinite(y))} a usable output, and "
            f"{np.sum(out)} are left out: correct these columns, or record longer"
        )
    return rows, rows.place_inputs(np.where(out, np.nan, u)), (*notes, *rows.notes)


def _input_scale(table: Table, scale: float | str) -> tuple[float, tuple[str, ...]]:
    if not isinstance(scale, str):
        return scale, ()
    value = lookup(table, "input_scale", scale)
    if not isinstance(value, np.ndarray):
        raise UsageError(f"[record] input_scale = {scale!r} is a column, not a scalar variable; give a number")
    array = from_array(f"[record] input_scale = {scale!r}", value)
    if array.size != 1 or not np.isfinite(array).all() or array.item() == 0:
        raise UsageError(
            f"[record] input_scale = {scale!r} is not a finite scalar other than zero (shape {array.shape}); "
            f"name a scalar variable, or give a number"
        )
    return array.item(), (f"input scaled by {scale} = {array.item():g}",)


def _subtract_known(table: Table, axis: Axis, u: Floats, scale: float) -> Floats:
    """Return the input column u (n,) without the input that supplies the known forces."""
    gain = axis.model.input_gain
    for name in axis.record.known_force:
        if not isinstance(gain, float):
            raise UsageError("[record] known_force needs an input_gain in N per unit of u; give [model] input_gain")
        force = column(table, "known_force", whole_name(table, name))
        if force.size != u.size:
            raise UsageError(f"the column {name!r} has {force.size} rows, the input {u.size}; save them together")
        u = u - force / (gain * scale)
    return u


def _scale_column(column: Floats, scale: float, key: str = "[record] input_scale") -> Floats:
    if scale == 1:  # a scale of 1 needs no copy
        return column
    with np.errstate(over="ignore"):  # checked below
        scaled = scale * column
    if np.any(np.isinf(scaled) & np.isfinite(column)):
        raise UsageError(
            f"{key} = {scale:g} multiplies the column beyond the range of floating-point numbers; correct this factor"
        )
    return scaled

"""The section [record] of AXIS.toml, and the conversion of its columns to SI units."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from pmfid.config.keys import OutputKind, Separator, TimeUnit
from pmfid.config.model import ModelConfig, Name, Positive, Travel
from pmfid.config.toml_file import FileSection
from pmfid.encoder import Encoder
from pmfid.errors import UsageError
from pmfid.linear.experiment import Hold
from pmfid.models.axes import AxisKind
from pmfid.units import INPUTS, OUTPUTS, SI, Quantity, Unit, column_unit, known_unit


def _usable_scale(value: float | str) -> float | str:
    if value in (0, ""):
        raise ValueError("it must be neither zero nor empty")
    return value


def _forward(value: tuple[float, float]) -> tuple[float, float]:
    if not value[0] < value[1]:
        raise ValueError("the first time must be before the second")
    return value


Span = Annotated[tuple[float, float], Field(strict=False), AfterValidator(_forward)]
OutputUnit = Annotated[str, AfterValidator(lambda text: known_unit(text, OUTPUTS))]
InputUnit = Annotated[str, AfterValidator(lambda text: known_unit(text, INPUTS))]

#: Resolution of an output without counts, which is finer than any encoder.
NO_ENCODER = 1e-29


class RecordConfig(FileSection):
    """[record]: the columns of the file with the input u, the output and the time [s]."""

    input: Name = Field(description="the name of the column that holds the input")
    output: Name = Field(description="the name of the column that holds the position or the counts")
    output_kind: OutputKind = Field("position", description="what the output column holds")
    input_unit: InputUnit | None = Field(
        None, description='the unit of the input, for example "mA", or drop the key if the column\'s name has it'
    )
    output_unit: OutputUnit | None = Field(
        None,
        description='the unit of the output, for example "mm" or "deg", or drop the key if the column\'s name has it',
    )
    separator: Separator | None = Field(
        None, description='the separator of a text file, for example ";", or drop the key to recognise it'
    )
    decimal: Literal[".", ","] | None = Field(
        None, description='the decimal sign, "." or ",", or drop the key to recognise it'
    )
    time: Name | None = Field(None, description="the name of the time column")
    time_unit: TimeUnit | None = Field(
        None, description="the unit of the time column, or drop the key if the column's name has it or the unit is s"
    )
    reference: Name | None = Field(
        None, description="the name of the column with the controller's reference, for a transfer function"
    )
    hold: Hold = Field("zoh", description='"zoh" if the input holds between samples, "foh" if it follows a line')
    gap: Positive | None = Field(None, description="the time step in s above which samples count as missing")
    exclude: tuple[Span, ...] = Field(
        (),
        strict=False,
        description="the parts to leave out, each with the times of its start and end in s: [[1.5, 2.0]]",
    )
    mask: Name | None = Field(
        None, description="the name of a column; rows in which this column is not zero are left out"
    )
    dt: Positive | None = Field(None, description="the sample period in s, for example 1e-3")
    input_scale: Annotated[float | str, AfterValidator(_usable_scale)] = Field(
        1.0,
        description="a factor, u = input_scale * column, or the name of a scalar variable in the file",
    )

    known_force: tuple[Name, ...] = Field(
        (),
        strict=False,
        description="the columns of known forces in N or torques in N m outside the model, for example "
        '["gravity_torque"]',
    )
    friction_temperature: Name | None = Field(
        None,
        description='the column of a temperature or a load that friction follows, for example "motor_temp", or drop '
        "the key if there is none",
    )

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.time is None and self.dt is None:
            raise ValueError("time and dt are both missing; give the time column, or dt in s, or both")
        if self.time is None and self.time_unit is not None:
            raise ValueError("time_unit needs a time column; name the column with time, or drop time_unit")
        if len({self.input, self.output, self.time}) < 3:
            raise ValueError("input, output and time must be different columns; correct the names")
        return self


class EncoderConfig(FileSection):
    """[encoder]: resolution in unit of y per count, and facts about the counter and the motion."""

    resolution: Travel = Field(
        description='the unit of y per count, for example 22.75e-6 (m, or rad if rotary), "0.01 deg" or "4096 '
        'counts/rev"'
    )
    range: Travel | None = Field(
        None,
        description='the travel after which the output wraps, for example "360 deg", or drop the key if it never wraps',
    )
    bits: int | None = Field(
        None,
        ge=1,
        le=32,
        description="the width of a counter that wraps at 2**bits, 1 to 32, or drop the key if it never wraps",
    )
    standstill_time: Positive = Field(0.2, description="the time in s without a new count that means standstill")
    max_speed: Travel | None = Field(
        None, description='the highest possible speed in the unit of y per s, or a text such as "3000 rpm"'
    )
    guard: bool = Field(True, description="true to leave out samples that no motion explains, false to keep them")
    edge_age: Name | None = Field(
        None, description="the column with the time from the last edge to the sample, empty without an edge"
    )
    lines: int | None = Field(
        None,
        ge=1,
        description="the counts after which the lines of the encoder repeat, for example 64 for a revolution",
    )
    tick: float = Field(0.0, ge=0, description="the period in s of the timer of edge_age, for example 1e-6")

    def make_encoder(self, resolution: float) -> Encoder:
        """Return the encoder of the estimators with steps of `resolution` [unit of y per count]."""
        return Encoder(resolution, standstill_time=self.standstill_time, max_speed=self.max_speed, guard=self.guard)


#: Kind of axis for each kind of quantity.
_KINDS: dict[str, AxisKind] = {
    "length": "linear",
    "speed": "linear",
    "angle": "rotary",
    "angular speed": "rotary",
}
_SPEEDS = ("speed", "angular speed")
#: Keys with lengths or angles, and keys with speeds.
_TRAVELS = (
    ("encoder", "resolution"),
    ("encoder", "range"),
    ("model", "cogging"),
    ("model", "friction_period"),
    ("model", "gravity"),
)
_RATES = (("encoder", "max_speed"), ("model", "stribeck"))


@dataclass(frozen=True)
class Sections:
    """The sections of AXIS.toml that have values with units."""

    record: RecordConfig
    encoder: EncoderConfig
    model: ModelConfig


@dataclass(frozen=True)
class Conversion:
    """Factors to SI of u and y.

    `kind` is the kind of the axis, or None if it is undetermined. `notes` are sentences for people. `input_unit` is the
    unit of u after the conversion, or empty if it is unknown.
    """

    u: float
    y: float
    kind: AxisKind | None
    notes: tuple[str, ...]
    input_unit: str


def conversion(axis: Sections, input_name: str, output_name: str) -> Conversion:
    """Return the conversion of the named columns in the file to SI.

    Raises UsageError for a unit that the configuration contradicts, and for a configured number whose unit is
    ambiguous.
    """
    own = {"input": column_unit(input_name, INPUTS), "output": column_unit(output_name, OUTPUTS)}
    if axis.model.kind != "drive":  # the user defines the units, which all numbers share
        columns = _say_units({key: unit.name for key, unit in own.items() if unit})
        notes = (f"{columns}: the results are in these units",) if columns else ()
        return Conversion(1.0, 1.0, None, notes, own["input"].name if own["input"] else "")
    y, u = _output_unit(axis, output_name), _input_unit(axis, input_name)
    kind = axis_kind(axis, y)
    units = {key: unit for key, unit in (("input", u), ("output", y)) if unit}
    converted = {key: f" (converted to {SI[unit.of]})" * (not unit.plain) for key, unit in units.items()}
    said = [_say_units({key: unit.name + converted[key] for key, unit in units.items()})]
    if axis.model.input_gain == axis.record.input_scale == 1.0 and (u is None or u.of not in ("force", "torque")):
        said.append(
            f"input_gain is 1, so forces are in the unit of {input_name!r}; for forces in N give [model] input_gain"
        )
    elif u is not None and u.of == "ratio" and u.name != "1" and type(axis.model.input_gain) is float:
        said.append(f"input_gain = {axis.model.input_gain:.9g} is per {u.name} of {input_name!r}")
    return Conversion(
        u.factor if u else 1.0, y.factor if y else 1.0, kind, tuple(filter(None, said)), _converted_unit(axis, u)
    )


def _converted_unit(axis: Sections, unit: Unit | None) -> str:
    """Return the unit of the converted input. Without a unit in the column, the gain may be per unit of input."""
    if unit is not None:
        return unit.name if unit.plain else SI[unit.of]
    gain = axis.model.input_gain
    return SI[gain.unit.of.partition("/")[2]] if isinstance(gain, Quantity) else ""


def axis_kind(axis: Sections, unit: Unit | None = None) -> AxisKind | None:
    """Return the kind of axis by the configuration and by a column in `unit`, or None if it is undetermined.

    Raises UsageError if configuration and column contradict each other.
    """
    evidence: dict[AxisKind, str] = {}
    for what, kind in _evidence(axis, unit):
        evidence.setdefault(kind, what)
    if len(evidence) > 1:
        raise UsageError(
            f"{evidence['rotary']} belongs to a rotary axis, but {evidence['linear']} to a linear one: correct one of "
            "the two units"
        )
    return next(iter(evidence), None)


def _evidence(axis: Sections, unit: Unit | None) -> Iterator[tuple[str, AxisKind]]:
    """Yield each fact that determines the kind of axis as text, with the kind."""
    if "axis" in axis.model.model_fields_set:
        yield f'[model] axis = "{axis.model.axis}"', axis.model.axis
    for section, key, value in _numbers(axis, (*_TRAVELS, *_RATES)):
        if isinstance(value, Quantity):
            yield f"[{section}] {key} in {value.unit.name}", _KINDS[value.unit.of]
    if isinstance(axis.model.input_gain, Quantity):
        name = axis.model.input_gain.unit.name
        yield f"[model] input_gain in {name}", "rotary" if name.partition("/")[0].endswith("N m") else "linear"
    if unit is None and axis.record.output_kind != "counts":
        unit = OUTPUTS.get(axis.record.output_unit or "") or column_unit(axis.record.output, OUTPUTS)
    if unit is not None:
        yield f"the output column {axis.record.output!r} in {unit.name}", _KINDS[unit.of]


def _numbers(axis: Sections, keys: tuple[tuple[str, str], ...]) -> Iterator[tuple[str, str, float]]:
    """Yield section, key and value of the keys whose values are numbers."""
    for section, key in keys:
        value = getattr(getattr(axis, section), key)
        if isinstance(value, float):
            yield section, key, value


def _choose_unit(key: str, given: str | None, name: str, table: dict[str, Unit]) -> Unit | None:
    """Return the configured unit, or the unit in the column's name, or None. Raises UsageError if the two units
    differ.
    """
    named, stated = column_unit(name, table), table.get(given or "")
    if named and stated and (named.of, named.factor) != (stated.of, stated.factor):
        raise UsageError(
            f'the name of the column {name!r} says {named.name}, but [record] {key} = "{given}": write {key} = '
            f'"{named.name}", or rename the column'
        )
    return stated or named


def _output_unit(axis: Sections, name: str) -> Unit | None:
    config = axis.record
    unit, kind = _choose_unit("output_unit", config.output_unit, name, OUTPUTS), config.output_kind
    if unit is None:
        return None
    fitting = "velocity" if unit.of in _SPEEDS else "position"
    if kind != fitting:
        raise UsageError(f'the output column {name!r} is in {unit.name}: give [record] output_kind = "{fitting}"')
    if not unit.plain:
        _check_written(axis, name, unit)
    return unit


def _check_written(axis: Sections, name: str, unit: Unit) -> None:
    """Raise UsageError for configured numbers without a unit if the output column is not in SI."""
    travel = unit.name.partition("/")[0] if unit.name != "rpm" else "rev"
    base = SI["angle" if _KINDS[unit.of] == "rotary" else "length"]
    ways = [(*found, travel, base) for found in _numbers(axis, _TRAVELS)]
    ways += [(*found, f"{travel}/s", f"{base}/s") for found in _numbers(axis, _RATES)]
    bare = [way for way in ways if not isinstance(way[2], Quantity)]
    if bare:
        written = "; ".join(
            f'[{section}] {key} = "{value:.9g} {own}" or "{value:.9g} {other}"'
            for section, key, value, own, other in bare
        )
        raise UsageError(
            f"the output column {name!r} is in {unit.name}, and a number without a unit may be in {unit.name} or in "
            f"{base}: write {written}"
        )


def _input_unit(axis: Sections, name: str) -> Unit | None:
    """Return the unit of the input. A configured scale replaces the unit in the column's name."""
    scaled = isinstance(axis.record.input_scale, str) or abs(axis.record.input_scale) != 1.0
    unit = _choose_unit("input_unit", axis.record.input_unit, "" if scaled else name, INPUTS)
    gain = axis.model.input_gain
    if unit is None or isinstance(gain, str) or gain is None:
        return unit
    if isinstance(gain, Quantity):
        force, per = gain.unit.name.split("/")
        if gain.unit.of.endswith(f"/{unit.of}"):
            return unit
        if per != "1":
            raise UsageError(
                f"the input column {name!r} is in {unit.name}, and [model] input_gain is per {per}: write it per "
                f"{_base(unit)}, or rename the column if its unit is {per}"
            )
    else:
        force = "N m" if axis.model.axis == "rotary" else "N"
        if unit.of == "ratio":  # no other unit is usual
            return replace(unit, factor=1.0)
    if not unit.plain:
        value = f"{gain / (gain.unit.factor if isinstance(gain, Quantity) else 1.0):.9g} {force}"
        raise UsageError(
            f"the input column {name!r} is in {unit.name}, and input_gain = {value} may be meant for {unit.name} or "
            f'for {SI[unit.of]}: write [model] input_gain = "{value}/{unit.name}" or "{value}/{SI[unit.of]}"'
        )
    return unit


def _base(unit: Unit) -> str:
    return unit.name if unit.of == "ratio" else SI[unit.of]


def _say_units(units: Mapping[str, str]) -> str:
    """Return a sentence on the units of input and output, or an empty text without units."""
    return ", ".join(f"the {column} is in {unit}" for column, unit in units.items())

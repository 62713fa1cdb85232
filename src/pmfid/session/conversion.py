"""From the units of a file's columns to SI, and the kind of axis that the units determine.

A unit comes from the configuration or from the column's name. A unit that the configuration contradicts is refused, and
so is a number of AXIS.toml that may be in either unit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from pmfid.errors import UsageError
from pmfid.models.axes import AxisKind
from pmfid.session.model_config import ModelConfig
from pmfid.session.record_config import EncoderConfig, RecordConfig
from pmfid.session.units import INPUTS, OUTPUTS, SI, Quantity, Unit, column_unit

__all__ = ["Conversion", "Sections", "axis_kind", "conversion"]

#: Kind of quantity -> kind of axis that has it.
_KINDS: dict[str, AxisKind] = {
    "length": "linear",
    "speed": "linear",
    "angle": "rotary",
    "angular speed": "rotary",
}
_SPEEDS = ("speed", "angular speed")
#: Keys with lengths or angles, and with speeds.
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
    """Factors to SI of u and y; kind: of axis, None if nothing determines it; notes: for people."""

    u: float
    y: float
    kind: AxisKind | None
    notes: tuple[str, ...]


def conversion(axis: Sections, input_name: str, output_name: str) -> Conversion:
    """The conversion of the columns with these names in the file to SI. Raises UsageError for a unit that the
    configuration contradicts, and for a configured number that may be in either of two units."""
    own = {"u": column_unit(input_name, INPUTS), "y": column_unit(output_name, OUTPUTS)}
    if axis.model.kind != "drive":  # its user says in which units it is, and everything else is in these
        columns = " and ".join(f"{key} in {unit.name}" for key, unit in own.items() if unit)
        notes = (f"the file has {columns}: the results are in these units",) if columns else ()
        return Conversion(1.0, 1.0, None, notes)
    y, u = _output_unit(axis, output_name), _input_unit(axis, input_name)
    kind = axis_kind(axis, y)
    named = [f"{key} in {_format_unit(unit)}" for key, unit in (("u", u), ("y", y)) if unit]
    notes = (f"the file has {' and '.join(named)}",) if named else ()
    return Conversion(u.factor if u else 1.0, y.factor if y else 1.0, kind, notes)


def axis_kind(axis: Sections, unit: Unit | None = None) -> AxisKind | None:
    """The kind of axis by the configuration and by a column in `unit`; None if nothing determines it. Raises UsageError
    if these contradict each other."""
    evidence: dict[AxisKind, str] = {}
    for what, kind in _evidence(axis, unit):
        evidence.setdefault(kind, what)
    if len(evidence) > 1:
        raise UsageError(
            f"{evidence['rotary']} is of a rotary axis, {evidence['linear']} of a linear one: correct the unit of one "
            "of them"
        )
    return next(iter(evidence), None)


def _evidence(axis: Sections, unit: Unit | None) -> Iterator[tuple[str, AxisKind]]:
    """Each fact that determines the kind of axis, for people, and the kind."""
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
    """Section, key and value of the keys whose values are numbers."""
    for section, key in keys:
        value = getattr(getattr(axis, section), key)
        if isinstance(value, float):
            yield section, key, value


def _choose_unit(key: str, given: str | None, name: str, table: dict[str, Unit]) -> Unit | None:
    """The configured unit, or the unit in the column's name; None without either. Raises UsageError if they differ."""
    named, stated = column_unit(name, table), table.get(given or "")
    if named and stated and (named.of, named.factor) != (stated.of, stated.factor):
        raise UsageError(
            f'the name of the column {name!r} says {named.name}, and [record] {key} = "{given}": write {key} = '
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
    """Raises UsageError for configured numbers without a unit if the output column is not in SI."""
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
    """The unit of the input. A configured scale replaces the unit in the column's name."""
    scaled = isinstance(axis.record.input_scale, str) or abs(axis.record.input_scale) != 1.0
    unit = _choose_unit("input_unit", axis.record.input_unit, "" if scaled else name, INPUTS)
    gain = axis.model.input_gain
    if unit is None or isinstance(gain, str) or gain is None:
        return unit
    if isinstance(gain, Quantity):
        of = gain.unit.of.partition("/")[2]
        if of not in (unit.of, "ratio"):
            raise UsageError(
                f"the input column {name!r} is in {unit.name}, and [model] input_gain is per {of}: write it per "
                f"{SI[unit.of]}"
            )
    elif not unit.plain:
        force = "N m" if axis.model.axis == "rotary" else "N"
        raise UsageError(
            f"the input column {name!r} is in {unit.name}, and input_gain = {gain:.9g} may be meant for that or for "
            f'{SI[unit.of]}: write [model] input_gain = "{gain:.9g} {force}/{unit.name}" or '
            f'"{gain:.9g} {force}/{SI[unit.of]}"'
        )
    return unit


def _format_unit(unit: Unit) -> str:
    return unit.name if unit.plain else f"{unit.name} (converted to {SI[unit.of]})"

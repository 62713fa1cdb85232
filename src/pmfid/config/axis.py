"""AXIS.toml with record, encoder, model and estimator, validated once and frozen.

The description of a field ends the error message about the field. Therefore a description must be a sensible text after
"give ...".
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from pmfid.config.keys import EstimatorKeys
from pmfid.config.model import ModelConfig, Name, Positive
from pmfid.config.record import NO_ENCODER, EncoderConfig, RecordConfig, Sections, axis_kind
from pmfid.config.toml_file import FileSection, load_sections, override_sections
from pmfid.errors import UsageError
from pmfid.estimators import Discretization, Method, Precision
from pmfid.estimators.facts import INPUT_GAIN, check_known
from pmfid.findings import NEGLIGIBLE
from pmfid.models.drive import POSITION_KEYS
from pmfid.models.equation import ESTIMATE
from pmfid.units import Quantity


def _distinct(value: tuple[float, float] | None) -> tuple[float, float] | None:
    if value is not None and value[0] == value[1]:
        raise ValueError("the two zeros must differ")
    return value


Negative = Annotated[float, Field(lt=0)]


class EstimatorConfig(FileSection):
    """[estimator]: method, filter chain (`cutoff` in rad/s, `order` stages) and memory."""

    method: Method = Field("auto", description="the estimation method")
    cutoff: Positive | None = Field(
        None,
        description="the pole of the filter chain in rad/s, for example 50.0, or drop the key to choose the pole from "
        "the record",
    )
    order: int = Field(2, ge=2, le=6, description="the number of filter stages, 2 to 6")
    forgetting: float = Field(
        1.0,
        gt=0,
        le=1,
        description="a factor in (0, 1]; for a memory of T seconds use 1 - dt/T, 1 never forgets",
    )
    given: dict[str, float] = Field({}, description="known values, such as { mass = 1.25 }")
    prior: dict[str, Annotated[tuple[float, float], Field(strict=False)]] = Field(
        {}, description="a mean and a standard deviation, such as { mass = [1.0, 0.1] }"
    )
    discretization: Discretization = Field("matched", description="the discretisation of the filters")
    # This type is not strict, because TOML has lists where a frozen object needs a tuple.
    prefilter_zeros: Annotated[tuple[Negative, Negative] | None, AfterValidator(_distinct)] = Field(
        None, strict=False, description="two different negative numbers in 1/s, for example [-30.0, -60.0]"
    )
    precision: Precision = Field("float64", description="the arithmetic of the kernel")
    tolerance: float = Field(
        NEGLIGIBLE,
        ge=0,
        lt=1,
        description="the largest negligible relative error of a parameter, for example 0.01",
    )

    @property
    def pole(self) -> float:
        """The cutoff [rad/s]. Raises UsageError if the cutoff is not known yet."""
        if self.cutoff is None:
            raise UsageError(
                "[estimator] cutoff is missing; give the pole of the filter chain in rad/s, or give "
                "pmfid export --record a record of the axis, from which the pole follows"
            )
        return self.cutoff


class MonitorConfig(FileSection):
    """[monitor]: the reference of `pmfid monitor`, and the allowed rate of false alarms."""

    reference: Name | None = Field(
        None, description='a record of normal work with the same columns, in the folder of AXIS.toml: "normal.csv"'
    )
    nominal: dict[str, float] | None = Field(
        None,
        description="the normal value of every parameter, { mass = 1.07, ... }, or drop the key to use the reference",
    )
    mtbf_hours: float = Field(
        24.0, ge=0.1, le=1e6, description="the mean time between false alarms in hours, for example 24.0"
    )
    tolerance: float = Field(
        0.02,
        ge=0,
        lt=1,
        description="the largest relative deviation that does not count as a change, for example 0.02 for 2 %",
    )


class VisitSections(FileSection):
    """The sections that a table of estimates needs in place of a record."""

    monitor: MonitorConfig = Field(MonitorConfig(), description="a section with the tolerance")


#: Section, key, and whether the key belongs to a transfer function. Keys of no transfer function belong to a machine
#: with friction.
_KEYS_OF_ONE_KIND = (
    ("record", "gap", True),
    ("record", "hold", True),
    ("record", "reference", True),
    ("record", "input_unit", False),
    ("record", "output_unit", False),
    ("record", "known_force", False),
    ("record", "friction_temperature", False),
    ("encoder", "range", False),
    ("encoder", "standstill_time", False),
    ("encoder", "max_speed", False),
    ("estimator", "tolerance", False),
)
#: Alternatives for a key that the model does not use.
_CURE = {
    "gap": ", and cut the record at the gap",
    "hold": ", because the input of an axis holds between samples",
}


class Axis(FileSection):
    """One axis of motion, as AXIS.toml describes it."""

    record: RecordConfig = Field(description="a section that names the columns input, output and time")
    encoder: EncoderConfig = Field(description="a section with at least the resolution")
    model: ModelConfig = Field(description="a section with at least the input_gain")
    estimator: EstimatorConfig = Field(EstimatorConfig(), description="a section with method, cutoff and memory")
    monitor: MonitorConfig = Field(MonitorConfig(), description="a section that names the reference")

    @model_validator(mode="after")
    def _refuse_unused(self) -> Self:
        """Refuse a key that the model does not use, so that every given key has an effect."""
        kind, sections = self.model.kind, {"record": self.record, "encoder": self.encoder, "estimator": self.estimator}
        for section, key, of_process in _KEYS_OF_ONE_KIND:
            part = sections[section]
            value = getattr(part, key)
            if value != type(part).model_fields[key].default and of_process != (kind == "transfer_function"):
                cure = f"drop it{_CURE.get(key, '')}"
                raise UsageError(f'[{section}] {key} = {value!r} is not used with kind = "{kind}"; {cure}')
        self._check_units()
        self._check_known()
        return self

    def _check_units(self) -> None:
        """Derive the kind of axis from units, and refuse terms of the position if the output is a velocity."""
        if self.model.kind != "drive":
            if self.record.output_kind == "velocity":
                raise UsageError('output_kind = "velocity" needs kind = "drive"; set it, or integrate the column')
            return
        step = self.encoder.resolution
        if self.record.output_kind == "counts" and step >= 16.0 and not isinstance(step, Quantity):
            raise UsageError(
                f"[encoder] resolution = {step:g} would be {step:g} m or rad per count; if these are counts per "
                f'revolution, write resolution = "{step:g} counts/rev"'
            )
        places = [key for key in POSITION_KEYS if getattr(self.model, key)]
        if self.record.output_kind == "velocity" and places:
            raise UsageError(
                f"a velocity does not determine the position: drop {', '.join(places)}, or record the position"
            )
        if axis_kind(Sections(self.record, self.encoder, self.model)) == "rotary":
            object.__setattr__(self, "model", self.model.model_copy(update={"axis": "rotary"}))

    def _check_known(self) -> None:
        """Refuse prior information on parameters that the model does not have."""
        given, prior, find = self.estimator.given, self.estimator.prior, self.model.input_gain == ESTIMATE
        if self.model.kind == "transfer_function" and (given or prior):
            raise UsageError("[estimator] given and prior belong to machines; for a transfer function drop them")
        if given or prior or find:
            equation = self.model.make().equation
            names = (*equation.names, *(name for name, _ in equation.further), *([INPUT_GAIN] if find else []))
            check_known(equation, given, prior, names, find)


def load_axis(path: Path, overrides: Mapping[str, object] | None = None) -> Axis:
    """Read and validate an AXIS.toml.

    The dotted keys of `overrides`, such as {"estimator.cutoff": 50.0}, replace the file's values. An override of None
    has no effect. Raises UsageError with all problems if the file cannot be read or a value is not allowed.
    """
    return load_sections(Axis, path, overrides, "an AXIS.toml (pmfid init LOG writes it)", _add_unit_encoder)


#: The sections of an AXIS.toml as a dict, each a dict of its keys.
AxisSections = Mapping[str, object]


def read_axis(axis: Axis | AxisSections | Path | str, settings: EstimatorKeys | None = None) -> Axis:
    """Return the configuration in an AXIS.toml, in a dict with its sections, or in an object.

    The keys of `settings` replace those of [estimator]; a key with the value None has no effect. Raises UsageError
    with all problems if the file cannot be read or a value is not allowed.
    """
    overrides = {f"estimator.{key}": value for key, value in (settings or {}).items()}
    if isinstance(axis, str | Path):
        return load_axis(Path(axis), overrides)
    if isinstance(axis, Axis):
        if not overrides:
            return axis
        raw: dict[str, object] = {
            name: {key: getattr(section, key) for key in section.model_fields_set} for name, section in axis
        }
    elif isinstance(axis, Mapping):
        raw = {name: dict(part) if isinstance(part, Mapping) else part for name, part in axis.items()}
        _add_unit_encoder(raw)
    else:
        raise UsageError(
            "axis must be the path of an AXIS.toml or a dict with its sections, got "
            f"{type(axis).__name__}; give one of them"
        )
    return override_sections(Axis, raw, overrides)


def _add_unit_encoder(raw: dict[str, object]) -> None:
    """Add [encoder] for a transfer function, which needs no encoder.

    An unknown kind of model also gets the section [encoder], so that the error message names only the kind.
    """
    model = raw.get("model")
    if isinstance(model, dict) and model.get("kind", "drive") not in ("drive", "equation"):
        raw.setdefault("encoder", {"resolution": NO_ENCODER})


def check_sampling(axis: Axis, dt: float) -> None:
    """Raise UsageError if the filter pole exceeds the Nyquist limit, `cutoff * dt > 2` (dt in s)."""
    cutoff = axis.estimator.pole
    if cutoff * dt > 2:
        raise UsageError(
            f"[estimator] cutoff = {cutoff:g} rad/s is too high for dt = {dt:g} s: beyond the Nyquist limit, the "
            f"filter response alternates in sign; {_unit_of_time(axis)}use at most 2/dt = {2 / dt:g} rad/s"
        )


def _unit_of_time(axis: Axis) -> str:
    """Return the advice to check the unit of time first.

    If ms are taken for s, a lower cutoff would hide a factor of 1000.
    """
    if axis.record.time is None:
        return "check that [record] dt is in s, else "
    if axis.record.time_unit is None:
        return 'give [record] time_unit if the time is not in s, for example "ms", else '
    return ""

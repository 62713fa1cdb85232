"""AXIS.toml: what the record holds, the encoder, the model and the estimator, validated once and frozen.

The description of a field ends the error message about it: it must read well after "give ...".
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from pmfid.encoder import Encoder
from pmfid.errors import UsageError
from pmfid.estimators import Method
from pmfid.estimators.facts import INPUT_GAIN, check_known
from pmfid.models.equation import ESTIMATE
from pmfid.monitor.names import DetectorName
from pmfid.session.model_config import ModelConfig, Name, Positive
from pmfid.session.toml_file import FileSection, load_sections

__all__ = ["Axis", "check_sampling", "load_axis"]


def _usable_scale(value: float | str) -> float | str:
    if value in (0, ""):
        raise ValueError("it must be neither zero nor empty")
    return value


def _distinct(value: tuple[float, float] | None) -> tuple[float, float] | None:
    if value is not None and value[0] == value[1]:
        raise ValueError("the two zeros must differ")
    return value


#: Resolution of an output that is a number and no count: finer than any.
NO_ENCODER = 1e-29

Negative = Annotated[float, Field(lt=0)]


def _forward(value: tuple[float, float]) -> tuple[float, float]:
    if not value[0] < value[1]:
        raise ValueError("the first time must be before the second")
    return value


Span = Annotated[tuple[float, float], Field(strict=False), AfterValidator(_forward)]


class RecordConfig(FileSection):
    """[record]: which columns of the file hold the input u, the output and the time [s]."""

    input: Name = Field(description="the name of the column that holds the input")
    output: Name = Field(description="the name of the column that holds the position or the counts")
    output_kind: Literal["position", "counts"] = Field("position", description="what the output column holds")
    time: Name | None = Field(None, description="the name of the time column")
    time_unit: Literal["s", "ms", "us", "ns"] | None = Field(
        None, description="the unit of the time column, or leave it out where the column's name or s is right"
    )
    reference: Name | None = Field(
        None, description="the name of the column that holds what a controller was told, of a transfer function"
    )
    hold: Literal["zoh", "foh"] = Field("zoh", description="what the input does between samples: holds, or a line")
    gap: Positive | None = Field(None, description="the time step in s beyond which the record is interrupted")
    exclude: tuple[Span, ...] = Field(
        (), strict=False, description="parts to leave out, from and to in s as in the time column: [[1.5, 2.0]]"
    )
    mask: Name | None = Field(
        None, description="the name of a column that is not zero in the rows that are to be left out"
    )
    dt: Positive | None = Field(None, description="the sample period in s, for example 1e-3")
    input_scale: Annotated[float | str, AfterValidator(_usable_scale)] = Field(
        1.0,
        description="a factor, u = input_scale * column, or the name of a scalar variable in the file",
    )

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.time is None and self.dt is None:
            raise ValueError("neither time nor dt is there; give the time column, or dt in s, or both")
        if self.time is None and self.time_unit is not None:
            raise ValueError("time_unit is that of the time column; name it with time, or drop time_unit")
        if len({self.input, self.output, self.time}) < 3:
            raise ValueError("input, output and time must be different columns; correct the names")
        return self


class EncoderConfig(FileSection):
    """[encoder]: resolution in unit of y per count, and what is known of the counter and the motion."""

    resolution: Positive = Field(description="the unit of y per count, for example 22.75e-6 (m)")
    bits: int | None = Field(
        None,
        ge=1,
        le=32,
        description="the width of the counter that wraps at 2**bits, 1 to 32, or leave it out",
    )
    standstill_time: Positive = Field(0.2, description="the time in s without a new count that means standstill")
    max_speed: Positive | None = Field(None, description="the highest possible speed in unit of y per s")
    guard: bool = Field(True, description="true, or false to let samples in that no motion explains")

    def made(self, resolution: float) -> Encoder:
        """What the estimators know of the encoder, read in steps of `resolution` [unit of y per count]."""
        return Encoder(resolution, standstill_time=self.standstill_time, max_speed=self.max_speed, guard=self.guard)


class EstimatorConfig(FileSection):
    """[estimator]: method, filter chain (`cutoff` in rad/s, `order` stages) and memory."""

    method: Method = Field("auto", description="the estimation method")
    cutoff: Positive | None = Field(
        None, description="the pole of the filter chain in rad/s, for example 50.0, or leave it out: from the record"
    )
    order: int = Field(2, ge=2, le=6, description="the number of filter stages, 2 to 6")
    forgetting: float = Field(
        1.0,
        gt=0,
        le=1,
        description="a factor in (0, 1]; for a memory of T seconds use 1 - dt/T, 1 never forgets",
    )
    forgetting_scheme: Literal["exponential", "directional", "constant-trace", "window"] = Field(
        "exponential", description="what becomes of old samples where forgetting < 1"
    )
    window: Positive | Literal["auto"] | None = Field(
        None, description='the length in s of the windows of output-error, for example 2.0, or "auto"'
    )
    given: dict[str, float] = Field({}, description="values that are known, as { mass = 1.25 }")
    prior: dict[str, Annotated[tuple[float, float], Field(strict=False)]] = Field(
        {}, description="a mean and a standard deviation, as { mass = [1.0, 0.1] }"
    )
    discretization: Literal["matched", "paper", "exact"] = Field(
        "matched", description="the discretisation of the filters"
    )
    # not strict, because TOML has lists and a frozen object wants a tuple
    prefilter_zeros: Annotated[tuple[Negative, Negative] | None, AfterValidator(_distinct)] = Field(
        None, strict=False, description="two different negative numbers in 1/s, for example [-30.0, -60.0]"
    )
    precision: Literal["float64", "float32"] = Field("float64", description="the arithmetic of the kernel")

    @property
    def pole(self) -> float:
        """The cutoff [rad/s]. Raises UsageError where it is not known yet."""
        if self.cutoff is None:
            raise UsageError(
                "[estimator] cutoff is missing; give the pole of the filter chain in rad/s: pmfid identify on a record "
                "of the axis chooses one"
            )
        return self.cutoff


class MonitorConfig(FileSection):
    """[monitor]: what `pmfid monitor` compares with, and how often it may be wrong."""

    reference: Name | None = Field(
        None, description='a record of normal work with the same columns, beside AXIS.toml: "normal.csv"'
    )
    nominal: dict[str, float] | None = Field(
        None,
        description="the normal value of every parameter, { mass = 1.07, ... }, or leave it out: from the reference",
    )
    detector: DetectorName = Field("glr", description="the detector")
    mtbf_hours: float = Field(
        24.0, ge=0.1, le=1e6, description="the mean time between false alarms in hours, for example 24.0"
    )
    tolerance: float = Field(
        0.02, ge=0, lt=1, description="the relative deviation that is no change, for example 0.02 for 2 %"
    )


#: Section, key, and whether it is one of a transfer function or of a machine with friction.
_KEYS_OF_ONE_KIND = (
    ("record", "gap", True),
    ("record", "hold", True),
    ("record", "reference", True),
    ("encoder", "standstill_time", False),
    ("encoder", "max_speed", False),
    ("estimator", "window", False),
)
#: What serves the purpose instead.
_CURE = {
    "gap": ", and cut the record at the gap",
    "hold": ", the input of an axis is taken to hold between samples",
}


class Axis(FileSection):
    """One axis of motion: the whole of AXIS.toml."""

    record: RecordConfig = Field(description="a section that names the columns input, output and time")
    encoder: EncoderConfig = Field(description="a section with at least the resolution")
    model: ModelConfig = Field(description="a section with at least the input_gain")
    estimator: EstimatorConfig = Field(EstimatorConfig(), description="a section with method, cutoff and memory")
    monitor: MonitorConfig = Field(MonitorConfig(), description="a section that names the reference")

    @model_validator(mode="after")
    def _used(self) -> Self:
        """What is given must have an effect: a key that the model does not use is refused."""
        kind, sections = self.model.kind, {"record": self.record, "encoder": self.encoder, "estimator": self.estimator}
        for section, key, of_process in _KEYS_OF_ONE_KIND:
            part = sections[section]
            value = getattr(part, key)
            if value != type(part).model_fields[key].default and of_process != (kind == "transfer_function"):
                cure = f"drop it{_CURE.get(key, '')}"
                raise UsageError(f'[{section}] {key} = {value!r} is not used with kind = "{kind}"; {cure}')
        if kind == "transfer_function" and self.estimator.cutoff is None:
            raise UsageError(
                "[estimator] cutoff is missing; give the pole of the filters in rad/s, near those of the process"
            )
        self._check_known()
        return self

    def _check_known(self) -> None:
        """What is known beforehand is of parameters of the model."""
        given, prior, find = self.estimator.given, self.estimator.prior, self.model.input_gain == ESTIMATE
        if self.model.kind == "transfer_function" and (given or prior):
            raise UsageError("[estimator] given and prior are for machines; of a transfer function drop them")
        if given or prior or find:
            equation = self.model.make().equation
            names = (*equation.names, *(name for name, _ in equation.further), *([INPUT_GAIN] if find else []))
            check_known(equation, given, prior, names, find)


def load_axis(path: Path, overrides: Mapping[str, object] | None = None) -> Axis:
    """Read and validate an AXIS.toml.

    `overrides` holds dotted keys, {"estimator.cutoff": 50.0}, that go before the file's; None is ignored.
    Raises UsageError, with all problems in one text, if the file cannot be read or a value is not allowed.
    """
    return load_sections(Axis, path, overrides, "an AXIS.toml", _without_encoder)


def _without_encoder(raw: dict[str, object]) -> None:
    """A transfer function needs no encoder: its output is a number, or in counts. Of an unknown kind only that is
    said."""
    model = raw.get("model")
    if isinstance(model, dict) and model.get("kind", "drive") not in ("drive", "equation"):
        raw.setdefault("encoder", {"resolution": NO_ENCODER})


def check_sampling(axis: Axis, dt: float) -> None:
    """Raise UsageError if the filter pole lies past the Nyquist limit, `cutoff * dt > 2` (dt in s)."""
    cutoff = axis.estimator.pole
    if cutoff * dt > 2:
        raise UsageError(
            f"[estimator] cutoff = {cutoff:g} rad/s is too high for dt = {dt:g} s: the filter pole would be "
            f"past the Nyquist limit and alternate in sign; {_unit_of_time(axis)}use at most 2/dt = {2 / dt:g} rad/s"
        )


def _unit_of_time(axis: Axis) -> str:
    """What to look at before the cutoff: with time in ms taken for s, a lower cutoff hides a factor of 1000."""
    if axis.record.time is None:
        return "check that [record] dt is in s, else "
    if axis.record.time_unit is None:
        return 'give [record] time_unit if the time is not in s, for example "ms", else '
    return ""

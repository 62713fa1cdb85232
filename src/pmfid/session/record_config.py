"""[record] and [encoder] of AXIS.toml: the columns of a record and the encoder.

The description of a field ends the error message about it: it must read well after "give ...".
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from pmfid.encoder import Encoder
from pmfid.session.model_config import Name, Positive, Travel
from pmfid.session.toml_file import FileSection
from pmfid.session.units import INPUTS, OUTPUTS, known_unit

__all__ = ["NO_ENCODER", "EncoderConfig", "RecordConfig"]


def _usable_scale(value: float | str) -> float | str:
    if value in (0, ""):
        raise ValueError("it must be neither zero nor empty")
    return value


def _output_unit(text: str) -> str:
    return known_unit(text, OUTPUTS)


def _input_unit(text: str) -> str:
    return known_unit(text, INPUTS)


def _forward(value: tuple[float, float]) -> tuple[float, float]:
    if not value[0] < value[1]:
        raise ValueError("the first time must be before the second")
    return value


Span = Annotated[tuple[float, float], Field(strict=False), AfterValidator(_forward)]
OutputUnit = Annotated[str, AfterValidator(_output_unit)]
InputUnit = Annotated[str, AfterValidator(_input_unit)]

#: Resolution of an output without counts: finer than any encoder.
NO_ENCODER = 1e-29


class RecordConfig(FileSection):
    """[record]: which columns of the file hold the input u, the output and the time [s]."""

    input: Name = Field(description="the name of the column that holds the input")
    output: Name = Field(description="the name of the column that holds the position or the counts")
    output_kind: Literal["position", "counts", "velocity"] = Field(
        "position", description="what the output column holds"
    )
    input_unit: InputUnit | None = Field(
        None, description='the unit of the input, for example "mA", or leave it out if the column\'s name is right'
    )
    output_unit: OutputUnit | None = Field(
        None, description='the unit of the output, for example "mm" or "deg", or leave it out, as the input\'s'
    )
    separator: Literal[",", ";", "\t", "|", " "] | None = Field(
        None, description='what is between the columns of a text, for example ";", or leave it out: as the text shows'
    )
    decimal: Literal[".", ","] | None = Field(
        None, description='the decimal sign of a text, "." or ",", or leave it out: as the text shows'
    )
    time: Name | None = Field(None, description="the name of the time column")
    time_unit: Literal["s", "ms", "us", "ns"] | None = Field(
        None, description="the unit of the time column, or leave it out if the column's name or s is right"
    )
    reference: Name | None = Field(
        None, description="the name of the column that holds the reference of a controller, of a transfer function"
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
    """[encoder]: resolution in unit of y per count, and facts about the counter and the motion."""

    resolution: Travel = Field(
        description='the unit of y per count, for example 22.75e-6 (m, of a rotary axis rad), or "0.01 deg"'
    )
    range: Travel | None = Field(
        None, description='the travel after which the output wraps, for example "360 deg", or leave it out'
    )
    bits: int | None = Field(
        None,
        ge=1,
        le=32,
        description="the width of the counter that wraps at 2**bits, 1 to 32, or leave it out",
    )
    standstill_time: Positive = Field(0.2, description="the time in s without a new count that means standstill")
    max_speed: Travel | None = Field(
        None, description='the highest possible speed in unit of y per s, or as "3000 rpm"'
    )
    guard: bool = Field(True, description="true, or false to keep samples that no motion explains")

    def make_encoder(self, resolution: float) -> Encoder:
        """The encoder of the estimators, with steps of `resolution` [unit of y per count]."""
        return Encoder(resolution, standstill_time=self.standstill_time, max_speed=self.max_speed, guard=self.guard)

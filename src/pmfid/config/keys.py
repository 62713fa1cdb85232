"""AXIS.toml as a dict, so that type checkers know its keys and their values.

The names of keys and their meaning are those of the sections in `axis`, `record` and `model`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, Required, TypedDict

from pmfid.estimators import Discretization, Method, Precision
from pmfid.linear.experiment import Hold
from pmfid.models.axes import AxisKind
from pmfid.models.drive import Body, Friction, Side
from pmfid.models.signals import Signal

Searched = Literal["estimate"]
OutputKind = Literal["position", "counts", "velocity"]
TimeUnit = Literal["s", "ms", "us", "ns"]
Separator = Literal[",", ";", "\t", "|", " "]
Form = Literal["stribeck", "square", "wave", "along"]
KindName = Literal["drive", "equation", "transfer_function"]


class RecordKeys(TypedDict, total=False):
    """The keys of [record]."""

    input: Required[str]
    output: Required[str]
    output_kind: OutputKind
    input_unit: str
    output_unit: str
    separator: Separator
    decimal: Literal[".", ","]
    time: str
    time_unit: TimeUnit
    reference: str
    hold: Hold
    gap: float
    exclude: Sequence[tuple[float, float]]
    mask: str
    dt: float
    input_scale: float | str
    known_force: Sequence[str]
    friction_temperature: str


class EncoderKeys(TypedDict, total=False):
    """The keys of [encoder]."""

    resolution: Required[float | str]
    range: float | str
    bits: int
    standstill_time: float
    max_speed: float | str
    guard: bool
    edge_age: str
    lines: int
    tick: float


class ShapeKeys(TypedDict, total=False):
    """The keys of the shape of a term."""

    form: Required[Form]
    speed: float | Searched
    period: float
    cosine: bool
    start: float
    step: float
    values: Sequence[float]


class KnownTermKeys(TypedDict, total=False):
    """The keys of a term with a known coefficient."""

    signal: Signal
    derivative: int
    coefficient: float


class UnknownTermKeys(TypedDict, total=False):
    """The keys of a term with an unknown coefficient."""

    signal: Required[Signal]
    derivative: int
    coefficient: float
    name: Required[str]
    unit: str
    shape: ShapeKeys


class ModelKeys(TypedDict, total=False):
    """The keys of [model]."""

    kind: KindName
    n: int
    m: int
    delay: int
    dead_time: float | Searched
    lag: float | Searched
    integrators: int
    unstable: bool
    axis: AxisKind
    input_gain: float | str
    body: Body
    play: bool
    output: Side
    friction: Friction
    offset: bool
    spring: bool
    stribeck: float | str
    quadratic: bool
    gravity: bool | float | str
    cogging: float | str
    friction_period: float | str
    unknown: Sequence[UnknownTermKeys]
    known: Sequence[KnownTermKeys]


class EstimatorKeys(TypedDict, total=False):
    """The keys of [estimator]. A value of None is the same as no value."""

    method: Method | None
    cutoff: float | None
    order: int | None
    forgetting: float | None
    given: dict[str, float] | None
    prior: dict[str, tuple[float, float]] | None
    discretization: Discretization | None
    prefilter_zeros: tuple[float, float] | None
    precision: Precision | None
    tolerance: float | None


class MonitorKeys(TypedDict, total=False):
    """The keys of [monitor]."""

    reference: str
    nominal: dict[str, float]
    mtbf_hours: float
    tolerance: float


class AxisKeys(TypedDict, total=False):
    """The sections of an AXIS.toml as a dict, for `identify` and `check`.

    Examples
    --------
    >>> from pmfid import AxisKeys
    >>> axis: AxisKeys = {
    ...     "record": {"input": "u", "output": "counts", "output_kind": "counts", "dt": 0.001},
    ...     "encoder": {"resolution": "4096 counts/rev"},
    ...     "model": {"input_gain": "0.35 N m/A", "friction": "directional"},
    ... }
    """

    record: Required[RecordKeys]
    encoder: EncoderKeys
    model: Required[ModelKeys]
    estimator: EstimatorKeys
    monitor: MonitorKeys

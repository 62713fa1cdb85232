"""Values of keys in AXIS.toml, and the keys that `identify` also takes as keywords."""

from __future__ import annotations

from typing import Literal, TypedDict

from pmfid.estimators import Discretization, Method, Precision

Searched = Literal["estimate"]
OutputKind = Literal["position", "counts", "velocity"]
TimeUnit = Literal["s", "ms", "us", "ns"]
Separator = Literal[",", ";", "\t", "|", " "]
Form = Literal["stribeck", "square", "wave", "along"]
KindName = Literal["drive", "equation", "transfer_function"]


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

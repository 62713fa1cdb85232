"""The table of a result's parameters, for the report, the terminal and Python."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Protocol

import numpy as np

from pmfid.findings import Finding
from pmfid.types import Floats

UNKNOWN = "–"
#: Columns with spaces, which may take several lines.
FOLDED = ("model spread", "95 %")


class Parametric(Protocol):
    """The p parameters of a `Result`: theta, theta_std, model_spread (p,), interval_95 (p, 2); beforehand: by name,
    which prior information there is."""

    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def units(self) -> tuple[str, ...]: ...
    @property
    def theta(self) -> Floats: ...
    @property
    def theta_std(self) -> Floats: ...
    @property
    def model_spread(self) -> Floats | None: ...
    @property
    def interval_95(self) -> Floats | None: ...
    @property
    def beforehand(self) -> Mapping[str, str]: ...
    @property
    def findings(self) -> tuple[Finding, ...]: ...


def parameter_header(result: Parametric) -> tuple[str, ...]:
    """The names of the columns of `parameter_rows`."""
    beyond = () if result.model_spread is None else FOLDED
    return ("parameter", "value", "std", *beyond, "unit")


def parameter_rows(result: Parametric) -> list[list[str]]:
    """One row of text for each parameter; of a machine also the model spread and the interval that includes it."""
    names, units = result.names, result.units
    found = zip(names, result.theta, result.theta_std, _list_beyond_noise(result), units, strict=True)
    return [
        [_format_name(result, name), f"{value:.6g}", f"{std:.2g}", *beyond, unit]
        for name, value, std, beyond, unit in found
    ]


def findings_lines(result: Parametric) -> list[str]:
    """The findings, most important first, a paragraph each."""
    return [f"{finding.line[0].upper()}{finding.line[1:]}." for finding in result.findings]


def _format_name(result: Parametric, name: str) -> str:
    known = result.beforehand.get(name)
    return name if known is None else f"{name} ({known})"


def format_interval(low: float, high: float) -> str:
    """An interval with the digits that its width needs, five at least."""
    width, size = high - low, max(abs(low), abs(high))
    digits = 5 if not width > 0 else max(5, min(15, 2 + math.ceil(math.log10(size / width))))
    return f"{low:.{digits}g} to {high:.{digits}g}"


def _list_beyond_noise(result: Parametric) -> list[list[str]]:
    if result.model_spread is None or result.interval_95 is None:
        return [[]] * len(result.names)
    return [
        [f"{spread:.2g}", format_interval(low, high)] if np.isfinite(spread) else [UNKNOWN, UNKNOWN]
        for spread, (low, high) in zip(result.model_spread, result.interval_95, strict=True)
    ]

"""Presentation of results: a few lines, a table for notebooks, numbers for programs, and a figure.

Each class of results defines `summary`, `columns` and `to_dict`. This module derives all other views from these three.
"""

from __future__ import annotations

import html
import json
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, cast

import numpy as np

from pmfid.errors import place_of, printable
from pmfid.lazy_imports import make_getattr

if TYPE_CHECKING:
    import polars as pl
    from matplotlib.figure import Figure

#: A `repr` has at most MOST_LINES lines and MOST_REMARKS remarks, each cut to LONGEST characters.
MOST_LINES, MOST_REMARKS, LONGEST = 8, 3, 300
#: Style of a table cell where the notebook has none: adjacent columns need a space.
CELL = ' style="text-align: left; padding: 0.1em 1em 0.1em 0"'
#: This is the only import from a higher layer, by name and at the call: results are below the package that draws them.
_load = make_getattr("pmfid.report", {"figure_of": "pmfid.report.plots"})


@dataclass(frozen=True)
class Summary:
    """Content of a result for people: a title, a table and remarks.

    `title` is one line; `header` and `rows` are a table of text. `lines` holds one sentence for each row of the table.
    `remarks` are status and notes, the most important first.
    """

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    lines: Sequence[str] = ()
    remarks: Sequence[str] = field(default=())

    @property
    def text(self) -> str:
        """Text of about five lines."""
        lines = list(self.lines) or [", ".join(filter(None, row)) for row in self.rows]
        more = [f"... and {len(lines) - MOST_LINES} more"] if len(lines) > MOST_LINES else []
        further = len(self.remarks) - MOST_REMARKS
        remarks = [_cut(remark) for remark in self.remarks[:MOST_REMARKS]]
        remarks += [f"... and {further} more notes"] if further > 0 else []
        parts = [self.title, *(f"  {line}" for line in (*lines[:MOST_LINES], *more)), *remarks]
        return "\n".join(printable(part.replace("\n", " ")) for part in parts)

    @property
    def html(self) -> str:
        """HTML of a self-contained table. Names from files appear as plain text, so that no name can contain markup."""
        head = "".join(f"<th{CELL}>{_safe(name)}</th>" for name in self.header)
        body = "".join(f"<tr>{''.join(f'<td{CELL}>{_safe(cell)}</td>' for cell in row)}</tr>" for row in self.rows)
        remarks = "".join(f"<p>{_safe(remark)}</p>" for remark in self.remarks)
        return f"<div><p><b>{_safe(self.title)}</b></p><table><tr>{head}</tr>{body}</table>{remarks}</div>"


def _cut(text: str) -> str:
    return text if len(text) <= LONGEST else text[:LONGEST].rpartition(" ")[0] + " ..."


def _safe(text: str) -> str:
    return html.escape(printable(text))


class Presentable(ABC):
    """Base class of results with the methods `repr`, `_repr_html_` for notebooks, `plot`, `to_dict` and `to_frame`."""

    @abstractmethod
    def summary(self) -> Summary:
        """Return the title, the table and the remarks of the result."""

    @abstractmethod
    def columns(self) -> Mapping[str, object]:
        """Return the columns of `to_frame` by name, all of one length."""

    @abstractmethod
    def to_dict(self) -> dict[str, object]:
        """Return the result as text, numbers, lists and dicts, as JSON requires. A number that is not finite
        becomes None.
        """

    def __repr__(self) -> str:
        return self.summary().text

    def _repr_html_(self) -> str:
        return self.summary().html

    def to_frame(self) -> pl.DataFrame:
        """Return the result as a polars DataFrame."""
        return frame_of(self.columns())

    def plot(self, **options: object) -> Figure:
        """Return the figure of the result, a matplotlib Figure. `options` are those of `pmfid.report.plots`."""
        return figure_of(self, **options)


def frame_of(columns: Mapping[str, object]) -> pl.DataFrame:
    """Return named columns as a polars DataFrame."""
    import polars as pl  # slow to import

    return pl.DataFrame(dict(columns))


def figure_of(shown: object, **options: object) -> Figure:
    """Return the report's figure of any result."""
    draw = _load("figure_of")
    return cast("Figure", draw(shown, **options))  # type: ignore[operator]


def plain(value: object) -> object:
    """Return `value` as text, numbers, lists and dicts. A number that is not finite becomes None, a complex number
    a pair.
    """
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, complex):
        return [plain(value.real), plain(value.imag)]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else str(value)


def format_pair(value: float, std: float) -> tuple[str, str]:
    """Return an estimate and its standard error as text, the estimate with the digits of two of the error and at
    least three."""
    if not (math.isfinite(std) and std > 0 and math.isfinite(value)):
        return f"{value:.4g}", f"{std:.2g}"
    places = 1 - math.floor(math.log10(float(f"{std:.1e}")))
    digits = places + math.floor(math.log10(abs(value))) + 1 if value else 1
    text = f"{value:#.{min(max(digits, 3), 15)}g}" if value else f"{0.0:.{min(max(places, 0), 15)}f}"
    return text.rstrip(".").replace(".e", "e"), f"{std:#.2g}".rstrip(".").replace(".e", "e")


def as_json(value: object) -> str:
    """Return JSON on one line. A number that is not finite becomes null."""
    try:
        return json.dumps(value, allow_nan=False, separators=(",", ":"))
    except (TypeError, ValueError):
        return json.dumps(plain(value), allow_nan=False, separators=(",", ":"))


def plain_dict(content: Mapping[str, object]) -> dict[str, object]:
    """Return a mapping as a dict of plain values, as `plain` makes them."""
    return {str(key): plain(item) for key, item in content.items()}


@dataclass(frozen=True)
class Parameters:
    """Names, units, estimates and standard errors of p parameters, for results without further content.

    `theta` (p,) holds the estimates and `std` (p,) their standard errors.
    """

    names: Sequence[str]
    units: Sequence[str]
    theta: np.ndarray
    std: np.ndarray

    header = ("parameter", "value", "std", "unit")

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """Rows of text with the columns of `header`."""
        found = zip(self.names, self.theta, self.std, self.units, strict=True)
        return [(name, f"{value:.6g}", f"{std:.2g}", unit) for name, value, std, unit in found]

    @property
    def lines(self) -> list[str]:
        return [f"{name} = {value} ± {std} {unit}".rstrip() for name, value, std, unit in self.rows]

    @property
    def columns(self) -> dict[str, object]:
        return {
            "parameter": list(self.names),
            "value": np.asarray(self.theta, float),
            "std": np.asarray(self.std, float),
            "unit": list(self.units),
        }

    @property
    def content(self) -> dict[str, object]:
        """Value, standard error and unit of each parameter by name, for `to_dict`."""
        found = zip(self.names, self.theta, self.std, self.units, strict=True)
        return {name: {"value": plain(value), "std": plain(std), "unit": unit} for name, value, std, unit in found}

    def summary(self, title: str, remarks: Sequence[str] = ()) -> Summary:
        """Return the summary with a title and remarks."""
        columns = len(self.header) if any(self.units) else len(self.header) - 1
        return Summary(title, self.header[:columns], [row[:columns] for row in self.rows], self.lines, remarks)


class PresentableParameters(Presentable):
    """Base class of results that are estimates `theta` (p,) with standard errors `theta_std` (p,)."""

    if TYPE_CHECKING:  # at run time, a property would be the default of a field

        @property
        def names(self) -> Sequence[str]: ...
        @property
        def units(self) -> Sequence[str]: ...
        @property
        def theta(self) -> np.ndarray: ...
        @property
        def theta_std(self) -> np.ndarray: ...

    @property
    def _parameters(self) -> Parameters:
        return Parameters(self.names, self.units, self.theta, self.theta_std)

    def __getitem__(self, name: str) -> float:
        """Return one parameter. Raises UnknownParameterError, a KeyError that lists the names."""
        return float(self.theta[place_of(name, self.names)])

    def columns(self) -> Mapping[str, object]:
        """Return the columns of a table with one row for each parameter."""
        return self._parameters.columns


def remarks_of(status: Sequence[str], notes: Sequence[str] = ()) -> list[str]:
    """Return one line with the names of the status bits, if any is set, and one line for each note."""
    return [*([f"status: {', '.join(status)}"] if status else []), *(f"note: {note}" for note in notes)]

"""What every result shows of itself: a few lines, a table for notebooks, numbers for programs, a figure.

A class of results says what is in it, by `summary`, `columns` and `to_dict`; the rest is here, once for all of them.
"""

from __future__ import annotations

import html
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, cast

import numpy as np

from pmfid.errors import printable
from pmfid.lazy_imports import make_getattr

if TYPE_CHECKING:
    import polars as pl
    from matplotlib.figure import Figure

#: Lines of a table, and remarks below it, that a `repr` has; longer remarks are cut.
MOST_LINES, MOST_REMARKS, LONGEST = 8, 3, 300
#: Of a cell of a table where no notebook has a style: columns must not run into each other.
CELL = ' style="text-align: left; padding: 0.1em 1em 0.1em 0"'
#: The one look upward, by name and at the call: a result is below the room that draws it.
_load = make_getattr("pmfid.report", {"figure_of": "plots"})


@dataclass(frozen=True)
class Summary:
    """title: one line; header, rows: a table of text; lines: the same in words, a line for each row; remarks: status
    and notes, the most important first."""

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    lines: Sequence[str] = ()
    remarks: Sequence[str] = field(default=())

    @property
    def text(self) -> str:
        """About five lines."""
        lines = list(self.lines) or [", ".join(filter(None, row)) for row in self.rows]
        more = [f"... and {len(lines) - MOST_LINES} more"] if len(lines) > MOST_LINES else []
        further = len(self.remarks) - MOST_REMARKS
        remarks = [_cut(remark) for remark in self.remarks[:MOST_REMARKS]]
        remarks += [f"... and {further} more notes"] if further > 0 else []
        parts = [self.title, *(f"  {line}" for line in (*lines[:MOST_LINES], *more)), *remarks]
        return "\n".join(printable(part.replace("\n", " ")) for part in parts)

    @property
    def html(self) -> str:
        """A self-contained table; names from files are plain text in it, whatever they hold."""
        head = "".join(f"<th{CELL}>{_safe(name)}</th>" for name in self.header)
        body = "".join(f"<tr>{''.join(f'<td{CELL}>{_safe(cell)}</td>' for cell in row)}</tr>" for row in self.rows)
        remarks = "".join(f"<p>{_safe(remark)}</p>" for remark in self.remarks)
        return f"<div><p><b>{_safe(self.title)}</b></p><table><tr>{head}</tr>{body}</table>{remarks}</div>"


def _cut(text: str) -> str:
    return text if len(text) <= LONGEST else text[:LONGEST].rpartition(" ")[0] + " ..."


def _safe(text: str) -> str:
    return html.escape(printable(text))


class Presentable(ABC):
    """A result for people and programs: `repr`, `_repr_html_` in notebooks, `plot`, `to_dict`, `to_frame`."""

    @abstractmethod
    def summary(self) -> Summary:
        """What a person sees of it."""

    @abstractmethod
    def columns(self) -> Mapping[str, object]:
        """The columns of `to_frame` by name, all of one length."""

    @abstractmethod
    def to_dict(self) -> dict[str, object]:
        """Texts, numbers, lists and dicts alone, as JSON has them; what is not finite is None."""

    def __repr__(self) -> str:
        return self.summary().text

    def _repr_html_(self) -> str:
        return self.summary().html

    def to_frame(self) -> pl.DataFrame:
        """The result as a polars DataFrame."""
        return frame_of(self.columns())

    def plot(self, **options: object) -> Figure:
        """The report's figure of the result, a matplotlib Figure; options: see `pmfid.report.plots`."""
        return figure_of(self, **options)


def frame_of(columns: Mapping[str, object]) -> pl.DataFrame:
    """Columns by name as a polars DataFrame."""
    import polars as pl  # slow to import

    return pl.DataFrame(dict(columns))


def figure_of(shown: object, **options: object) -> Figure:
    """The figure of any result."""
    draw = _load("figure_of")
    return cast("Figure", draw(shown, **options))  # type: ignore[operator]


def plain(value: object) -> object:
    """The same in texts, numbers, lists and dicts alone; what is not finite is None, a complex number a pair."""
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


def plain_dict(content: Mapping[str, object]) -> dict[str, object]:
    """`plain` of what is a dict."""
    return {str(key): plain(item) for key, item in content.items()}


@dataclass(frozen=True)
class Parameters:
    """p parameters: names, units, theta, std (p,). For summaries and frames of what has nothing else."""

    names: Sequence[str]
    units: Sequence[str]
    theta: np.ndarray
    std: np.ndarray

    header = ("parameter", "value", "std", "unit")

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """The rows of text, as of `header`."""
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
        """The content by name, for `to_dict`."""
        found = zip(self.names, self.theta, self.std, self.units, strict=True)
        return {name: {"value": plain(value), "std": plain(std), "unit": unit} for name, value, std, unit in found}

    def summary(self, title: str, remarks: Sequence[str] = ()) -> Summary:
        """The summary, with a title and warnings."""
        columns = len(self.header) if any(self.units) else len(self.header) - 1
        return Summary(title, self.header[:columns], [row[:columns] for row in self.rows], self.lines, remarks)


def remarks_of(status: Sequence[str], notes: Sequence[str] = ()) -> list[str]:
    """Lines on status names and notes."""
    return [*([f"status: {', '.join(status)}"] if status else []), *(f"note: {note}" for note in notes)]

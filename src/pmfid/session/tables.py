"""Tables: the columns of a file by name, and one column as numbers."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import UsageError, did_you_mean
from pmfid.types import Floats

if TYPE_CHECKING:
    import polars as pl

__all__ = ["TWICE", "Columns", "Table", "column", "from_array", "lookup", "notes_of", "whole_name"]

#: Column by name: an array or a polars series, whichever the reader of the file has.
Table = Mapping[str, object]

#: A unit in brackets at the end of a name.
_UNIT = re.compile(r"\s*[\[(][^\])]*[\])]$")


class Columns(dict[str, object]):
    """A table, and how it was read, for people."""

    def __init__(self, columns: Mapping[str, object], notes: tuple[str, ...]) -> None:
        super().__init__(columns)
        self.notes = notes


def notes_of(table: Table) -> tuple[str, ...]:
    """How a table was read, where that was not plain."""
    return table.notes if isinstance(table, Columns) else ()


def whole_name(table: Table, name: str) -> str:
    """The name of the column that is called so, there maybe with a unit in brackets: "t [ms]" for "t"."""
    found = [full for full in table if _UNIT.sub("", full) == name]
    return found[0] if name not in table and len(found) == 1 else name


#: Polars' end of the name of a column that is there already.
TWICE = "_duplicated_0"


def lookup(table: Table, key: str, name: str) -> object:
    """The column `name`, which [record] `key` asks for; raises UsageError listing what there is."""
    if f"{name}{TWICE}" in table:
        raise UsageError(f"[record] {key} = {name!r}: two columns have this name; rename one of them")
    if name in table:
        return table[name]
    listed = ", ".join(list(table)[:30]) or "none"
    hint = did_you_mean(name, table)
    raise UsageError(f"[record] {key} = {name!r}: there is no such column; available are {listed}{hint}")


def column(table: Table, key: str, name: str) -> Floats:
    """The column `name` as (n,) numbers, NaN where a cell is empty; raises UsageError where it is not numeric."""
    value = lookup(table, key, name)
    label = f"{key} column {name!r}"
    if isinstance(value, np.ndarray):
        return from_array(label, value).ravel()
    return _from_series(label, cast("pl.Series", value))


def from_array(label: str, array: NDArray[np.generic]) -> Floats:
    """An array as float64 in its own shape; raises UsageError, with the label, unless it is a real vector."""
    if array.dtype.kind not in "biuf":
        raise UsageError(f"{label} is not a real numeric array but {array.dtype}; save it as a vector of double")
    if array.size > 1 and max(array.shape) != array.size:
        raise UsageError(f"{label} is not a vector, its shape is {array.shape}; save one column as its own variable")
    return array.astype(np.float64)


def _from_series(label: str, series: pl.Series) -> Floats:
    import polars as pl

    if series.dtype == pl.String:
        numbers = series.str.strip_chars().cast(pl.Float64, strict=False)
        bad = (numbers.is_null() & series.is_not_null()).arg_true()
        if len(bad):
            raise UsageError(f"{label} is not numeric: {series[bad[0]]!r} in row {bad[0] + 1}; write numbers like 0.25")
        series = numbers
    if not series.dtype.is_numeric():
        raise UsageError(f"{label} is not numeric but {series.dtype}; store it as numbers (time in s)")
    values: Floats = series.cast(pl.Float64).fill_null(np.nan).to_numpy()
    return values

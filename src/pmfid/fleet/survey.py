"""Which axes each file of a data set has, how many rows of them and of when: from two columns, once per file.

Day by day, so that neither gaps nor a stamp from another century make the plan a bad guess.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

from pmfid.errors import UsageError
from pmfid.fleet.source import AXIS, INPUT, MASK, OUTPUT, TIME, TYPE, Columns, Part
from pmfid.fleet.times import other_unit
from pmfid.session.formats.safety import readable

if TYPE_CHECKING:
    import polars as pl

#: [s].
DAY = 86_400.0
PART, ROWS, LOST, FIRST, LAST, EXTENT = "part", "rows", "lost", "first", "last", "extent"
#: First row in the part.
START = "start"
_PLACE, _END = "place in the part", "end"


@dataclass(frozen=True)
class RowProblem:
    """Rows or a file that cannot be used. axis: empty if a file is concerned; part: empty if an axis is concerned; at:
    time [s] from which on; code: its name among the findings."""

    axis: str
    part: str
    code: str
    text: str
    at: float = float("nan")


@dataclass(frozen=True)
class Survey:
    """rows: a row for each axis and day in each part, with the part's name, number of rows, first and last time [s],
    type, in which row of the part they begin, and over how many they reach; problems: parts that are left out, and what
    is odd of others."""

    rows: pl.DataFrame
    problems: tuple[RowProblem, ...]


def survey_part(part: Part, columns: Columns) -> Survey:
    """The survey of one part; a part that cannot be read has no rows and a problem."""
    import polars as pl

    try:
        with readable("data"):
            found = _together(pl.concat([_count_window(one, columns) for one in part.windows()]))
            odd = part.other_types(columns)
    except UsageError as error:
        return Survey(_empty(), (RowProblem("", part.name, "unreadable", " ".join(str(error).split())),))
    return survey_of(part.name, found, [*odd, *_otherwise(part, columns, found)], columns.factor)


def _count_window(part: Part, columns: Columns) -> pl.DataFrame:
    """Numbers of rows in a window, with the places of the first and the last row in the file."""
    import polars as pl

    place = pl.col(_PLACE).cast(pl.Int64)
    rows = part.rows(columns).with_row_index(_PLACE, offset=part.first)
    return count_rows(rows, columns, place.min().alias(START), place.max().alias(_END)).collect(engine="streaming")


def _together(windows: pl.DataFrame) -> pl.DataFrame:
    """The rows of all windows of a file, by axis and day."""
    import polars as pl

    kind = pl.col(TYPE).filter(pl.col(TYPE) != "").min().fill_null("")
    ends = (pl.min(FIRST), pl.max(LAST), pl.min(START))
    extent = (pl.max(_END) - pl.min(START) + 1).alias(EXTENT)
    rows = windows.group_by(AXIS, "day").agg(pl.sum(ROWS, LOST), *ends, kind, extent)
    return rows.sort(AXIS, "day", nulls_last=True)


def count_rows(rows: pl.LazyFrame, columns: Columns, *more: pl.Expr) -> pl.LazyFrame:
    """Numbers of rows and of lost rows for each axis and day, with first and last time, type, and further columns
    `more`; rows: of `Part.rows`."""
    import polars as pl

    known = pl.col(AXIS).is_not_null() & pl.col(TIME).is_finite()
    kind = pl.col(TYPE).min() if columns.type else pl.lit("")
    return rows.group_by(AXIS, (pl.col(TIME) / DAY).floor().alias("day")).agg(
        known.sum().cast(pl.Int64).alias(ROWS),
        (~known | known.is_null()).sum().cast(pl.Int64).alias(LOST),
        pl.col(TIME).filter(pl.col(TIME).is_finite()).min().alias(FIRST),
        pl.col(TIME).filter(pl.col(TIME).is_finite()).max().alias(LAST),
        kind.fill_null("").alias(TYPE),
        *more,
    )


def _otherwise(part: Part, columns: Columns, found: pl.DataFrame) -> Iterator[str]:
    """Where the names of its folders and its own column tell the axis differently."""
    said = part.constants.get(columns.axis)
    others = found.filter(found[AXIS] != said)[AXIS] if said else found[AXIS][:0]
    if others.len():
        yield f"its folder says {columns.axis} = {said}, its own column {others[0]}: the column is taken"


def survey_of(name: str, found: pl.DataFrame, odd: Sequence[str], factor: float) -> Survey:
    """Of what was counted in the part of this name, where it has no order without how far each axis reaches; odd: what
    is odd of its columns; factor: seconds per unit of its times."""
    import polars as pl

    problems = [RowProblem("", name, "type", text) for text in odd]
    if not found.height:
        problems.append(RowProblem("", name, "empty", "it has no rows"))
    if EXTENT not in found.columns:
        found = found.with_columns(pl.lit(0, pl.Int64).alias(START), pl.col(ROWS).alias(EXTENT))
    lost = int(found[LOST].sum())
    if lost:
        problems.append(
            RowProblem("", name, "rows_lost", f"{lost} rows have no axis, or no number for a time: left out")
        )
    found = found.filter(pl.col(AXIS).is_not_null() & (pl.col(ROWS) > 0))
    if found.height and (text := other_unit(cast(float, found[FIRST].min()), cast(float, found[LAST].max()), factor)):
        problems.append(RowProblem("", name, "time_unit", text))
    return Survey(found.select(pl.lit(name).alias(PART), AXIS, ROWS, FIRST, LAST, TYPE, START, EXTENT), tuple(problems))


def mixture(columns: Columns) -> pl.Expr:
    """A number for each row of `Part.rows`, whose sum over rows changes with what stands in them, not with their
    order; 32 bits, so that a sum of rows stays whole."""
    import polars as pl

    names = [AXIS, TIME, INPUT, OUTPUT, *([MASK] if columns.mask else []), *([TYPE] if columns.type else [])]
    return (pl.struct(names).hash() // 2**32).cast(pl.Int64)


def content(part: Part, columns: Columns) -> str:
    """The stamp of a part that has no date: of all its rows. Empty where it cannot be read."""
    import polars as pl

    try:
        with readable("data"):
            found = part.rows(columns).select(pl.len(), mixture(columns).sum().alias("sum")).collect(engine="streaming")
    except UsageError:
        return ""
    return f"{found.item(0, 0)}-{found.item(0, 1)}"


def join_surveys(surveys: Sequence[Survey]) -> Survey:
    """One survey of all parts."""
    import polars as pl

    rows = pl.concat([_empty(), *(one.rows for one in surveys)])
    return Survey(rows, tuple(problem for one in surveys for problem in one.problems))


def _empty() -> pl.DataFrame:
    import polars as pl

    kinds = {PART: pl.String, AXIS: pl.String, ROWS: pl.Int64, FIRST: pl.Float64, LAST: pl.Float64}
    return pl.DataFrame(schema=kinds | {TYPE: pl.String, START: pl.Int64, EXTENT: pl.Int64})

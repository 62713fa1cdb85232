"""The axes and hours in the parts of a data set, and the problems of its rows and files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import polars as pl

from pmfid.errors import UsageError
from pmfid.fleet.source import AXIS, SECONDS, TIME, TYPE, Part, SourceColumns, other_unit
from pmfid.io.safety import readable

PART, HOUR, ROWS, FIRST, LAST = "part", "hour", "rows", "first", "last"
#: Numbers of the first and the last row in the part.
START, END = "start", "end"


@dataclass(frozen=True)
class RowProblem:
    """Rows or a file that cannot be used.

    `axis` is empty if the problem concerns a file, and `part` is empty if it concerns an axis. `at` is the time [s] at
    which the problem begins. `code` is the name of the problem among the findings.
    """

    axis: str
    part: str
    code: str
    text: str
    at: float = float("nan")


@dataclass(frozen=True)
class Survey:
    """The axes and hours in the parts of a data set.

    `rows` has a row for each axis and hour in each part, with its number of rows, first and last time [s], type, and
    the places of its first and last row. `problems` has parts that are left out, and peculiarities of other parts.
    Records end at the ends of hours, so that the division of the work changes no estimate.
    """

    rows: pl.DataFrame
    problems: tuple[RowProblem, ...]


def hour_of() -> pl.Expr:
    """Return the number of the hour of a row, null for a row without an axis or a valid time."""
    number = (pl.col(TIME) / SECONDS["h"]).floor().cast(pl.Int64, strict=False)
    return pl.when(pl.col(AXIS).is_not_null()).then(number).alias(HOUR)


def survey_part(part: Part, columns: SourceColumns) -> Survey:
    """Return the survey of one part. A part that cannot be read has no rows and a problem."""
    kind, time = pl.col(TYPE).min().fill_null("") if columns.type else pl.lit(""), pl.col(TIME)
    place = pl.col(START).cast(pl.Int64)
    facts = pl.len().cast(pl.Int64).alias(ROWS), time.min().alias(FIRST), time.max().alias(LAST), kind.alias(TYPE)
    try:
        with readable("data"):
            found = (
                part.rows(columns)
                .with_row_index(START)
                .group_by(AXIS, hour_of())
                .agg(*facts, place.min(), place.max().alias(END))
                .collect()
            )
            odd = part.other_types(columns)
    except UsageError as error:
        return Survey(_empty(), (unreadable(part, error),))
    said = part.constants.get(columns.axis)
    others = found.filter(pl.col(AXIS) != said)[AXIS].sort() if said else found[AXIS][:0]
    if others.len():
        odd.append(f"its folder says {columns.axis} = {said}, but its column says {others[0]}: the column is used")
    return survey_of(part.name, found, odd, columns.factor)


def survey_of(name: str, found: pl.DataFrame, odd: Sequence[str], factor: float) -> Survey:
    """Return the survey from the counts of the part `name`.

    `odd` has peculiarities of the part's columns. `factor` is the number of seconds per unit of its times.
    """
    problems = [RowProblem("", name, "type", text) for text in odd]
    if not found.height:
        problems.append(RowProblem("", name, "empty", "the file has no rows"))
    lost = int(found.filter(pl.col(HOUR).is_null())[ROWS].sum())
    if lost:
        problems.append(
            RowProblem("", name, "rows_lost", f"{lost} rows have no axis, or no valid time: these rows are left out")
        )
    found = found.drop_nulls(HOUR)
    if found.height and (text := other_unit(cast(float, found[FIRST].min()), cast(float, found[LAST].max()), factor)):
        problems.append(RowProblem("", name, "time_unit", text))
    return Survey(found.select(pl.lit(name).alias(PART), *_empty().columns[1:]), tuple(problems))


def join_surveys(surveys: Sequence[Survey]) -> Survey:
    """Return the survey of all parts. Raises UsageError if it has no rows."""
    problems = tuple(problem for one in surveys for problem in one.problems)
    rows = pl.concat([_empty(), *(one.rows for one in surveys)]).sort(HOUR, AXIS, PART)
    if not rows.height:
        reason = next((f": {one.part}: {one.text}" for one in problems if one.code == "unreadable"), "")
        raise UsageError(f"no file of the data set could be read{reason}; run pmfid check on one of the files")
    return Survey(rows, problems)


def _empty() -> pl.DataFrame:
    kinds = {PART: pl.String, AXIS: pl.String, HOUR: pl.Int64, ROWS: pl.Int64, FIRST: pl.Float64, LAST: pl.Float64}
    return pl.DataFrame(schema=kinds | {TYPE: pl.String, START: pl.Int64, END: pl.Int64})


def unreadable(part: Part, error: UsageError) -> RowProblem:
    return RowProblem("", part.name, "unreadable", " ".join(str(error).split()))

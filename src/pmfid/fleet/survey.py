"""Which axes each file of a data set has, how many rows of them and of when: from two columns, once per file.

Day by day, so that neither gaps nor a stamp from another century make the plan a bad guess.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pmfid.errors import UsageError
from pmfid.fleet.source import AXIS, TIME, TYPE, Columns, Part
from pmfid.session.formats.safety import readable

if TYPE_CHECKING:
    import polars as pl

#: [s].
DAY = 86_400.0
PART, ROWS, FIRST, LAST, EXTENT = "part", "rows", "first", "last", "extent"
_PLACE = "place in the part"


@dataclass(frozen=True)
class Problem:
    """What could not be used. axis: empty where it concerns a file; part: empty where it concerns an axis; at: time [s]
    from which on; code: its name among the findings."""

    axis: str
    part: str
    code: str
    text: str
    at: float = float("nan")


@dataclass(frozen=True)
class Survey:
    """rows: a row for each axis and day in each part, with the part's name, number of rows, first and last time [s],
    type, and over how many rows of the part they reach; problems: parts that are left out, and what is odd of
    others."""

    rows: pl.DataFrame
    problems: tuple[Problem, ...]


def surveyed(part: Part, columns: Columns) -> Survey:
    """What one part has; a part that cannot be read has no rows and a problem."""
    import polars as pl

    try:
        with readable("data"):
            frame = part.rows(columns).with_row_index(_PLACE)
            known = pl.col(AXIS).is_not_null() & pl.col(TIME).is_finite()
            kind = pl.col(TYPE).min() if columns.type else pl.lit("")
            found = (
                frame.group_by(AXIS, (pl.col(TIME) / DAY).floor().alias("day"))
                .agg(
                    known.sum().cast(pl.Int64).alias(ROWS),
                    (~known | known.is_null()).sum().cast(pl.Int64).alias("lost"),
                    pl.col(TIME).filter(pl.col(TIME).is_finite()).min().alias(FIRST),
                    pl.col(TIME).filter(pl.col(TIME).is_finite()).max().alias(LAST),
                    kind.fill_null("").alias(TYPE),
                    (pl.col(_PLACE).max() - pl.col(_PLACE).min() + 1).cast(pl.Int64).alias(EXTENT),
                )
                .sort(AXIS, "day", nulls_last=True)
                .collect(engine="streaming")
            )
            odd = [Problem("", part.name, "type", text) for text in part.other_types(columns)]
    except UsageError as error:
        return Survey(_empty(), (Problem("", part.name, "unreadable", " ".join(str(error).split())),))
    if not found.height:
        odd.append(Problem("", part.name, "empty", "it has no rows"))
    lost = int(found["lost"].sum())
    if lost:
        odd.append(Problem("", part.name, "rows_lost", f"{lost} rows have no axis, or no number for a time: left out"))
    found = found.filter(pl.col(AXIS).is_not_null() & (pl.col(ROWS) > 0)).drop("lost")
    return Survey(found.select(pl.lit(part.name).alias(PART), AXIS, ROWS, FIRST, LAST, TYPE, EXTENT), tuple(odd))


def joined(surveys: Sequence[Survey]) -> Survey:
    """Of all parts."""
    import polars as pl

    rows = pl.concat([_empty(), *(one.rows for one in surveys)])
    return Survey(rows, tuple(problem for one in surveys for problem in one.problems))


def _empty() -> pl.DataFrame:
    import polars as pl

    kinds = {PART: pl.String, AXIS: pl.String, ROWS: pl.Int64, FIRST: pl.Float64, LAST: pl.Float64}
    return pl.DataFrame(schema=kinds | {TYPE: pl.String, EXTENT: pl.Int64})

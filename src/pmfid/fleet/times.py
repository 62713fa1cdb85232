"""The time of a row of many axes [s], of a date since 1970, whatever the type of its column."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmfid.errors import UsageError
from pmfid.session.clock import EPOCHS, UNITS
from pmfid.session.tables import LONGEST_CELL

if TYPE_CHECKING:
    import polars as pl

_NANOSECOND = 1e-9
#: Of ISO 8601: what stands at the end of a time that says its distance from UTC.
_OFFSET = r"([+-])(\d\d):?(\d\d)$"
_FORM = "%Y-%m-%d %H:%M:%S%.f"


def seconds_of(column: pl.Expr, name: str, kind: pl.DataType, factor: float) -> pl.Expr:
    """[s] as float64, missing where it is none; kind: type of the column `name`; factor: seconds per unit of a number.

    Numbers, dates with a time, with or without a zone, durations, and text that is a number or a date of ISO 8601; UTC
    where no zone is named. Raises UsageError for a day without a time, a time without a day, and what is none.
    """
    import polars as pl

    if kind == pl.Datetime:
        return column.dt.epoch("ns").cast(pl.Float64) * _NANOSECOND
    if kind == pl.Duration:
        return column.cast(pl.Duration("ns")).cast(pl.Int64).cast(pl.Float64) * _NANOSECOND
    if kind in (pl.Date, pl.Time):
        raise UsageError(
            f"the column {name!r} is of type {kind}, half of a time: give a column that has both the day and the time"
        )
    if not (kind.is_numeric() or kind == pl.String):
        raise UsageError(f"the column {name!r} is of type {kind}, which is no time")
    number = column.cast(pl.Float64, strict=False)
    number = number if factor == 1 else number * factor
    return number if kind != pl.String else pl.coalesce(number, _parse_dates(column))


def _parse_dates(column: pl.Expr) -> pl.Expr:
    """Times in text of ISO 8601."""
    import polars as pl

    short = pl.when(column.str.len_bytes() <= LONGEST_CELL).then(column)  # a packed file may repeat a long one
    text = short.str.strip_chars().str.replace("T", " ", literal=True).str.replace(",", ".", literal=True)
    plain = text.str.replace(_OFFSET, "").str.strip_suffix("Z").str.strip_chars_end()
    # a day ends in a sign and digits, too: an offset follows a time
    plain = pl.when(text.str.contains(":")).then(plain)
    hours, minutes = (text.str.extract(_OFFSET, k).cast(pl.Float64, strict=False) for k in (2, 3))
    sign = pl.when(text.str.extract(_OFFSET, 1) == "-").then(-1.0).otherwise(1.0)
    ahead = (sign * (3600.0 * hours + 60.0 * minutes)).fill_null(0.0)
    stamps = plain.str.to_datetime(_FORM, time_unit="ns", strict=False)
    return stamps.dt.epoch("ns").cast(pl.Float64) * _NANOSECOND - ahead


def other_unit(first: float, last: float, factor: float) -> str:
    """What to do where times [s] lie beyond this century and another unit makes dates of it; empty where they do not.
    factor: seconds per unit that was taken."""
    if last < EPOCHS[1]:
        return ""
    fitting = [
        unit
        for unit, length in UNITS.items()
        if EPOCHS[0] <= first / factor * length and last / factor * length < EPOCHS[1]
    ]
    if not fitting:
        return ""
    return (
        f'its times are dates of this century in {fitting[0]}: give [record] time_unit = "{fitting[0]}", or where the '
        "other files have another unit, write them in that"
    )


def too_coarse(first: float) -> float:
    """What a time [s] of 32 bits can tell apart there [s]."""
    import numpy as np

    return float(np.spacing(np.float32(first)))

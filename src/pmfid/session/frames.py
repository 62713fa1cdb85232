"""Frames of pandas, Polars and Arrow, and dicts of arrays, as tables: the same columns that a file has."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from pmfid.errors import UsageError
from pmfid.session.tables import Table

if TYPE_CHECKING:
    import narwhals.stable.v2 as nw

__all__ = ["table_of"]


def table_of(frame: object) -> Table:
    """The columns of a frame, or of a dict of arrays. Raises UsageError for any other object."""
    if isinstance(frame, Mapping):
        return {str(name): np.asarray(values) for name, values in frame.items()}
    import narwhals.stable.v2 as nw

    try:
        found: nw.DataFrame[Any] = nw.from_native(_wrap_frame(frame), eager_only=True)
    except TypeError:
        raise UsageError(
            f"a record is a frame of pandas, Polars or Arrow, a dict of arrays or the path of a file, got "
            f"{type(frame).__name__}; collect a lazy frame first"
        ) from None
    return {name: _column(found[name]) for name in found.columns}


def _wrap_frame(frame: object) -> Any:
    """The frame itself if Narwhals reads it; a Polars frame of any other Arrow data."""
    import narwhals.stable.v2 as nw
    import polars as pl

    if hasattr(frame, "__arrow_c_stream__") and nw.from_native(frame, pass_through=True) is frame:
        return pl.DataFrame(frame)
    return frame


def _column(series: nw.Series[Any]) -> object:
    """A column in the form of a file's columns: whole numbers, dates and missing values stay what they are."""
    import narwhals.stable.v2 as nw
    import polars as pl

    if isinstance(series.to_native(), pl.Series):
        return series.to_native()
    if series.dtype.is_temporal() and getattr(series.dtype, "time_zone", None):
        series = series.dt.convert_time_zone("UTC").dt.replace_time_zone(None)
    if series.dtype.is_numeric():
        missing = series.is_null().any()
        return pl.Series(series.name, (series.cast(nw.Float64) if missing else series).to_numpy())
    if series.dtype.is_temporal():
        return pl.Series(series.name, series.to_numpy())
    return pl.Series(series.name, series.to_list(), strict=False)

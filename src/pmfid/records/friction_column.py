"""A slow column of a file, such as a temperature, at the samples of a record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pmfid.errors import UsageError
from pmfid.io.tables import Table, column, whole_name
from pmfid.types import Floats


@dataclass(frozen=True, eq=False)
class SlowColumn:
    """Values (m,) at stamps (m,), which are times in the unit of the file, or numbers of rows without a clock."""

    stamps: Floats
    values: Floats

    def interpolate(self, stamps: Floats) -> Floats:
        """Return the values at stamps (n,), on lines between known values."""
        return np.asarray(np.interp(stamps, self.stamps, self.values))


def read_slow_column(table: Table, key: str, name: str, columns: Mapping[str, Floats]) -> SlowColumn:
    """Return a column of a file on the clock of the other `columns`.

    Raises UsageError if the column has another length than the input, or no value.
    """
    values = column(table, key, whole_name(table, name))
    if values.size != columns["input"].size:
        raise UsageError(
            f"the column {name!r} has {values.size} rows, the input {columns['input'].size}; save them together"
        )
    stamps = columns["time"] if "time" in columns else np.arange(values.size, dtype=np.float64)
    there = np.isfinite(values) & np.isfinite(stamps)
    if not np.any(there):
        raise UsageError(f"[record] {key} = {name!r} has no value; name a column with values, or drop the key")
    order = np.argsort(stamps[there], kind="stable")
    return SlowColumn(stamps[there][order], values[there][order])

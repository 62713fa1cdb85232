"""The column with the age of the last edge of the encoder."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmfid.config.record import EncoderConfig
from pmfid.io.tables import Table, column, whole_name
from pmfid.records.clock import UNITS, named_unit
from pmfid.types import Floats


def read_edge_ages(
    table: Table, encoder: EncoderConfig, rows: NDArray[np.intp], obstacle: str
) -> tuple[Floats | None, tuple[str, ...]]:
    """Return the ages [s] of the last edges in the used rows, and notes for people.

    An age is NaN without an edge. The ages are None if no column has them, or if an `obstacle` prevents their use. A
    unit in the column's name counts. Without a unit the ages are in s. Raises UsageError for a column that is missing
    or not numeric.
    """
    if encoder.edge_age is None:
        return None, ()
    name = whole_name(table, encoder.edge_age)
    ages = column(table, "edge_age", name)
    if obstacle:
        return None, (f"the ages of edges in {name!r} are not used, because {obstacle}",)
    return np.asarray(ages[rows] * UNITS[named_unit(name) or "s"]), ()

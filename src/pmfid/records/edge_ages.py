"""Ages of the last edge of the encoder, from a column."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from pmfid.config.record import EncoderConfig
from pmfid.errors import UsageError
from pmfid.io.tables import Table, column, whole_name
from pmfid.records.clock import UNITS, named_unit
from pmfid.types import Floats

#: End of the name of a column of ages in ticks of the timer, as "age_ticks" or "age [ticks]".
_TICKS = re.compile(r"(?:^|[\s_.,:/(\[-])ticks?[)\]]?$", re.IGNORECASE)


def age_factor(name: str, tick: float) -> float:
    """Return the seconds per unit of the ages in a column with this name, which may have a unit. By default 1.

    `tick` is the period of the timer [s]. Raises UsageError for ages in ticks of an unknown timer.
    """
    if not _TICKS.search(name.strip()):
        return UNITS[named_unit(name) or "s"]
    if not tick > 0:
        raise UsageError(f"the ages in {name!r} are in ticks: give the period of the timer, as [encoder] tick = 1e-6")
    return tick


def read_edge_ages(
    table: Table, encoder: EncoderConfig, rows: NDArray[np.intp], obstacle: str
) -> tuple[Floats | None, tuple[str, ...]]:
    """Return the ages [s] of the last edges in the used rows, and notes for people.

    An age is NaN without an edge. The ages are None if no column has them, or if an `obstacle` prevents their use. A
    unit in the column's name counts, also ticks. Without a unit the ages are in s. Raises UsageError for a column that
    is missing or not numeric.
    """
    if encoder.edge_age is None:
        return None, ()
    name = whole_name(table, encoder.edge_age)
    ages = column(table, "edge_age", name)
    if obstacle:
        return None, (f"the ages of edges in {name!r} are not used, because {obstacle}",)
    return np.asarray(ages[rows] * age_factor(name, encoder.tick)), ()

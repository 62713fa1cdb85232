"""The choice of the time column of a log."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import UsageError
from pmfid.io.tables import Table, times
from pmfid.pipeline.guess.roles import PAIRS_CLEAR, evidence_of
from pmfid.records.clock import is_rounded, named_unit
from pmfid.types import Floats

#: Smallest part of the steps of a time column that grow or are even.
COLUMNS_MOSTLY = 0.9


@dataclass(frozen=True, eq=False)
class Stamps:
    """A time column by name, with its values (n,), their rows (n,), and whether these are dates or times of day."""

    name: str
    values: Floats
    rows: NDArray[np.intp]
    written: bool

    @property
    def may_be_numbers(self) -> bool:
        """Whether a column without a unit grows by 1 from row to row, as a sample number does."""
        steps = np.diff(self.values)
        return not self.written and named_unit(self.name) is None and bool(np.all((steps == 1) | (steps == 0)))


def rises(values: Floats) -> bool:
    """Return whether a column (n,) never falls and grows in most rows, as only a time or a number does.

    The rows at the start of some loggers are equal, and a clock with few digits repeats stamps.
    """
    steps = np.diff(values)
    grows = float(np.mean(steps > 0)) > COLUMNS_MOSTLY or is_rounded(values)
    return grows and bool(np.all(steps >= 0))


def time_of(table: Table, columns: Mapping[str, Floats], given: str | None = None) -> Stamps | None:
    """Return the time column of a table, or None without one.

    Names and values decide together: a time never falls, and grows by nearly equal steps. `given` is the column that
    the user names. Raises UsageError if that column has no numbers.
    """
    if given is not None:
        return _read(table, given)
    scored: list[tuple[float, Stamps]] = []
    for name in table:
        weight = _name_weight(name)
        if weight > 0 or (name in columns and rises(columns[name])):
            with suppress(UsageError):
                stamps = _read(table, name)
                scored.append((weight + _value_weight(stamps), stamps))
    best = max(scored, key=lambda pair: pair[0], default=None)
    return best[1] if best is not None and best[0] > 0 else None


def _read(table: Table, name: str) -> Stamps:
    values, written = times(table, name)
    rows = np.flatnonzero(np.isfinite(values))
    values = values[rows]
    first = max(0, int(np.argmax(values != values[0])) - 1) if values.size else 0
    return Stamps(name, values[first:], rows[first:], written)


def _name_weight(name: str) -> float:
    """Return the log-odds by its name that a column is the time. A sample number may be the time, too."""
    evidence = evidence_of(name)
    if evidence.lean("time", "number") <= 0:
        return min(0.0, evidence.lean("time"))
    return evidence.weights.get("time", 0.0) - 0.5 * evidence.weights.get("number", 0.0)


def _value_weight(stamps: Stamps) -> float:
    """Return the log-odds by its values that a column is the time.

    A motion at a constant speed grows as well, but not by equal steps in each row.
    """
    steps = np.diff(stamps.values)
    if stamps.values.size <= 10 or not np.any(steps > 0):
        return -np.inf
    if np.mean(steps >= 0) < COLUMNS_MOSTLY:
        return -2 * PAIRS_CLEAR
    usual = np.clip(steps, 0, np.quantile(steps, COLUMNS_MOSTLY))
    even = is_rounded(stamps.values) or float(np.mean(np.abs(steps - np.median(steps)) <= np.mean(usual) / 2))
    grows, falls = np.mean(steps > 0) > COLUMNS_MOSTLY, np.any(steps < 0)
    return PAIRS_CLEAR * (2 * even - 1 + float(grows) - float(falls)) - stamps.may_be_numbers

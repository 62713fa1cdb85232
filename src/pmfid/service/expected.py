"""Blocks of many axes that are all what was expected: taken at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmfid.service.clock import due, fits, runs
from pmfid.service.delivery import Table
from pmfid.service.positions import Positions
from pmfid.types import Flags

__all__ = ["take_expected"]


def take_expected(positions: Positions, dt: float, index: NDArray[np.int64], table: Table) -> Flags:
    """Takes of a table those blocks that are what was expected next, and of which there is nothing to tell: what
    `Order.take` does with each of these, for all at once. index: (k,) their axes, each once, -1 where there is none.
    Returns (k,) which they are."""
    with np.errstate(invalid="ignore"):
        taken = _expected(positions, dt, index, table)
    at, end = index[taken], table.first[taken] + table.counts.shape[1]
    positions.expected[at] = end
    timed = ~np.isnan(table.time[taken])
    at, end, begun = at[timed], end[timed], table.time[taken][timed]
    positions.time[at], positions.number[at] = begun + table.counts.shape[1] * dt, end
    return taken


def _expected(positions: Positions, dt: float, index: NDArray[np.int64], table: Table) -> Flags:
    known, first, time = positions, table.first, table.time
    off = time - known.time[index] - (first - known.number[index]) * dt
    at_rate = np.logical_not(due(first - known.first[index], time - known.start[index]))
    quiet = np.isnan(time) | np.logical_and(runs(off), at_rate)
    next_one = (table.epoch == known.epoch[index]) & (first == known.expected[index]) & ~known.waits[index]
    found: Flags = np.logical_and((index >= 0) & next_one & quiet, fits(table.dt, dt))
    return found

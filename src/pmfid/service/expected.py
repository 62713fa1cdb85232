"""Blocks of many axes that are all what was expected: taken at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmfid.service.clock import due, fits, right, runs
from pmfid.service.delivery import Table
from pmfid.service.positions import Positions
from pmfid.types import Flags

__all__ = ["take_expected"]


def take_expected(positions: Positions, dt: float, index: NDArray[np.int64], table: Table) -> Flags:
    """Takes of a table those blocks that are what was expected next, and of which there is nothing to tell: what
    `Order.take` does with each of these, for all at once. index: (k,) their axes, each once, -1 where there is none.
    Returns (k,) which they are."""
    n, known = table.counts.shape[1], positions
    samples, time = table.first - known.first[index], table.time - known.start[index]
    with np.errstate(invalid="ignore", divide="ignore"):
        measured = due(samples, time)
        at_rate = np.logical_not(measured) | (right(time / (samples * dt)) & ~known.told[index])
        taken = _expected(known, dt, index, table) & (np.isnan(table.time) | at_rate)
    known.expected[index[taken]] = table.first[taken] + n
    timed = taken & ~np.isnan(table.time)
    known.time[index[timed]], known.number[index[timed]] = table.time[timed] + n * dt, table.first[timed] + n
    renewed = timed & measured
    known.start[index[renewed]], known.first[index[renewed]] = table.time[renewed], table.first[renewed]
    return taken


def _expected(positions: Positions, dt: float, index: NDArray[np.int64], table: Table) -> Flags:
    """But for the rate of their clocks."""
    known, first, time = positions, table.first, table.time
    off = time - known.time[index] - (first - known.number[index]) * dt
    quiet = np.logical_or(np.isnan(time), runs(off))
    next_one = (table.epoch == known.epoch[index]) & (first == known.expected[index]) & ~known.waits[index]
    found: Flags = np.logical_and((index >= 0) & next_one & quiet, fits(table.dt, dt))
    return found

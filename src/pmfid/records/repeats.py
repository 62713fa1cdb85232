"""Rows that repeat the previous output during motion, because a bus is polled faster than it is refreshed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pmfid.records.clock import LONG_STEPS
from pmfid.types import Flags, Floats

#: Smallest number of counts in the rows before and after a row without counts. No real motion has such a sudden
#: stop.
REPEATS_SUDDEN = 3.0
#: Largest number of rows with one value. More rows are a stop or a stuck sensor. `REPEATS_LONGEST_SLOW` is the
#: limit if the next value does not catch up.
REPEATS_LONGEST = 8
REPEATS_LONGEST_SLOW = 4
#: Smallest and greatest part of the fast rows that repeat an output. An output that is held in every second row has
#: its own remedy.
REPEATS_PART = 0.005
REPEATS_MOST = 0.5
#: Smallest error of an old value [steps of the encoder]. A value with a smaller error is as good as a new value.
REPEATS_OFF = 0.75


def miss_stale_rows(columns: Mapping[str, Floats], step: float) -> tuple[Floats, int]:
    """Return the output (n,) with NaN in rows with an old value, and their number, from columns of input, output and
    time.

    `step` is the step of the encoder in the unit of the column. The function changes nothing unless all rows have
    numbers and the time rises.
    """
    time, y = columns["time"], columns["output"]
    if not (all(np.all(np.isfinite(values)) for values in columns.values()) and np.all(np.diff(time) > 0)):
        return y, 0
    stale = find_stale_rows(time, y / step)
    return np.where(stale, np.nan, y), int(np.count_nonzero(stale))


def find_stale_rows(time: Floats, y: Floats) -> Flags:
    """Mark the rows (n,) that repeat the previous output and lie off the cubic through the neighbouring new values.

    The output `y` is in steps of the encoder. The function marks rows only if single rows without a change lie between
    rows with changes of many steps. No motion does so.
    """
    stale = np.zeros(y.size, bool)
    if _count_sudden_rests(np.diff(y)) < LONG_STEPS:
        return stale
    new = np.flatnonzero(np.diff(y, prepend=np.nan))
    if new.size < LONG_STEPS:
        return stale
    before, after = np.diff(y[new])[:-1], np.diff(y[new])[1:]
    rows_each = np.diff(new)
    # After a stop, no value catches up.
    caught_up = np.append(False, np.abs(after) > 0.5 * rows_each[1:] * np.abs(before))
    rests = (rows_each > 1) & (rows_each <= np.where(caught_up, REPEATS_LONGEST, REPEATS_LONGEST_SLOW))
    fast = (np.sign(before) == np.sign(after)) & (np.minimum(np.abs(before), np.abs(after)) > REPEATS_SUDDEN)
    sudden, most = int(np.count_nonzero(fast & rests[1:])), int(np.count_nonzero(fast))
    if sudden < LONG_STEPS or not REPEATS_PART * most < sudden < REPEATS_MOST * most:
        return stale
    inner = np.flatnonzero(rests[1:-1]) + 1
    rows = np.concatenate([new[inner] + i for i in range(1, REPEATS_LONGEST)])
    place = np.concatenate([inner] * (REPEATS_LONGEST - 1))
    rows, place = rows[rows < new[place + 1]], place[rows < new[place + 1]]
    off = _cubic(time[new], y[new], place, time[rows]) - y[rows]
    stale[rows[np.abs(off) > REPEATS_OFF]] = True
    return stale


def _count_sudden_rests(change: Floats) -> int:
    """Return at least the number of short rests within fast motion, from the change (n,) per row.

    Most records have none, and then need no search for stale rows.
    """
    stops = np.flatnonzero((change[1:] == 0) & (np.abs(change[:-1]) > REPEATS_SUDDEN))
    soon = np.minimum(stops[:, None] + np.arange(2, REPEATS_LONGEST + 1), change.size - 1)
    goes_on = change[soon] * np.sign(change[stops])[:, None] > REPEATS_SUDDEN
    return int(np.count_nonzero(np.any(goes_on, axis=1)))


def _cubic(time: Floats, y: Floats, place: NDArray[np.intp], at: Floats) -> Floats:
    """Return values of cubic polynomials at the times `at` (m,). Each fitted polynomial passes through four
    neighbouring points, and `place` (m,) is the second point.
    """
    values = np.zeros(at.size)
    for i in range(-1, 3):
        weight = np.ones(at.size)
        for j in range(-1, 3):
            if i != j:
                weight *= (at - time[place + j]) / (time[place + i] - time[place + j])
        values += weight * y[place + i]
    return values

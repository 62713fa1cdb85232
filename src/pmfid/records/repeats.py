"""Rows that repeat the previous output during motion, because a bus is polled faster than it is refreshed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pmfid.records.tuning import TUNING
from pmfid.types import Flags, Floats

__all__ = ["drop_stale_rows"]


def drop_stale_rows(columns: Mapping[str, Floats], step: float) -> tuple[dict[str, Floats], int]:
    """Remove the rows with an old output from the columns (n,) of input, output and time.

    The function returns the columns and the number of removed rows. `step` is the step of the encoder in the unit of
    the column. The function changes nothing unless all rows have numbers and the time rises. The input of a kept row is
    its mean until the next row, so that no impulse is lost. A row at which the input jumps remains, because a mean
    would move the jump. The output of a row with a jump comes from the cubic through the neighbouring rows.
    """
    time, u, y = columns["time"], columns["input"], columns["output"]
    if not (all(np.all(np.isfinite(values)) for values in (u, y, time)) and np.all(np.diff(time) > 0)):
        return dict(columns), 0
    stale = find_stale_rows(time, y / step)
    count = int(np.count_nonzero(stale))
    if not count:
        return dict(columns), 0
    true, jumps = np.flatnonzero(~stale), np.abs(np.diff(u, prepend=u[0])) > TUNING.repeats_jump * np.ptp(u)
    filled = np.flatnonzero(stale & jumps)
    place = np.clip(np.searchsorted(true, filled) - 1, 1, true.size - 3)
    y = y.copy()
    y[filled] = np.rint(_cubic(time[true], y[true], place, time[filled]) / step) * step
    kept = np.flatnonzero(~stale | jumps)
    impulse = np.append(0.0, np.cumsum(u[:-1] * np.diff(time)))
    mean = np.append(np.diff(impulse[kept]) / np.diff(time[kept]), u[kept[-1]])
    alone = np.append(np.diff(kept) == 1, True)
    return {**columns, "time": time[kept], "input": np.where(alone, u[kept], mean), "output": y[kept]}, count


def find_stale_rows(time: Floats, y: Floats) -> Flags:
    """Mark the rows (n,) that repeat the previous output and lie off the cubic through the neighbouring new values.

    The output `y` is in steps of the encoder. The function marks rows only if single rows without a change lie between
    rows with changes of many steps. No motion does so.
    """
    stale = np.zeros(y.size, bool)
    if _count_sudden_rests(np.diff(y)) < TUNING.repeats_fewest:
        return stale
    new = np.flatnonzero(np.diff(y, prepend=np.nan))
    if new.size < TUNING.repeats_fewest:
        return stale
    before, after = np.diff(y[new])[:-1], np.diff(y[new])[1:]
    rows_each = np.diff(new)
    # After a stop, no value catches up.
    caught_up = np.append(False, np.abs(after) > 0.5 * rows_each[1:] * np.abs(before))
    rests = (rows_each > 1) & (rows_each <= np.where(caught_up, TUNING.repeats_longest, TUNING.repeats_longest_slow))
    fast = (np.sign(before) == np.sign(after)) & (np.minimum(np.abs(before), np.abs(after)) > TUNING.repeats_sudden)
    sudden, most = int(np.count_nonzero(fast & rests[1:])), int(np.count_nonzero(fast))
    if sudden < TUNING.repeats_fewest or not TUNING.repeats_part * most < sudden < TUNING.repeats_most * most:
        return stale
    inner = np.flatnonzero(rests[1:-1]) + 1
    rows = np.concatenate([new[inner] + i for i in range(1, TUNING.repeats_longest)])
    place = np.concatenate([inner] * (TUNING.repeats_longest - 1))
    rows, place = rows[rows < new[place + 1]], place[rows < new[place + 1]]
    off = _cubic(time[new], y[new], place, time[rows]) - y[rows]
    stale[rows[np.abs(off) > TUNING.repeats_off]] = True
    return stale


def _count_sudden_rests(change: Floats) -> int:
    """Return at least the number of short rests within fast motion, from the change (n,) per row.

    Most records have none, and then need no search for stale rows.
    """
    stops = np.flatnonzero((change[1:] == 0) & (np.abs(change[:-1]) > TUNING.repeats_sudden))
    soon = np.minimum(stops[:, None] + np.arange(2, TUNING.repeats_longest + 1), change.size - 1)
    goes_on = change[soon] * np.sign(change[stops])[:, None] > TUNING.repeats_sudden
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

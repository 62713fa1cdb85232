"""Gaps in a record: which inputs in them are known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmfid.types import Counts, Flags, Floats

#: Smallest part of the samples in which a held input does not change.
GAPS_HELD = 0.5
#: Quantile of the times for which a held input keeps its values. Gaps shorter than this quantile are filled.
GAPS_SHORTEST = 0.02
#: Length of gaps that straight lines bridge where no motion can restart after each [samples].
GAPS_BRIDGED = 8


def place_samples(
    u: Floats, counts: Counts, places: NDArray[np.intp], inputs: Floats, bridged: bool
) -> tuple[Floats, Counts, Flags]:
    """Return input and counts (n,) on the whole grid from samples (m,) at their places, and a mask of the measured
    samples.

    In gaps, the counts follow a straight line, and the input is NaN unless it is known. `inputs` (n,) has the inputs
    that were measured without a count, and NaN elsewhere. `bridged` says whether the counts determine the travel in a
    gap. Without the travel, no input in a gap is of use.
    """
    grid, there = np.arange(places[-1] + 1), np.zeros(places[-1] + 1, bool)
    there[places] = True
    whole = np.rint(np.interp(grid, places, (counts - counts[0]).astype(np.float64))).astype(np.int64) + counts[0]
    whole[places] = counts
    line = inputs.copy()
    line[places] = u
    return hold_input(line, grid) if bridged else np.where(there, line, np.nan), whole, there


def hold_input(u: Floats, time: Floats) -> Floats:
    """Return the input (n,) with values in gaps between two equal values of an input that keeps its values.

    A gap (NaN) may take as much time (n,) as nearly all intervals for which the input keeps its values.
    """
    there = np.isfinite(u)
    pairs = there[1:] & there[:-1]
    if np.all(there) or not (np.any(pairs) and np.mean((np.diff(u) == 0)[pairs]) > GAPS_HELD):
        return u
    rows = np.flatnonzero(there)
    switches = rows[1:][np.diff(u[rows]) != 0]
    longest = np.quantile(np.diff(time[np.r_[rows[0], switches, rows[-1]]]), GAPS_SHORTEST)
    held = np.append((np.diff(time[rows]) <= longest) & (np.diff(u[rows]) == 0), [False, False])
    last = np.cumsum(there) - 1  # -1 before the first known input, which is the last entry of `held`
    return np.where(held[last], u[rows[last]], u)


def bridge_input(u: Floats) -> Floats:
    """Return the input (n,) with straight lines in short gaps (NaN), or the input itself without any.

    The switches of an input in a gap are then wrong, so that a motion that restarts after the gap is better.
    """
    there = np.isfinite(u)
    rows, place = np.flatnonzero(there), np.cumsum(there)
    if np.all(there) or not rows.size:
        return u
    lost = np.append(rows, u.size)[np.minimum(place, rows.size)] - rows[np.maximum(place, 1) - 1] - 1
    short = ~there & (place > 0) & (place < rows.size) & (lost <= GAPS_BRIDGED)
    return np.where(short, np.interp(np.arange(u.size), rows, u[rows]), u) if np.any(short) else u


def describe_missing(u: Floats, there: Flags) -> str:
    """Describe the missing samples of a record, and how the fit treats them."""
    edges = np.flatnonzero(np.diff(np.r_[True, there, True].astype(np.int8)))
    unknown = sum(bool(np.any(np.isnan(u[first:last]))) for first, last in edges.reshape(-1, 2).tolist())
    lost, gaps = int(np.count_nonzero(~there)), edges.size // 2
    head = f"{lost} of {there.size} samples are missing ({lost / there.size:.1%}), in {gaps} gap{'s' * (gaps > 1)}: "
    after = "the motion restarts after each"
    if unknown in (0, gaps):
        return head + (after if unknown else "the input in each is known")
    return head + f"the input in {gaps - unknown} is known, {after} of the other {unknown}"

"""Values for missing samples by interpolation between measured samples.

A held input that differs on the two sides of a gap has changed within it. The straight line is its mean over all
possible instants of the change (`motion` finds the instant). Any other input is interpolated (`local`). In a gap that
hides more than one change, or is too long, the input is NaN, and the motion restarts after the gap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmfid.session.gaps.local import Polynomial, best_of
from pmfid.types import Counts, Flags, Floats

#: Least part of the samples in which a held input does not change.
HELD = 0.5
#: Quantile of the times for which a held input keeps its values; shorter gaps are filled.
SHORTEST = 0.02
#: Lengths of gaps [samples] that may be filled.
LENGTHS = (1, 2, 3, 5, 8, 12, 20, 30, 50, 100)
#: Largest error of the interpolated mean input over a gap, as a part of the root mean square input.
FAITHFUL = 0.1
#: If more than the part SCATTERED of the samples stays missing, gaps of up to ALWAYS samples are filled in any case:
#: between scattered gaps no motion could restart.
ALWAYS, SCATTERED = 8, 0.02
#: Samples without input between two joined records.
APART = 20


@dataclass(frozen=True)
class Gap:
    """Samples `before` + 1 to `after` - 1 are missing."""

    before: NDArray[np.intp]
    after: NDArray[np.intp]

    @property
    def missing(self) -> NDArray[np.intp]:
        """Number of missing samples in each gap."""
        return np.asarray(self.after - self.before - 1, np.intp)


def gaps_of(there: Flags) -> Gap:
    """The gaps between measured samples; there (n,)."""
    places = np.flatnonzero(there)
    first = np.flatnonzero(np.diff(places) > 1)
    return Gap(places[first], places[first + 1])


def is_held(u: Floats, there: Flags) -> bool:
    """Does the input (n,) keep its values for several samples? An input that sometimes rests, and otherwise changes in
    every sample, does not."""
    pairs = there[1:] & there[:-1]
    return bool(np.any(pairs) and np.mean((np.diff(u) == 0)[pairs]) > HELD and _longest_held(u, there) > 0)


def fill_gaps(
    u: Floats, counts: Counts, places: NDArray[np.intp], *, bridged: bool = True
) -> tuple[Floats, Counts, Flags]:
    """Input and counts (n,) on the whole grid, from samples (m,) at their places, and which samples were measured. The
    input is NaN in gaps that are too long; the counts are on a straight line.

    bridged: do the counts determine the travel in a gap? The counts of a velocity do not: all its gaps are too long."""
    grid, there = np.arange(places[-1] + 1), np.zeros(places[-1] + 1, bool)
    there[places] = True
    whole = np.rint(np.interp(grid, places, (counts - counts[0]).astype(np.float64))).astype(np.int64) + counts[0]
    whole[places] = counts
    line, gap = np.interp(grid, places, u), gaps_of(there)
    if is_held(line, there) or not gap.before.size:
        longest = _longest_held(line, there)
    else:
        local = best_of(u, places)
        line, longest = local.fill_grid(u, places), _longest_bridged(local, u, places, int(np.max(gap.missing)))
    if np.mean(~there & ~np.isnan(line)) > SCATTERED:
        longest = max(longest, min(ALWAYS, int(np.quantile(gap.missing, 0.99)) if gap.missing.size else 0))
    longest = longest if bridged else 0
    for first, last in zip(gap.before, gap.after, strict=True):
        if last - first - 1 > longest:
            line[first + 1 : last] = np.nan
    return line, whole, there


def describe_missing(u: Floats, there: Flags) -> str:
    """The missing samples of a record, and how they are filled, for people."""
    lost, gap = int(np.count_nonzero(~there)), gaps_of(there)
    long = np.isnan(u[gap.before + 1])
    part, plural = lost / there.size, "s" * (long.size > 1)
    head = f"{lost} of {there.size} samples are missing ({part:.1%}), in {long.size} gap{plural}: "
    if not np.any(long):
        return head + "filled in, by the samples around them and the motion of the model"
    after = "the motion restarts after each"
    if np.all(long):
        return head + f"left out, {after}"
    return head + f"{np.count_nonzero(~long)} short ones are filled in, {np.count_nonzero(long)} left out: {after}"


def _longest_held(u: Floats, there: Flags) -> int:
    """Longest gap that hides at most one change of a held input (n,) [samples]."""
    places = np.flatnonzero(there)
    changes = places[1:][np.diff(u[places]) != 0]
    if changes.size < 2:
        return LENGTHS[-1]
    return int(min(LENGTHS[-1], np.quantile(np.diff(changes), SHORTEST) - 1))


def _longest_bridged(local: Polynomial, u: Floats, places: NDArray[np.intp], most: int) -> int:
    """Longest gap that interpolation fills faithfully [samples], by the samples u (m,) at their places (m,); at most
    the longest gap of the record."""
    size, longest = float(np.sqrt(np.mean(u**2))), 0
    for length in LENGTHS:
        if u.size < 10 * (length + 2) or local.estimate_error(u, places, length) > FAITHFUL * size * length:
            break
        longest = length
        if length >= most:
            break
    return longest

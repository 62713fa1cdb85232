"""What stands in the place of samples that are missing, as far as the samples around them tell it.

A held input that differs on the two sides of a gap has changed somewhere in it: the straight line is its mean over all
instants at which it may have done so (`motion` finds the instant). Any other is continued by the samples near by
(`local`). In a gap that hides more than that the input is not known: it is NaN there, and what comes behind begins
anew.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmfid.session.gaps.local import Polynomial, best_of
from pmfid.types import Counts, Flags, Floats

#: An input that is the same as before in more than this part of the samples is held for several of them.
HELD = 0.5
#: Nearly all of its values are held for longer than this quantile; and a gap is filled that is shorter than they.
SHORTEST = 0.02
#: Lengths of gaps [samples] that may be filled.
LENGTHS = (1, 2, 3, 5, 8, 12, 20, 30, 50, 100)
#: What interpolation misses of the mean input over a gap, as a part of the root mean square input, is little.
FAITHFUL = 0.1
#: Gaps of up to so many samples are filled however little is known of the input: with this part of the samples gone at
#: random there is nothing between them that could begin anew.
ALWAYS, SCATTERED = 8, 0.02
#: At the ends of a record, and between two of them, the filters see so many samples of nothing.
APART = 20


@dataclass(frozen=True)
class Gap:
    """Samples `before` + 1 to `after` - 1 are missing."""

    before: NDArray[np.intp]
    after: NDArray[np.intp]

    @property
    def missing(self) -> NDArray[np.intp]:
        """How many."""
        return np.asarray(self.after - self.before - 1, np.intp)


def gaps_of(there: Flags) -> Gap:
    """The gaps between samples (n,) that are there."""
    places = np.flatnonzero(there)
    first = np.flatnonzero(np.diff(places) > 1)
    return Gap(places[first], places[first + 1])


def is_held(u: Floats, there: Flags) -> bool:
    """Does the input (n,) keep its value for several samples? One that rests now and then, and else changes in every
    sample, does not."""
    beside = there[1:] & there[:-1]
    return bool(np.any(beside) and np.mean((np.diff(u) == 0)[beside]) > HELD and _longest_held(u, there) > 0)


def fill_gaps(
    u: Floats, counts: Counts, places: NDArray[np.intp], *, bridged: bool = True
) -> tuple[Floats, Counts, Flags]:
    """Input and counts (n,) on the whole grid, from those (m,) at their places, and which of them were measured. The
    input is NaN in gaps that are too long; the counts are on a straight line.

    bridged: do the counts tell what was moved in a gap? A velocity does not: its gaps are all too long."""
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


def missing_said(u: Floats, there: Flags) -> str:
    """What is missing of a record, and what became of it, for people."""
    lost, gap = int(np.count_nonzero(~there)), gaps_of(there)
    long = np.isnan(u[gap.before + 1])
    part, plural = lost / there.size, "s" * (long.size > 1)
    said = f"{lost} of {there.size} samples are missing ({part:.1%}), in {long.size} gap{plural}: "
    if not np.any(long):
        return said + "filled in, by the samples around them and the motion of the model"
    behind = "what is behind each begins anew"
    if np.all(long):
        return said + f"left out, {behind}"
    return said + f"{np.count_nonzero(~long)} short ones are filled in, {np.count_nonzero(long)} left out: {behind}"


def _longest_held(u: Floats, there: Flags) -> int:
    """Missing samples that hide one change of a held input (n,) at most."""
    places = np.flatnonzero(there)
    changes = places[1:][np.diff(u[places]) != 0]
    if changes.size < 2:
        return LENGTHS[-1]
    return int(min(LENGTHS[-1], np.quantile(np.diff(changes), SHORTEST) - 1))


def _longest_bridged(local: Polynomial, u: Floats, places: NDArray[np.intp], most: int) -> int:
    """Missing samples of whose mean little is missed, by the samples u (m,) at their places (m,); of no more than the
    gaps have."""
    size, longest = float(np.sqrt(np.mean(u**2))), 0
    for length in LENGTHS:
        if u.size < 10 * (length + 2) or local.estimate_error(u, places, length) > FAITHFUL * size * length:
            break
        longest = length
        if length >= most:
            break
    return longest

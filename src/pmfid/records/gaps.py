"""Gaps in a record, and values for lost samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmfid.records.tuning import TUNING
from pmfid.types import Counts, Flags, Floats


@dataclass(frozen=True)
class Polynomial:
    """A polynomial of a degree, fitted by least squares to `half` samples on either side."""

    degree: int
    half: int

    def fill_grid(self, u: Floats, places: NDArray[np.intp]) -> Floats:
        """Return the input (n,) at every place from 0 to the last, given u (m,) at rising places (m,)."""
        whole = np.empty(int(places[-1]) + 1)
        missing = np.setdiff1d(np.arange(whole.size), places)
        whole[places] = u
        for first in range(0, missing.size, TUNING.gaps_chunk):
            at = missing[first : first + TUNING.gaps_chunk]
            start = np.clip(np.searchsorted(places, at) - self.half, 0, places.size - 2 * self.half)
            whole[at] = self._interpolate_at(u, places, start[:, None] + np.arange(2 * self.half), at)
        return whole

    def estimate_error(self, u: Floats, places: NDArray[np.intp], length: int) -> float:
        """Return the root mean square error of the sum of `length` successive samples.

        The error comes from measured samples, and is infinite if their number is too small.
        """
        first = np.arange(self.half, places.size - self.half - length + 1)
        first = first[places[first + length - 1] - places[first] == length - 1]
        if first.size < TUNING.gaps_fewest:
            return np.inf
        first = first[:: -(-first.size // TUNING.gaps_most)]
        neighbours = np.r_[np.arange(-self.half, 0), np.arange(length, length + self.half)]
        rows, missed = first[:, None] + neighbours, np.zeros(first.size)
        for k in range(length):
            missed += self._interpolate_at(u, places, rows, places[first + k]) - u[first + k]
        return float(np.sqrt(np.mean(missed**2)))

    def _interpolate_at(
        self, u: Floats, places: NDArray[np.intp], rows: NDArray[np.intp], at: NDArray[np.intp]
    ) -> Floats:
        """Return values (t,) at places (t,), interpolated from the samples in rows (t, 2 half)."""
        apart = (places[rows] - at[:, None]).astype(np.float64)
        weight = np.where(np.abs(apart) <= TUNING.gaps_near * self.half, 1.0, TUNING.far_weight)
        powers = (apart / np.max(np.abs(apart), axis=1, keepdims=True))[..., None] ** np.arange(self.degree + 1)
        weighted = (weight[..., None] * powers).transpose(0, 2, 1)
        level = np.mean(u[rows], axis=1)
        right = weighted @ (u[rows] - level[:, None])[..., None]
        return np.asarray(np.linalg.solve(weighted @ powers, right)[:, 0, 0] + level)


#: Candidate polynomials, which are a line, cubics through more and more samples, and a mean for an input of pure noise.
TRIED = (
    Polynomial(1, 1),
    Polynomial(3, 2),
    Polynomial(3, 3),
    Polynomial(3, 4),
    Polynomial(3, 6),
    Polynomial(3, 8),
    Polynomial(0, 8),
)


def best_of(u: Floats, places: NDArray[np.intp]) -> Polynomial:
    """Return the polynomial with the smallest error on the samples u (m,) at rising places (m,).

    If the samples are too few, the function returns the line.
    """
    return min(TRIED, key=lambda tried: tried.estimate_error(u, places, 1) if places.size > 2 * tried.half else np.inf)


@dataclass(frozen=True)
class Gap:
    """Gaps, each with the missing samples `before` + 1 to `after` - 1."""

    before: NDArray[np.intp]
    after: NDArray[np.intp]

    @property
    def missing(self) -> NDArray[np.intp]:
        """The number of missing samples in each gap."""
        return np.asarray(self.after - self.before - 1, np.intp)


def gaps_of(there: Flags) -> Gap:
    """Return the gaps between the measured samples, which `there` (n,) marks."""
    places = np.flatnonzero(there)
    first = np.flatnonzero(np.diff(places) > 1)
    return Gap(places[first], places[first + 1])


def is_held(u: Floats, there: Flags) -> bool:
    """Return whether the input (n,) keeps its values for several samples.

    An input that rests occasionally and otherwise changes in every sample is not held.
    """
    pairs = there[1:] & there[:-1]
    return bool(np.any(pairs) and np.mean((np.diff(u) == 0)[pairs]) > TUNING.gaps_held and _longest_held(u, there) > 0)


def fill_gaps(
    u: Floats, counts: Counts, places: NDArray[np.intp], *, bridged: bool = True, inputs: Floats | None = None
) -> tuple[Floats, Counts, Flags]:
    """Return input and counts (n,) on the whole grid from samples (m,) at their places, and a mask of the measured
    samples.

    In gaps that are too long, the input is NaN and the counts follow a straight line. `bridged` says whether the counts
    determine the travel in a gap. The counts of a velocity do not determine the travel, so that all gaps are too long.
    `inputs` (n,) has the inputs that were measured without a count, and NaN elsewhere.
    """
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
    if np.mean(~there & ~np.isnan(line)) > TUNING.gaps_scattered:
        longest = max(longest, min(TUNING.gaps_always, int(np.quantile(gap.missing, 0.99)) if gap.missing.size else 0))
    if inputs is not None:
        line = np.where(np.isfinite(inputs), inputs, line)
    longest = longest if bridged else 0
    for first, last in zip(gap.before, gap.after, strict=True):
        if last - first - 1 > longest:
            line[first + 1 : last] = np.nan
    return line, whole, there


def describe_missing(u: Floats, there: Flags) -> str:
    """Describe the missing samples of a record, and how the fit treats them."""
    lost, gap = int(np.count_nonzero(~there)), gaps_of(there)
    long = np.isnan(u[gap.before + 1])
    part, plural = lost / there.size, "s" * (long.size > 1)
    head = f"{lost} of {there.size} samples are missing ({part:.1%}), in {long.size} gap{plural}: "
    if not np.any(long):
        return head + "the input in each is known or interpolated"
    after = "the motion restarts after each"
    if np.all(long):
        return head + after
    short = np.count_nonzero(~long)
    return head + f"the input in {short} is known or interpolated, {after} of the other {np.count_nonzero(long)}"


def _longest_held(u: Floats, there: Flags) -> int:
    """Return the longest gap that hides at most one change of a held input (n,) [samples]."""
    places = np.flatnonzero(there)
    changes = places[1:][np.diff(u[places]) != 0]
    if changes.size < 2:
        return TUNING.gaps_lengths[-1]
    return int(min(TUNING.gaps_lengths[-1], np.quantile(np.diff(changes), TUNING.gaps_shortest) - 1))


def _longest_bridged(local: Polynomial, u: Floats, places: NDArray[np.intp], most: int) -> int:
    """Return the longest gap that interpolation fills faithfully [samples], for samples u (m,) at their places (m,).

    The result is at most the longest gap of the record.
    """
    size, longest = float(np.sqrt(np.mean(u**2))), 0
    for length in TUNING.gaps_lengths:
        if u.size < 10 * (length + 2) or local.estimate_error(u, places, length) > TUNING.gaps_faithful * size * length:
            break
        longest = length
        if length >= most:
            break
    return longest

"""The instants of samples with uneven time stamps.

The stamps are the instants of the samples, or the times at which samples of an even clock arrived.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pmfid.elementary import line_through
from pmfid.records.clock import (
    CLOCK_EVEN,
    CLOCK_GROUP,
    CLOCK_LONGEST,
    CLOCK_SAME,
    LARGEST_NUMBER,
    MOST_BY_CHANCE,
    even_grid,
    find_places,
    has_same_steps,
    is_rounded,
    is_steady,
    misses_lines,
    period_error,
    slope_below,
)
from pmfid.types import Flags, Floats

#: Greatest part of the rows that may be wrong readings.
MOST_INPUTS = 0.01
#: Relative deviation of steps from their median below which the steps are even.
EVEN_STEPS = 0.02
#: Smallest part of the steps that differ from their neighbours on an uneven clock with gaps.
RESAMPLING_OFTEN = 0.2
#: Number of standard errors for a decision whether stamps are the instants of the samples.
RESAMPLING_ERRORS = 2.0
#: Longest step in usual steps. A longer step is a gap without interpolation.
LONGEST_STEP = 3.5
#: Part of the steps, the shortest ones, whose mean is the usual step.
RESAMPLING_USUAL = 0.98
#: Ratio of a record's length in median steps to its number of samples above which missing lines do not explain the
#: length.
MOST_MISSING = 2.0
#: Part of the period within which the next sample follows at once, so that the input of the first sample acts for
#: no time.
RESAMPLING_AT_ONCE = 1e-3


@dataclass(frozen=True)
class Instants:
    """Samples (n,) at their instants, with time in the unit of the stamps, input and output.

    `period` is the usual step. Rows that fill a gap have no input (NaN), and an output on a line. `there` (n,) marks
    the measured outputs. If an even clock samples before late stamps, `even` is true, and the times are those of the
    clock. `jitter` is the root mean square deviation of the steps, relative to the period, and 0 for an even clock.
    `drifts` says whether the halves of the record differ in the period. `dt_error` is the relative standard error of
    the period of an even clock.
    """

    time: Floats
    u: Floats
    y: Floats
    there: Flags
    period: float
    jitter: float
    drifts: bool
    even: bool = False
    dt_error: float = 0.0


def find_instants(time: Floats, u: Floats, y: Floats) -> Instants | None:
    """Return the samples at the instants of an uneven clock, or None if the clock is even except for gaps, or is no
    clock.

    A gap of more than CLOCK_LONGEST samples is shortened, because the motion restarts after the gap anyway.
    """
    known = np.isfinite(time) & np.isfinite(u) & np.isfinite(y)
    if has_same_steps(time[np.isfinite(time)]):
        return None
    timed = np.isfinite(time) & np.isfinite(u)
    measured = _drop_repeats(time[timed], u[timed], y[timed])
    stamps, u, y = _drop_repeats(time[known], u[known], y[known])
    if stamps.size < CLOCK_GROUP or not np.ptp(stamps) > stamps.size / LARGEST_NUMBER:
        return None
    if not _is_uneven(stamps, y):
        return None
    if _are_late(stamps, y):
        return _take_even_clock(stamps, u, y)
    return _fill_gaps(*measured, _usual_step(np.diff(stamps)))


def integrate_stamps(time: Floats, velocity: Floats, u: Floats) -> Floats | None:
    """Return the travel (N,) of a velocity (N,) at the instants of an uneven clock, with NaN in rows without a number.

    The velocity is linear between samples. The result is None if the stamps are not the instants of the samples, or if
    their steps are even.
    """
    known = np.isfinite(time) & np.isfinite(velocity) & np.isfinite(u)
    if np.count_nonzero(known) < CLOCK_GROUP or (np.all(known) and has_same_steps(time)):
        return None
    stamps, values = time[known], velocity[known]
    if not np.all(np.diff(stamps) >= 0) or not _is_uneven(stamps, values) or _are_late(stamps, values):
        return None
    travel = np.full(time.size, np.nan)
    travel[known] = np.append(0.0, np.cumsum((values[1:] + values[:-1]) / 2 * np.diff(stamps)))
    return travel


def _drifts(steps: Floats) -> bool:
    """Return whether the mean steps (n,) of the two halves of a record differ by more than chance."""
    half = steps.size // 2
    first, last = (float(np.mean(part)) for part in (steps[:half], steps[half:]))
    scatter = float(np.std(np.diff(steps)))  # a drift hardly changes differences of neighbours
    chance = MOST_BY_CHANCE * scatter / np.sqrt(half)
    return bool(abs(first - last) > CLOCK_SAME * float(np.mean(steps)) + chance)


def _fill_gaps(stamps: Floats, u: Floats, y: Floats, period: float) -> Instants:
    """Return the samples without those that another sample follows at once, and with even rows in the gaps.

    An output y (n,) may be NaN.
    """
    kept = np.append(np.diff(stamps) > RESAMPLING_AT_ONCE * period, True)
    stamps, u, y = stamps[kept], u[kept], y[kept]
    steps = np.minimum(np.diff(stamps), CLOCK_LONGEST * period)
    stamps, there = stamps[0] + np.append(0.0, np.cumsum(steps)), np.isfinite(y)
    within = steps[steps <= LONGEST_STEP * period]
    rows = np.where(steps > LONGEST_STEP * period, np.rint(steps / period).astype(np.intp), 1)
    source = np.repeat(np.arange(stamps.size), np.append(rows, 1))
    first = np.diff(source, prepend=-1) > 0
    time = stamps[0] + np.append(0.0, np.cumsum(np.repeat(steps / rows, rows)))
    return Instants(
        time,
        np.where(first, u[source], np.nan),
        np.interp(time, stamps[there], y[there]),
        first & there[source],
        period,
        float(np.sqrt(np.mean((within / period - 1) ** 2))),
        _drifts(within),
    )


def _take_even_clock(stamps: Floats, u: Floats, y: Floats) -> Instants:
    """Return even samples (n,) whose stamps are late. The result has a jitter if the halves of the record differ in
    the period.
    """
    k = np.arange(stamps.size, dtype=np.float64)
    period, start = line_through(k, stamps)
    period *= 1 + slope_below((stamps - start - period * k) / period)
    half = stamps.size // 2
    halves = [line_through(k[part], stamps[part])[0] for part in (slice(half), slice(half, None))]
    drifts = abs(halves[0] - halves[1]) > CLOCK_SAME * period
    jitter = float(np.std(np.diff(stamps)) / period) if drifts else 0.0
    there, error = np.ones(k.size, bool), period_error(stamps, k)
    return Instants(start + period * k, u, y, there, period, jitter, drifts, even=True, dt_error=error)


def _usual_step(steps: Floats) -> float:
    """Return the mean of the steps (n,) without gaps. In a log with bursts, most steps are shorter than the mean."""
    mean = np.mean(steps[steps <= np.quantile(steps, RESAMPLING_USUAL)])
    return float(np.mean(steps[steps <= LONGEST_STEP * mean]))


def _drop_repeats(stamps: Floats, u: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the samples (n,) without rows that repeat the previous row, with its time."""
    again = (np.diff(stamps) == 0) & (np.diff(u) == 0) & (np.diff(y) == 0)
    kept = np.append(True, ~again) if np.any(again) and not is_rounded(stamps) else slice(None)
    return stamps[kept], u[kept], y[kept]


def _is_uneven(stamps: Floats, y: Floats) -> bool:
    steps = np.diff(stamps)
    median = float(np.median(steps))
    if np.min(steps) == 0:  # two samples may arrive at once
        return not even_grid(stamps)[1] and _are_late(stamps, y)
    if not (np.min(steps) > 0 and np.max(np.abs(steps - median)) > EVEN_STEPS * median):
        return False
    if np.sum(steps) > MOST_MISSING * steps.size * median:  # the record has bursts, or most lines are missing
        return True
    if misses_lines(stamps, y) is not None:
        return False
    steady, even = is_steady(stamps), even_grid(stamps)[1]
    if steady and not even and np.max(np.abs(steps - median)) > CLOCK_EVEN * median:
        return True
    part, error = _weigh_stamps(stamps, y)
    credible = part - RESAMPLING_ERRORS * error > 0.5
    if steady or even:
        return credible or (not steady and _are_late(stamps, y))
    # Missing samples change whole periods, uneven steps a part of one.
    apart = np.abs(np.diff(steps / median - np.rint(steps / median)))
    often = np.mean(apart > EVEN_STEPS) > RESAMPLING_OFTEN
    return find_places(stamps) is None or bool(credible and often)


def _are_late(stamps: Floats, y: Floats) -> bool:
    """Return whether the output shows that an even clock samples before the stamps (n,)."""
    part, error = _weigh_stamps(stamps, y)
    return part + RESAMPLING_ERRORS * error < 0.5


def _weigh_stamps(stamps: Floats, y: Floats) -> tuple[float, float]:
    """Return how far the output agrees with the stamps (n,), from 0 to 1, and the standard error of this number.

    The number is 1 if the stamps are the instants of the samples, and 0 if an even clock samples before the stamps. The
    number is the slope of a regression. The regressor is the distance of the interpolated output from the mean of the
    two neighbouring outputs. The target is the distance of the measured output from the mean of its neighbours.
    """
    steps = np.diff(stamps)
    both = steps[:-1] + steps[1:]
    part = steps[:-1] / np.maximum(both, np.finfo(float).tiny)
    single: Flags = (both > 0) & (both < 2 * LONGEST_STEP * _usual_step(steps))
    change, whole = (y[1:-1] - y[:-2])[single], (y[2:] - y[:-2])[single]
    shown, by_stamps = change - 0.5 * whole, (part[single] - 0.5) * whole
    plain = np.abs(shown - 0.5 * by_stamps) <= np.quantile(np.abs(shown - 0.5 * by_stamps), 1 - MOST_INPUTS)
    shown, by_stamps = shown[plain], by_stamps[plain]
    square = float(np.sum(by_stamps**2))
    if not square > 0:
        return 0.5, np.inf
    slope = float(np.sum(shown * by_stamps)) / square
    return slope, float(np.sqrt(np.sum(((shown - slope * by_stamps) * by_stamps) ** 2))) / square

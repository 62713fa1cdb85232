"""The clock of a record from its time stamps, and the missing lines."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from pmfid.elementary import line_through
from pmfid.errors import UsageError
from pmfid.types import Flags, Floats

if TYPE_CHECKING:
    from pmfid.config.record import RecordConfig

#: Range of the sample periods of machine axes [s], as drives log every 10 us to 100 ms. A longer period is slow for
#: any axis. A name with a unit is believed up to `LONGEST_NAMED_PERIOD`.
SHORTEST_PLAIN_PERIOD = 0.999e-5
LONGEST_PLAIN_PERIOD = 0.1001
LONGEST_NAMED_PERIOD = 1.001
#: Seconds since 1970 at the beginning of 2000 and of 2100.
CLOCK_EPOCHS = (946_684_800.0, 4_102_444_800.0)
#: Relative deviation of steps from their median that needs no note.
CLOCK_EVEN = 0.1
#: Largest deviation of a stamp from an even grid by chance [sample periods].
CLOCK_FURTHEST = 0.9
#: Fewest stamps for a decision, and number of averaged stamps that reveal a missing sample. The next constants are
#: the largest and the least number of blocks of stamps, whose means show the scatter of stamps that are late
#: together, and the largest mean by chance, in standard deviations.
CLOCK_GROUP = 50
CLOCK_BLOCKS = 30
CLOCK_LEAST_BLOCKS = 4
MOST_BY_CHANCE = 5.0
#: Relative difference of the longest and shortest step of a clock, or of the periods of two records, that needs
#: neither a note nor a further test. Tolerances of clocks explain it.
CLOCK_SAME_STEPS = 1e-3
#: Relative difference within which periods agree, of a configuration, a time column or the halves of a record, or a
#: step and a multiple of another step. Even half of the limit causes a significant error of the mass.
CLOCK_SAME = 0.01
#: Longest step without a missing sample, in median steps.
CLOCK_MISSING = 1.5
#: Largest distance of a step from a whole number of periods on an even grid, and time after a row within which a
#: following row is too early [periods]. `CLOCK_RARE` is the greatest part of rows that are too early.
CLOCK_NEAR = 0.3
CLOCK_RARE = 0.001
#: Longest step that determines the period [periods], because a pause may have a fractional length.
CLOCK_SHORT = 5
#: Largest standard deviation of stamps around a grid [periods]. Random stamps have a standard deviation of 0.29
#: periods.
CLOCK_SCATTER = 0.2
#: Largest distance of the earliest stamp from the mean of late stamps, in standard deviations. A half-normal delay
#: has 1.3. Sorted stamps with a delay of 2 periods have 2.2, from where on both lines are alike. Errors in both
#: directions have more than 3.
CLOCK_LOWEST = 2.3
#: Largest number of lines that are tried below all stamps, and of iterations between grid and places. A few
#: suffice.
CLOCK_TURNS = 50
#: Smallest number of long steps that distinguishes missing lines from rounded stamps, and of rows that repeat an
#: output. The output at only one or two pauses says too little, and a single repeated row is a wrong reading.
LONG_STEPS = 5
#: Longest gap on the grid [samples]. Longer gaps are shortened, because the motion restarts after any gap.
CLOCK_LONGEST = 1000
#: Largest number of periods in a step, for sums without an overflow.
CLOCK_MOST = 2.0**40
#: Largest number of a column. No unit of any quantity needs more.
LARGEST_NUMBER = 1e100
#: Fewest samples of a record.
MIN_SAMPLES = 10

#: Length [s] of each unit of time.
UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
#: Possible ends of a column's name for each unit, after a separator.
_NAMES = {
    "s": r"s|secs?|seconds?",
    "ms": r"ms|msecs?|millis|milliseconds?",
    "us": r"[uµμ]s|[uµμ]secs?|micros|microseconds?",
    "ns": r"ns|nsecs?|nanos|nanoseconds?",
}


def time_factor(config: RecordConfig) -> float:
    """Return the seconds per unit of the time column."""
    return UNITS[config.time_unit or named_unit(config.time or "") or "s"]


def named_unit(name: str) -> str | None:
    """Return the unit of time in a column's name, such as "t_ms", "Time [ms]" or "time/us", or None without a unit."""
    text = name.strip().lower()
    for unit, pattern in _NAMES.items():
        if re.search(rf"(?:^|[\s_.,:/(\[-])(?:{pattern})[)\]]?$", text):
            return unit
    return None


def sample_period(time: Floats | None, config: RecordConfig) -> tuple[float, tuple[str, ...]]:
    """Return the sample period [s] of an axis' record with the time column (n,), and notes for people.

    Raises UsageError if no period is known, if the steps are uneven, or if [record] dt differs from the period. The
    error also occurs for a period that is unusual for an axis, unless the configuration confirms the period.
    """
    if time is None:
        if config.dt is None:
            raise UsageError("[record] has neither time nor dt; give one of them")
        return config.dt, ()
    if time.size < MIN_SAMPLES:
        raise UsageError(f"the time column {config.time!r} has {time.size} numbers: name another column, or give dt")
    mean, grid = even_grid(time)
    median, jitter = (mean, 0.0) if grid and has_same_steps(time) else _steps_of(time)
    if not grid:
        _check_steps(time, np.diff(time), median)
        mean = float((time[-1] - time[0]) / (len(time) - 1))
    _check_name(mean, config)
    if config.dt is not None and _counts_samples(time, config):
        return config.dt, (f"the time column {config.time!r} counts samples of {config.dt:g} s",)
    epoch = _epoch(float(time[0]), mean, config)
    factor = UNITS[epoch] if epoch else time_factor(config)
    _check_unit(mean, factor, config, epoch, _counts_samples(time, config))
    varies = jitter > CLOCK_SAME_STEPS
    notes = [f"time steps vary by up to {jitter:.1%} of their median"] if varies else []
    if mean * factor > LONGEST_PLAIN_PERIOD:
        notes.append(f"a sample period of {mean * factor:g} s is slow for an axis")
    if grid and jitter > CLOCK_EVEN:
        notes.append(f"the stamps scatter around an even grid of {mean * factor:g} s, and the grid replaces them")
    if factor != 1:
        unit = next(unit for unit, length in UNITS.items() if length == factor)
        notes.append(f"the time column {config.time!r} is read in {unit}, so the sample period is {mean * factor:g} s")
    return mean * factor, tuple(notes)


def _check_name(step: float, config: RecordConfig) -> None:
    """Raise UsageError if the time column's name contradicts the configured unit, and the name's unit gives a usual
    mean step.
    """
    named = named_unit(config.time or "")
    if named is None or config.time_unit in (None, named):
        return
    if SHORTEST_PLAIN_PERIOD <= step * UNITS[named] <= LONGEST_PLAIN_PERIOD:
        raise UsageError(
            f'the name of the column {config.time!r} says {named}, but [record] time_unit = "{config.time_unit}": '
            f'write time_unit = "{named}", or rename the column'
        )


def _steps_of(time: Floats) -> tuple[float, float]:
    """Return the median step of stamps (n,), and the largest relative deviation from the median."""
    steps = np.diff(time)
    median = float(np.median(steps))
    return median, _furthest(steps, median) / median if median else 0.0


def has_same_steps(time: Floats) -> bool:
    """Return whether the stamps (n,) rise in equal steps. Most clocks do, and need no median of their steps."""
    steps = np.diff(time)
    least = float(np.min(steps, initial=np.inf))
    return bool(least > 0 and np.max(steps, initial=0.0) - least <= CLOCK_SAME_STEPS * least)


def even_grid(time: Floats) -> tuple[float, bool]:
    """Return the period of the line through the stamps (n,), in their unit, and whether they scatter around an even
    grid.

    An even grid has one sample for each of its points and meets three conditions. No stamp deviates by nearly a period,
    as a duplicate does. The steps scatter more than the stamps, as independent errors of the stamps cause. No group of
    stamps deviates by a quarter of a period, as after a missing sample.
    """
    n = time.size
    if n < CLOCK_GROUP or not np.all(np.isfinite(time)):
        return 0.0, False
    k, since = np.arange(n, dtype=np.float64), time - time[0]
    k -= (n - 1) / 2
    period = float(np.sum(k * since) * 12 / (n * (n * n - 1.0)))
    if not period > 0:
        return 0.0, False
    if _furthest(np.diff(time), period) < CLOCK_SAME_STEPS * period or is_rounded(time):
        return period, True
    since -= np.mean(since)
    since /= period
    late = np.subtract(since, k, out=k)
    del since
    together = np.convolve(late, np.full(CLOCK_GROUP, 1 / CLOCK_GROUP), mode="valid")
    furthest, of_group = (_furthest(values, 0.0) for values in (late, together))
    chance = MOST_BY_CHANCE * np.std(late) / np.sqrt(CLOCK_GROUP)
    even = furthest < CLOCK_FURTHEST and np.std(late) < np.std(np.diff(late)) and of_group < 0.25 + chance
    del together
    return float(period) * (1 + slope_below(late) if even else 1.0), bool(even)


def is_rounded(time: Floats) -> bool:
    """Return whether rounding explains the stamps (n,) of an even clock whose period is shorter than their last digit.

    All steps are then 0 or one digit, and no stamp deviates from the line through the stamps by more than the rounding.
    """
    steps = np.diff(time)
    digit = float(np.max(steps, initial=0.0))
    single = np.abs(steps - digit) < CLOCK_SAME * digit
    if not (digit > 0 and np.all(single | (steps == 0)) and np.mean(single) < CLOCK_FURTHEST):
        return False
    k = np.arange(time.size, dtype=np.float64)
    late = time - time[0] - np.polyval(np.polyfit(k, time - time[0], 1), k)
    return bool(np.max(np.abs(late)) < (0.5 + CLOCK_NEAR / 3) * digit)


def slope_below(late: Floats) -> float:
    """Return the slope per sample of the line below all lateness values (n,) [periods], whose own line is level.

    A delay never makes a stamp early. The line below all stamps then has a far smaller error than the line through
    them. The slope is 0 if the values scatter alike in both directions.
    """
    n, size = late.size, float(np.std(late))
    lowest = -float(np.min(late))
    if not size > 0 or lowest > CLOCK_LOWEST * size:
        return 0.0
    if float(np.mean(late**3)) < MOST_BY_CHANCE * np.sqrt(6 / n) * size**3:
        return 0.0
    k, middle, slope = np.arange(n, dtype=np.float64), n // 2, 0.0
    for _ in range(CLOCK_TURNS):
        above = late - slope * k
        left, right = int(np.argmin(above[:middle])), middle + int(np.argmin(above[middle:]))
        before, slope = slope, float(late[right] - late[left]) / (right - left)
        if slope == before:
            break
    return slope


def period_error(stamps: Floats, places: Floats) -> float:
    """Return the relative standard error of the period of the line through stamps (n,) at places (n,) of a grid.

    The scatter of the stamps comes from blocks, because stamps in the order of their arrival are late together.
    """
    n = stamps.size
    blocks = min(CLOCK_BLOCKS, n // CLOCK_GROUP)
    if blocks < CLOCK_LEAST_BLOCKS:
        return 0.0
    around = places - np.mean(places)
    square = float(around @ around)
    period = float(around @ (stamps - np.mean(stamps))) / square
    late = (stamps - np.mean(stamps)) / period - around
    means = [float(np.mean(part)) for part in np.array_split(late, blocks)]
    return float(np.std(means, ddof=2)) * math.sqrt(n / blocks / square)


def _furthest(values: Floats, middle: float) -> float:
    """Return the largest distance of the values (n,) from a given value. The function makes no copy, because a
    record may be large.
    """
    return max(float(np.max(values)) - middle, middle - float(np.min(values)))


def _counts_samples(time: Floats, config: RecordConfig) -> bool:
    """Return whether the time column numbers the samples."""
    unit = config.time_unit or named_unit(config.time or "")
    return unit is None and bool(time[0] == np.rint(time[0]) and np.all(np.diff(time) == 1.0))


def _epoch(first: float, step: float, config: RecordConfig) -> str | None:
    """Return the unit that makes the first stamp a date of this century and the step a usual sample period.

    The result is None without a possible unit, and for a known unit.
    """
    if config.time_unit or config.dt is not None or named_unit(config.time or ""):
        return None
    dated = [unit for unit, length in UNITS.items() if CLOCK_EPOCHS[0] <= first * length < CLOCK_EPOCHS[1]]
    return next(
        (unit for unit in dated if SHORTEST_PLAIN_PERIOD <= step * UNITS[unit] <= LONGEST_PLAIN_PERIOD),
        None,
    )


def _check_unit(
    step: float, factor: float, config: RecordConfig, epoch: str | None = None, counted: bool = False
) -> None:
    """Check the unit of the time column, where `step` is its mean step in its own unit.

    `counted` says whether the column may number the samples.
    """
    if config.dt is not None:
        if abs(step * factor - config.dt) <= CLOCK_SAME * config.dt:
            return
        fitting = [unit for unit, length in UNITS.items() if abs(step * length - config.dt) <= CLOCK_SAME * config.dt]
        remedy = f'give time_unit = "{fitting[0]}"' if fitting else "correct dt, or convert the time column to s"
        raise UsageError(
            f"[record] dt = {config.dt:g} s, but the time column {config.time!r} steps by {step:g}; {remedy}"
        )
    longest = LONGEST_NAMED_PERIOD if named_unit(config.time or "") else LONGEST_PLAIN_PERIOD
    if epoch or config.time_unit is not None or SHORTEST_PLAIN_PERIOD <= step * factor <= longest:
        return
    if counted:
        raise UsageError(
            f"the time column {config.time!r} steps by 1: if the column counts samples, give the sample period as "
            '[record] dt in s; if it is a time, give [record] time_unit = "ms" (0.001 s), or "s"'
        )
    taken = next(unit for unit, length in UNITS.items() if length == factor)
    others = [unit for unit, length in UNITS.items() if SHORTEST_PLAIN_PERIOD <= step * length <= LONGEST_PLAIN_PERIOD]
    ways = " or ".join(f'"{unit}" ({step * UNITS[unit]:g} s)' for unit in others)
    raise UsageError(
        f"the time column {config.time!r} has steps of {step:g}: in {taken} the sample period is {step * factor:g} s, "
        f"unusual for an axis; give [record] time_unit = {ways + ', or ' if ways else ''}"
        f'"{taken}" to confirm'
    )


def _check_steps(time: Floats, steps: Floats, median: float) -> None:
    back = np.flatnonzero(steps <= 0)
    if len(back):
        k = back[0]
        raise UsageError(
            f"time does not increase strictly: row {k + 2} ({time[k + 1]:.9g}) follows {time[k]:.9g}; "
            + (
                "it is a duplicate: drop one of the two rows, or write time with more digits"
                if steps[k] == 0
                else _back(k, median)
            )
        )
    gaps = np.flatnonzero(steps > 1.5 * median)
    if len(gaps):
        k = gaps[0]
        raise UsageError(
            f"time has {len(gaps)} gap{'s' * (len(gaps) > 1)}, steps beyond 1.5 medians of {median:g} s; "
            f"first after row {k + 1}, t = {time[k]:.9g}; "
            + (
                "cut the record at the gap"
                if len(gaps) < LONG_STEPS
                else "if only the stamps are late and the samples are even, give [record] dt in place of time"
            )
        )
    worst = float(np.max(np.abs(steps - median)) / median)
    if worst > CLOCK_EVEN:
        raise UsageError(
            f"time steps differ by up to {worst:.1%} of the median {median:g} s, more than the allowed 10 %; resample "
            "the record to a fixed rate"
        )


def _back(k: int, median: float) -> str:
    """Return the remedy for a time that decreases after step k. The usual cause is a restart of the logger, and
    rows are rarely mixed.
    """
    if median <= 0:
        return "most rows go back in time: sort the rows by time"
    return (
        f"if the logger started again at this row, keep the rows up to {k + 1} or from {k + 2} on; if rows are mixed, "
        "sort them by time"
    )


Number = TypeVar("Number", bound=np.generic)


@dataclass(frozen=True)
class PlacedRows:
    """The used rows (m,) of a record and their places (m,) on a grid with the period dt [s], with notes for people.

    `dt_error` is the relative standard error of the period.
    """

    rows: NDArray[np.intp]
    places: NDArray[np.intp]
    dt: float
    notes: tuple[str, ...]
    dt_error: float = 0.0

    @property
    def whole(self) -> bool:
        """Whether every place has a sample."""
        return bool(self.places.size == self.places[-1] + 1)

    def place_inputs(self, u: Floats) -> Floats:
        """Return the input (n,) at each place, or NaN, from the input u (N,) of all rows of the file.

        A gap in the used rows has inputs if the file has a row for each place of the gap.
        """
        rows = np.arange(self.rows[0], self.rows[-1] + 1)
        if self.whole and rows.size == self.rows.size:  # the usual case, for which the search takes far longer
            return np.array(u[rows[0] : rows[-1] + 1], np.float64)
        before = np.searchsorted(self.rows, rows, side="right") - 1
        complete = np.append(np.diff(self.rows) == np.diff(self.places), True)[before]
        complete |= rows == self.rows[before]
        inputs = np.full(self.places[-1] + 1, np.nan)
        inputs[(rows - self.rows[before] + self.places[before])[complete]] = u[rows[complete]]
        return inputs


def place_rows(time: Floats | None, kept: Flags, repeated: Flags, config: RecordConfig, output: Floats) -> PlacedRows:
    """Place the rows `kept` (N,) on a grid, according to the time (N,) or to a constant period.

    `repeated` (N,) marks rows with the values of the previous row. The output (N,) distinguishes missing lines from
    rounded stamps. Raises UsageError for a time without an even grid.
    """
    if time is None:
        rows = np.flatnonzero(kept)
        return PlacedRows(rows, _shorten_gaps(rows), *sample_period(None, config))
    rows, repeats, early = np.arange(time.size), tuple[str, ...](), tuple[str, ...]()
    if (same := has_same_steps(time)) and np.all(kept):
        return PlacedRows(rows, rows, *sample_period(time, config))
    if not same:
        rows, repeats = drop_repeats(time, repeated, np.flatnonzero(np.isfinite(time)))
        rows, early = _drop_early(time, rows)
    stamps, places = _take_rows(time, rows), None
    if not (same or is_steady(stamps)):
        missing = misses_lines(stamps, _take_rows(output, rows))
        found = None
        if missing is False:
            stamps = _even_stamps(stamps)
        elif missing or not even_grid(stamps)[1]:
            found = find_places(stamps)
        if found is not None:
            places, period = found
            stamps = stamps[0] + period * np.arange(stamps.size)
    dt, notes = sample_period(stamps, config)  # `sample_period` refuses stamps without a grid
    counts = kept[rows]
    at = np.arange(rows.size) if places is None else places
    error = 0.0 if same or config.dt is not None else period_error(_take_rows(time, rows), at.astype(np.float64))
    used = _take_rows(rows, np.flatnonzero(counts))
    return PlacedRows(used, _shorten_gaps(at[counts]), dt, (*repeats, *early, *notes), error)


def _take_rows(values: NDArray[Number], rows: NDArray[np.intp]) -> NDArray[Number]:
    """Return the values (N,) at rising rows (n,), without a copy if all rows are used."""
    return values if rows.size == values.size else values[rows]


def is_steady(time: Floats) -> bool:
    """Return whether the time (n,) rises without a step that contains missing samples."""
    steps = np.diff(time)
    return bool(steps.size and np.min(steps) > 0 and np.max(steps) <= CLOCK_MISSING * np.median(steps))


def misses_lines(time: Floats, output: Floats) -> bool | None:
    """Return True if lines are missing and False if stamps are rounded.

    The steps of the stamps (n,) are whole multiples of the median step. The result is None if fewer than LONG_STEPS
    steps are multiples, or if the output (n,) shows no difference. If lines are missing, the output changes over a step
    of k periods by k times its usual change. If stamps are rounded, the output changes by its usual change. The usual
    change is the mean over the two neighbouring steps.
    """
    steps = np.diff(time)
    median = float(np.median(steps)) if steps.size else 0.0
    if not median > 1 / LARGEST_NUMBER:
        return None
    steps /= median
    times = np.rint(steps)
    if np.max(np.abs(steps - times)) > CLOCK_SAME or np.min(times) < 1:
        return None
    longer = bool(np.max(times) > 2)  # rounding gives at most two periods
    if longer and np.count_nonzero(times == 2) < LONG_STEPS:
        return True
    long = np.flatnonzero(times[1:-1] == 2 if longer else times[1:-1] > 1) + 1
    long = long[(times[long - 1] == 1) & (times[long + 1] == 1)]
    changes = np.diff(output)
    usual, change = (changes[long - 1] + changes[long + 1]) / 2, changes[long]
    known = np.isfinite(usual) & np.isfinite(change)
    usual, change, times = usual[known], change[known], times[long][known]
    if change.size < LONG_STEPS:
        return None
    if_missing, if_rounded = float(np.sum(np.abs(change - times * usual))), float(np.sum(np.abs(change - usual)))
    return None if if_missing == if_rounded else if_missing < if_rounded


def _even_stamps(time: Floats) -> Floats:
    """Return the stamps (n,) on the line through them, or unchanged if any stamp deviates by nearly a period."""
    k = np.arange(time.size, dtype=np.float64)
    period, start = line_through(k, time - time[0])
    line = time[0] + start + period * k
    return line if period > 0 and _furthest(np.abs(time - line), 0.0) < CLOCK_FURTHEST * period else time


def drop_repeats(time: Floats, repeated: Flags, rows: NDArray[np.intp]) -> tuple[NDArray[np.intp], tuple[str, ...]]:
    """Return the rows without exact repetitions of the previous row and its time.

    A rounded clock gives equal stamps to different rows. If all rows with equal stamps are repetitions, the log
    has them twice.
    """
    equal = np.r_[False, np.diff(_take_rows(time, rows)) == 0]
    again = equal & _take_rows(repeated, rows)
    count = int(np.count_nonzero(again))
    if not count or (count < np.count_nonzero(equal) and is_rounded(_take_rows(time, rows))):
        return rows, ()
    repeats, are = ("rows repeat", "are") if count > 1 else ("row repeats", "is")
    return rows[~again], (f"{count} {repeats} the row before with its time and {are} left out",)


def _drop_early(time: Floats, rows: NDArray[np.intp]) -> tuple[NDArray[np.intp], tuple[str, ...]]:
    """Return the rows without the few rows that follow another row too early, as at the start of a logger.

    A grid has no place for two close rows, unless each row is a point of the grid and the stamps scatter.
    """
    stamps = _take_rows(time, rows)
    steps = np.diff(stamps)
    early = (
        np.r_[False, (steps >= 0) & (steps < CLOCK_NEAR * np.median(steps))]
        if steps.size
        else np.zeros(rows.size, bool)
    )
    count = int(np.count_nonzero(early))
    if not 0 < count <= max(1, CLOCK_RARE * rows.size) or even_grid(stamps)[1]:
        return rows, ()
    note = "rows come" if count > 1 else "row comes"
    when = f"less than {CLOCK_NEAR:g} of a period after another row: left out"
    return rows[~early], (f"{count} {note} {when}",)


def find_places(time: Floats) -> tuple[NDArray[np.intp], float] | None:
    """Return the places (n,) of rising stamps (n,) on an even grid, starting at 0, and its period, or None without a
    grid.

    Each step between stamps is nearly a whole number of periods. If the stamps scatter more, a line through all stamps
    gives the grid.
    """
    steps = np.diff(time)
    if not (steps.size and np.min(steps) > 1 / LARGEST_NUMBER):
        return None
    period = float(np.median(steps))
    period = float(np.mean(steps[np.abs(steps - period) <= (CLOCK_MISSING - 1) * period]))
    for _ in range(CLOCK_TURNS):
        numbers = np.clip(np.rint(steps / period), 1, CLOCK_MOST).astype(np.intp)
        short = numbers <= CLOCK_SHORT
        before, period = period, float(np.sum(steps[short]) / np.sum(numbers[short]))
        if period == before:
            break
    places = np.r_[0, np.cumsum(numbers)]
    if np.max(np.abs(steps / period - numbers)[short]) <= CLOCK_NEAR:
        return places, period
    return _place_by_line(time, places)


def _place_by_line(time: Floats, places: NDArray[np.intp]) -> tuple[NDArray[np.intp], float] | None:
    """Return sample numbers and period of stamps that scatter by chance, from approximate sample numbers (n,)."""
    for _ in range(CLOCK_TURNS):
        period, start = line_through(places.astype(np.float64), time - time[0])
        at = (time - time[0] - start) / period
        found = np.rint(at).astype(np.intp)
        if np.array_equal(found, places):
            break
        places = found
    rises = bool(np.min(np.diff(found)) > 0)
    return (found - found[0], period) if rises and np.std(at - found) < CLOCK_SCATTER else None


def _shorten_gaps(places: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the places with gaps of at most CLOCK_LONGEST samples."""
    if places.size and places[-1] - places[0] == places.size - 1:
        return np.arange(places.size)
    steps = np.diff(places, prepend=places[:1])
    return np.cumsum(np.minimum(steps, CLOCK_LONGEST + 1, out=steps), out=steps)

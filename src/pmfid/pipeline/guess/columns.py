"""The columns of numbers in a file, and the steps of their values."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from pmfid.errors import UsageError
from pmfid.io.tables import Table, column, times
from pmfid.pipeline.guess.roles import role_of
from pmfid.records.clock import MIN_SAMPLES
from pmfid.records.column_checks import RECORD_DISTINCT
from pmfid.types import Flags, Floats

#: Smallest part of the steps of a column that are whole multiples, or of changes that are in step, and largest distance
#: of a step from a multiple of another step.
IN_STEP = 0.98
COLUMNS_EXACT = 0.02
#: Largest rounding of a log relative to a step. With more rounding, any step would be possible.
MOST_ROUNDED = 0.15
#: Smallest part of the rows with a value, and the part below which a column belongs to one of several topics.
COLUMNS_FILLED = 0.1
COLUMNS_TOPIC = 0.7
#: Number of steps in the range of a column without visible steps.
COLUMNS_FINE = 2**20


def is_whole(values: Floats) -> bool:
    """Return whether all values are whole numbers."""
    return bool(np.array_equal(values, np.rint(values)))


def step_of(values: Floats) -> tuple[float, bool]:
    """Return the smallest step that divides all other steps of finite values (n,), and whether such a step exists.

    Steps up to a billionth of the range are rounding, and a log may have rounded each value to a number of decimals.
    Without a common step, the function returns the range divided by COLUMNS_FINE.
    """
    found = np.unique(values[:RECORD_DISTINCT])
    reach = float(np.ptp(found))
    if reach == 0:
        return 1.0, False
    steps = np.diff(found)
    steps = steps[steps > 1e-9 * reach]
    step = float(steps.min())
    for most in (4, 16, 64, 256, 1000):  # small multiples come first, because more iterations need more digits
        times = np.rint(steps / step)
        near = (times > 0) & (times < most) & (np.abs(steps / step - times) < 0.25)
        step = float(np.sum(steps[near]) / np.sum(times[near]))
    off = np.abs(steps / step - np.rint(steps / step))
    exact = steps / step < COLUMNS_EXACT / 1e-6
    rounded = rounding_of(found) / step
    allowed = max(COLUMNS_EXACT, 1.01 * rounded if rounded < MOST_ROUNDED else 0.0)
    if found.size > 3 and np.mean(off[exact] < allowed) > IN_STEP and reach / step < COLUMNS_FINE:
        return _round_step(*_fit_step(found, step)), True
    return max(reach / COLUMNS_FINE, _last_digit(found)), False


def _last_digit(values: Floats) -> float:
    """Return the last digit of the largest of the values (n,), if a log wrote them with a few significant digits.

    The result is 0.0 if the values have more digits.
    """
    some = values[:: max(1, values.size // 1000)].tolist()
    for digits in range(3, 8):
        if all(float(f"{value:.{digits - 1}e}") == value for value in some):
            return float(10.0 ** (np.floor(np.log10(np.max(np.abs(values)))) - digits + 1))
    return 0.0


def rounding_of(values: Floats) -> float:
    """Return the power of ten that divides all values (n,), or 0.0 if the values have too many digits."""
    for digits in range(10):
        scaled = values * 10.0**digits
        if np.all(np.abs(scaled - np.rint(scaled)) < 1e-6) and np.ptp(scaled) < 1e9:
            return 10.0**-digits
    return 0.0


def _fit_step(found: Floats, step: float) -> tuple[float, float]:
    """Return the slope of the values (n,) over their multiples of a step, and its relative error from rounding."""
    times = np.rint((found - found[0]) / step)
    times -= np.mean(times)
    length = float(np.linalg.norm(times))
    slope = float(times @ found) / length**2
    return slope, rounding_of(found) / (length * slope)


def _round_step(step: float, error: float) -> float:
    """Return the step with the fewest digits that give its value within its relative error, from the decimals of the
    column.
    """
    for digits in range(1, 9):
        short = float(f"{step:.{digits}g}")
        if abs(short - step) < np.clip(error, 1e-7, 1e-5) * step:
            return short
    return step


def first_axis(table: Table, time: str) -> tuple[Table, str, str] | None:
    """Return the rows of the first axis of a table of many axes, the column of the axes, and a text on the rows.

    The result is None for a table of one axis. The time of one axis rises.
    """
    import polars as pl

    texts = [own for own in table.values() if isinstance(own, pl.Series) and own.dtype in (pl.String, pl.Categorical)]
    for axes in texts:
        rows = {name: own.filter(axes == axes[0]) for name, own in table.items() if isinstance(own, pl.Series)}
        if len(rows[axes.name]) > MIN_SAMPLES and np.all(np.diff(times(rows, time)[0]) > 0):
            return rows, axes.name, f"only the rows with {axes.name} = {axes[0]!r}, one of {axes.n_unique()} axes"
    return None


def numeric(table: Table) -> dict[str, Floats]:
    """Return the columns of numbers that are not constant, by name.

    If the topics of a table have separate rows, the function returns the rows of the position. A missing value inside
    the record takes the preceding value of the column, which suffices for a guess.
    """
    found: dict[str, Floats] = {}
    rows: Flags | None = None
    for name in table:
        with suppress(UsageError):
            values = column(table, "column", name)
            good = np.isfinite(values)
            if values.size > 10 and np.mean(good) > COLUMNS_FILLED and np.ptp(values[good]) > 0:
                last = np.maximum.accumulate(np.where(good, np.arange(values.size), 0))
                found[name] = np.where(good[last], values[last], values[good][0])
                if np.mean(good) < COLUMNS_TOPIC and role_of(name) in ("position", "counts"):
                    rows = good
    return {
        name: values[rows] if rows is not None and values.size == rows.size else values
        for name, values in found.items()
    }

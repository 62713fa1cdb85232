"""The step of a column of numbers: the resolution of the encoder that it comes from."""

from __future__ import annotations

import numpy as np

from pmfid.types import Floats

__all__ = ["is_whole", "step_of"]

#: Most values that are examined; least part of the steps that are whole multiples; largest distance from a multiple.
MOST, PART, EXACT = 20_000, 0.98, 0.02
#: Largest rounding of a log, as a part of a step: with more rounding any step would fit.
MOST_ROUNDED = 0.15
#: Steps in the range of a column that shows no steps.
FINE = 2**20


def is_whole(values: Floats) -> bool:
    """Are all values whole numbers?"""
    return bool(np.array_equal(values, np.rint(values)))


def step_of(values: Floats) -> tuple[float, bool]:
    """The smallest step that divides all others, and whether there is one; values: (n,), finite.

    Steps up to a billionth of the range are rounding, and a log may have rounded each value to a number of decimals.
    Without such a step, the range over FINE.
    """
    found = np.unique(values[:MOST])
    reach = float(np.ptp(found))
    if reach == 0:
        return 1.0, False
    steps = np.diff(found)
    steps = steps[steps > 1e-9 * reach]
    step = float(steps.min())
    for most in (4, 16, 64, 256, 1000):  # more digits with every turn: small multiples first
        times = np.rint(steps / step)
        near = (times > 0) & (times < most) & (np.abs(steps / step - times) < 0.25)
        step = float(np.sum(steps[near]) / np.sum(times[near]))
    off = np.abs(steps / step - np.rint(steps / step))
    exact = steps / step < EXACT / 1e-6
    rounded = rounding_of(found) / step
    allowed = max(EXACT, 1.01 * rounded if rounded < MOST_ROUNDED else 0.0)
    if found.size > 3 and np.mean(off[exact] < allowed) > PART and reach / step < FINE:
        return _round_step(step), True
    return reach / FINE, False


def rounding_of(values: Floats) -> float:
    """The power of ten that divides all values (n,); 0.0 if the values have too many digits."""
    for digits in range(10):
        scaled = values * 10.0**digits
        if np.all(np.abs(scaled - np.rint(scaled)) < 1e-6) and np.ptp(scaled) < 1e9:
            return 10.0**-digits
    return 0.0


def _round_step(step: float) -> float:
    """The step with the fewest digits that give its value."""
    for digits in range(1, 8):
        short = float(f"{step:.{digits}g}")
        if abs(short - step) < 1e-5 * step:
            return short
    return step

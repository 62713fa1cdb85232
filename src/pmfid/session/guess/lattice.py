"""The step of a column of numbers: that of the encoder behind it."""

from __future__ import annotations

import numpy as np

from pmfid.types import Floats

__all__ = ["is_whole", "step_of"]

#: Values that are looked at; part of the steps that must be whole multiples, and how exactly.
MOST, PART, EXACT = 20_000, 0.98, 0.02
#: A column without steps is taken to be as fine as so many in its range.
FINE = 2**20


def is_whole(values: Floats) -> bool:
    """Nothing but whole numbers?"""
    return bool(np.array_equal(values, np.rint(values)))


def step_of(values: Floats) -> tuple[float, bool]:
    """The smallest step of which all others are multiples, and whether there is one; values: (n,), finite.

    Steps up to a billionth of the range are rounding. Where there is none, a millionth of the range.
    """
    found = np.unique(values[:MOST])
    reach = float(np.ptp(found))
    if reach == 0:
        return 1.0, False
    steps = np.diff(found)
    steps = steps[steps > 1e-9 * reach]
    step = float(steps.min())
    for _ in range(3):  # more digits with every turn: small multiples first
        times = np.rint(steps / step)
        near = (times > 0) & (times < 1000) & (np.abs(steps / step - times) < 0.25)
        step = float(np.sum(steps[near]) / np.sum(times[near]))
    off = np.abs(steps / step - np.rint(steps / step))
    exact = steps / step < EXACT / 1e-6
    if found.size > 3 and np.mean(off[exact] < EXACT) > PART and reach / step < FINE:
        return _rounded(step), True
    return reach / FINE, False


def _rounded(step: float) -> float:
    """With as few digits as the step has."""
    for digits in range(1, 8):
        short = float(f"{step:.{digits}g}")
        if abs(short - step) < 1e-5 * step:
            return short
    return step

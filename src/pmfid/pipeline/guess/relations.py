"""Relations between two columns of a log: one quantity twice, a set point, a rate, and a motion with jumps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pmfid.types import Floats

#: Largest difference of two sensors of one quantity, relative to their standard deviation, and largest distance of
#: the gain of a set point from 1. `RELATIONS_FOLLOWS` is the largest part of a set point that the output does not
#: follow.
RELATIONS_COPY = 0.05
RELATIONS_FOLLOWS = 0.2
#: Smallest jump of a column that is no motion, relative to its range, and smallest number of jumps in each
#: direction.
COLUMNS_JUMP = 0.4
FEW_JUMPS = 3
#: Smallest correlation of a column with the change of the output above which the column is the velocity and no
#: input.
COLUMNS_SAME = 0.99


@dataclass(frozen=True)
class Likeness:
    """The best multiple of a column that equals another column, as first = gain * second + offset.

    `shift` is the delay of the second column [rows]. `left` is the standard deviation of the difference, and `offset`
    the constant part, both relative to the standard deviation of the first column.
    """

    gain: float
    left: float
    offset: float
    shift: int

    @property
    def alike(self) -> bool:
        """Whether one column is the other, except for a gain, a constant and a delay."""
        return self.gain > 0 and self.left < RELATIONS_COPY

    @property
    def set_point(self) -> bool:
        """Whether one column is the set point of the other: their gain is 1, with a delay and without an offset."""
        near = abs(self.gain - 1) < RELATIONS_COPY and self.left < RELATIONS_FOLLOWS
        return near and abs(self.offset) < RELATIONS_FOLLOWS


def compare(first: Floats, second: Floats) -> Likeness:
    """Return the likeness of two columns (n,) at their best shift, of at most a tenth of the rows."""
    n = first.size
    a, b = first - first.mean(), second - second.mean()
    size = 1 << (2 * n - 1).bit_length()
    cross = np.fft.irfft(np.fft.rfft(a, size).conj() * np.fft.rfft(b, size), size)
    most = n // 10
    shifts = np.r_[0 : most + 1, -most:0]
    shift = int(shifts[np.argmax(cross[shifts])])
    a, b = (first[: n - shift], second[shift:]) if shift >= 0 else (first[-shift:], second[:shift])
    spread, level = float(np.std(b)), float(np.std(a))
    if not (spread > 0 and level > 0):
        return Likeness(0.0, 1.0, 0.0, shift)
    gain = float(np.mean((a - a.mean()) * (b - b.mean()))) / spread**2
    rest = a - gain * b
    return Likeness(gain, float(np.std(rest)) / level, float(rest.mean()) / level, shift)


def is_rate(rate: Floats, motion: Floats) -> bool:
    """Return whether a column (n,) is the velocity of the motion (n,), up to a factor and a constant.

    The integral of the rate is compared, because neither the steps of an encoder nor noise hide it. The rate must
    explain nearly all of the motion that a line leaves.
    """
    total = np.cumsum(rate - rate.mean())
    k = np.linspace(-1.0, 1.0, motion.size)
    rest, total = (values - np.polyval(np.polyfit(k, values, 1), k) for values in (motion, total))
    size = float(np.std(rest) * np.std(total))
    likeness = float(np.mean(rest * total)) / size if size > 0 else 0.0
    change = np.gradient(motion)
    size = float(np.std(rate) * np.std(change))
    direct = float(np.mean((rate - rate.mean()) * (change - change.mean()))) / size if size > 0 else 0.0
    return direct > COLUMNS_SAME or likeness > float(np.sqrt(1 - RELATIONS_COPY**2))


def jumps(values: Floats) -> bool:
    """Return whether a column (n,) crosses much of its range within a sample in both directions, as a relay does.

    A mass cannot jump. A counter that wraps moves in the opposite direction before it jumps.
    """
    change = np.diff(values)
    at = np.flatnonzero(np.abs(change) > COLUMNS_JUMP * np.ptp(values))
    at = at[at > 0]
    if min(np.sum(change[at] > 0), np.sum(change[at] < 0)) < FEW_JUMPS:
        return False
    wraps = change[at - 1] * change[at] < 0
    return bool(np.mean(wraps) < 0.8)

"""The clocks of senders compared with the numbers of their samples: set, at another rate, or regular."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pmfid.stream.positions import Column, PositionRow
from pmfid.types import Flags, Floats

__all__ = ["Clock", "clock_runs", "period_fits", "rate_fits", "rate_is_due"]

#: Largest deviation of a clock that was not set [s]: stamps may have a resolution of whole seconds.
SET = 1.5
#: Rate of the sender's clock compared with its numbers: fewest samples and shortest time [s] of a measurement, and the
#: tolerance of the rate.
RATE_SAMPLES, RATE_TIME, RATE = 500, 60.0, 0.005
#: Tolerance of the sender's sample period, relative to the period of the configuration.
PERIOD = 1e-3

#: The tests apply to one block, or to the blocks of many axes: a number, or one number for each.
Real = float | Floats
Whole = int | NDArray[np.int64]
Answer = bool | Flags


def period_fits(period: Real, dt: float) -> Answer:
    """Whether a sender has the sample period of the configuration."""
    return (period - dt <= PERIOD * dt) & (dt - period <= PERIOD * dt)


def clock_runs(off: Real) -> Answer:
    """Whether a clock with this deviation [s] was not set; False for an unknown deviation."""
    return (off <= SET) & (-off <= SET)


def rate_is_due(samples: Whole, time: Real) -> Answer:
    """Whether the rate of a clock is tested after `samples` samples and `time` seconds."""
    return (samples >= RATE_SAMPLES) & (time >= RATE_TIME)


def rate_fits(rate: Real) -> Answer:
    """Whether the rate of a clock is within its tolerance."""
    return (rate - 1 <= RATE) & (1 - rate <= RATE)


class Clock:
    """The sender's clock compared with its numbers.

    dt: sample period [s]; expected: time of sample `number` [s], NaN while unknown; start, first: time and number at
    which the measurement of the rate began; wrong_rate: the last measured rate was outside its tolerance.
    """

    __slots__ = ("dt", "place")
    expected, number = Column[float]("time"), Column[int]("number")
    start, first = Column[float]("start"), Column[int]("first")
    wrong_rate = Column[bool]("wrong_rate")

    def __init__(self, dt: float, place: PositionRow) -> None:
        self.dt, self.place = dt, place

    def reset(self) -> None:
        """Forgets all measurements of the clock."""
        self.expected, self.number, self.start, self.first, self.wrong_rate = math.nan, 0, math.nan, 0, False

    def look(self, first: int, end: int, time: float) -> dict[str, object] | None:
        """Tests the clock at the next block. Returns a notice object if the clock was set or its rate is wrong."""
        if math.isnan(time):
            return None
        off = time - self.expected - (first - self.number) * self.dt
        self.expected, self.number = time + (end - first) * self.dt, end
        if not clock_runs(off):
            self.start, self.first = time, first
            return None if math.isnan(off) else {"event": "clock", "time": time, "jump": off}
        if rate_is_due(first - self.first, time - self.start):
            return self._rate(first, time)
        return None

    def _rate(self, first: int, time: float) -> dict[str, object] | None:
        rate = (time - self.start) / ((first - self.first) * self.dt)
        self.start, self.first = time, first
        wrong, known = not rate_fits(rate), self.wrong_rate
        self.wrong_rate = wrong
        if not wrong or known:
            return None
        period = rate * self.dt
        problem = f"by the sender's clock a sample takes {period:.6g} s, by its configuration {self.dt:.6g} s"
        return {"event": "clock", "time": time, "jump": 0.0, "rate": rate, "problem": problem}

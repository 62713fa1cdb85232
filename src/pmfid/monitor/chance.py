"""The chance that the statistic of the detector exceeds a threshold although nothing has changed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmfid._stage import EDGE
from pmfid.monitor.detector import WINDOW
from pmfid.monitor.tuning import TUNING
from pmfid.types import Floats


@dataclass(frozen=True)
class Chance:
    """The rate of false alarms of the generalised likelihood ratio (Siegmund 1985; Siegmund and Venkatraman 1995).

    `time` is the mean duration of a unit [s]. `variance` (lengths, p) is the variance of sums of `lengths` units over
    their information, which is the inflation of the normal law, and `error` (lengths, p) its standard error.
    `information` (lengths, levels, p) is the information of such sums, at levels of equal probability. The formulas
    take the variance raised by one standard error, because fewer false alarms are better than more. `inflation` is the
    ratio of thresholds to those of the formula, because sums with the same information are not exactly normal.
    """

    time: float
    lengths: Sequence[int]
    variance: Floats
    error: Floats
    information: Floats
    inflation: float = 1.0

    def rate(self, threshold: float) -> float:
        """Return the rate of false alarms [1/h] at a threshold."""
        return _rate(threshold / self.inflation, self._power(self.variance + self.error)) * 3600 / self.time

    def threshold(self, mtbf_hours: float) -> float:
        """Return the threshold for a mean time between false alarms [h].

        The threshold has 6 digits, so that the rounding of another processor gives the same number.
        """
        rate = self.time / (3600 * mtbf_hours)
        return float(f"{self.inflation * _solve(rate, self._power(self.variance + self.error)):.6g}")

    def inflate(self, *statistics: Floats) -> Chance:
        """Return the chance with the inflation of large maxima over intervals of statistics (n,) of normal work."""
        size, part = TUNING.look_back, TUNING.chance_part
        maxima = np.concatenate([one[: len(one) // size * size].reshape(-1, size).max(axis=1) for one in statistics])
        usual = _solve(-math.log(part) / size, self._power(self.variance))
        return replace(self, inflation=max(1.0, float(np.quantile(maxima, part)) / usual))

    def doubt(self, mtbf_hours: float) -> float:
        """Return the standard error of the logarithm of the mean time between false alarms."""
        mean = _rate(self.threshold(mtbf_hours) / self.inflation, self._power(self.variance))
        return math.log(self.time / (3600 * mtbf_hours) / mean) if mean > 0 else math.inf

    def _power(self, variance: Floats) -> Floats:
        """Return the mean square (WINDOW, levels, p) of sums of 1, 2, ... units, as a multiple of the statistic."""
        lengths = np.arange(1, WINDOW + 1)[:, None]
        information = lengths * self._interpolate(self.information.reshape(len(self.lengths), -1), True)
        information = information.reshape(WINDOW, -1, variance.shape[1])
        return self._interpolate(variance)[:, None] * information / (information + EDGE)

    def _interpolate(self, values: Floats, each: bool = False) -> Floats:
        """Return values (WINDOW, m) for sums of 1, 2, ... units, with `each` divided by the number of units."""
        columns = values / np.array(self.lengths)[:, None] if each else values
        at, lengths = np.log(np.arange(1, WINDOW + 1)), np.log(self.lengths)
        return np.stack([np.interp(at, lengths, column) for column in columns.T], axis=1)


def measure_chance(time: float, lengths: Sequence[int], x: Floats, w: Floats, *, growing: bool = False) -> Chance:
    """Return the chance for units of normal work with deviations x and information w (n, p), and a mean duration [s].

    With `growing`, longer sums have at least the variance of shorter ones, because a short record has few long sums.
    """
    variance, error = sum_variances(x, w, lengths)
    levels, sums = TUNING.chance_levels, [np.sort(_sum(w, length), axis=0) for length in lengths]
    information = [[part.mean(axis=0) for part in np.array_split(one, min(levels, len(one)))] for one in sums]
    resized = [np.resize(one, (levels, x.shape[1])) for one in information]
    raised = np.maximum.accumulate(variance) if growing else variance
    return Chance(time, tuple(lengths), raised, error, np.array(resized))


def sum_variances(x: Floats, w: Floats, lengths: Sequence[int]) -> tuple[Floats, Floats]:
    """Return the variance of sums of units over their information, and its standard error, (lengths, p) each.

    The units have deviations x and information w (n, p).
    """
    variances, errors = [], []
    for length in lengths:
        square, information = _sum(x, length) ** 2, _sum(w, length)
        total = np.maximum(information.sum(axis=0), np.finfo(float).tiny)
        variance = square.sum(axis=0) / total
        rest = np.sum((square - variance * information) ** 2, axis=0)
        least = 2 * np.sum((variance * information) ** 2, axis=0)  # of normal sums, which a few may fall short of
        variances.append(variance)
        errors.append(np.sqrt(np.maximum(rest, least)) / total)
    return np.array(variances), np.array(errors)


def _sum(part: Floats, length: int) -> Floats:
    """Return the sums of each `length` rows of part (n, p)."""
    n = max(len(part) // length, 1)
    return np.asarray(part[: n * length].reshape(n, -1, part.shape[1]).sum(axis=1))


def _solve(rate: float, power: Floats) -> float:
    """Return the threshold with a number of false alarms per unit."""
    from scipy.optimize import brentq

    high = 1.0
    while _rate(high, power) > rate:
        high *= 2
    return high if high == 1 else float(brentq(lambda one: _rate(one, power) - rate, high / 2, high))


def _rate(threshold: float, power: Floats) -> float:
    """Return the number of false alarms per unit for sums with the power (WINDOW, levels, p).

    The sum over the lengths n of a window is that of phi(b) b^3 / (2 n^2) nu(b / sqrt(n))^2, with b the threshold in
    standard deviations of the sum.
    """
    length = np.arange(1, len(power) + 1)[:, None, None]
    deviations = np.sqrt(2 * threshold / np.maximum(power, np.finfo(float).tiny))
    density = np.exp(-(np.minimum(deviations, 1e3) ** 2) / 2) / math.sqrt(2 * math.pi)
    rates = density * deviations**3 / (2 * length**2) * _overshoot(deviations / np.sqrt(length)) ** 2
    return float(np.sum(rates.mean(axis=1)))


def _overshoot(x: Floats) -> Floats:
    """Return the correction nu(x) for steps in place of a continuous path (Siegmund and Yakir 2007)."""
    from scipy.special import ndtr

    half = np.maximum(x / 2, np.finfo(float).tiny)
    return np.asarray((ndtr(half) - 0.5) / half / (half * ndtr(half) + np.exp(-(half**2) / 2) / math.sqrt(2 * math.pi)))

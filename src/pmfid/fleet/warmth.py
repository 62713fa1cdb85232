"""Friction of a series at one temperature, so that a daily cycle does not look like wear."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pmfid.fleet.changes import SIDE
from pmfid.fleet.series import Series, noise_of
from pmfid.monitor.cause import FRICTION
from pmfid.types import Floats


def remove_warmth(series: Series, names: Sequence[str]) -> Series:
    """Return the series with every friction at the mean temperature of its usable segments.

    The errors contain the error of the rate. A series without temperatures, or with few segments, stays as it is.
    """
    used = series[series.usable]
    if series.temperature is None or used.temperature is None or used.start.size < 4 * SIDE:
        return series
    theta, std, mean = series.theta.copy(), series.std.copy(), float(np.mean(used.temperature))
    noise, warmer = noise_of(used), series.temperature - mean
    for i in (i for i, name in enumerate(names) if FRICTION in name):
        level, slope, error = _regress(used, i, used.temperature - mean)
        factor = 1 + warmer * slope / level
        if np.all(factor > 0):
            theta[:, i] /= factor
            std[:, i] = np.hypot(std[:, i], noise[i] * error * warmer) / factor
    return replace(series, theta=theta, std=std)


def _regress(used: Series, i: int, warmer: Floats) -> tuple[float, float, float]:
    """Return the value of a parameter, its slope over the temperatures (n,), and the slope's standard error.

    A line over time and the best step keep wear apart from the temperature.
    """
    y, weight = used.theta[:, i], 1 / used.std[:, i]
    time = (used.start - used.start.mean()) / max(float(np.ptp(used.start)), 1.0)
    plain = np.stack([np.ones(y.size), warmer, time], axis=1) * weight[:, None]
    base = np.linalg.qr(plain)[0]
    rest = y * weight - base @ (base.T @ (y * weight))
    steps = np.arange(SIDE, y.size - SIDE + 1)
    ends = np.cumsum((weight * rest)[::-1])[::-1], np.cumsum((weight[:, None] * base)[::-1], axis=0)[::-1]
    left = np.cumsum((weight**2)[::-1])[::-1] - np.sum(ends[1] ** 2, axis=1)
    gain = ends[0][steps] ** 2 / np.maximum(left[steps], np.finfo(float).tiny)
    step = (np.arange(y.size) >= steps[np.argmax(gain)]) * weight
    columns = np.column_stack([plain, step])
    inverse = np.linalg.pinv(columns.T @ columns)
    solution = inverse @ (columns.T @ (y * weight))
    return float(np.average(y, weights=weight**2)), float(solution[1]), float(inverse[1, 1] ** 0.5)

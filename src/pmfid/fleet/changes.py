"""Steps, drifts and wander in a series, and kinds of machines in a fleet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmfid.estimators.facts import INPUT_GAIN
from pmfid.fleet.series import Series, lasting, mean_of, noise_of
from pmfid.fleet.tuning import TUNING
from pmfid.monitor.cause import FRICTION
from pmfid.records.outliers import NORMAL_MEDIAN
from pmfid.types import Floats

#: Least number of segments on each side of a step.
SIDE = 2
#: Number of segments after a step that mix samples from before and after the step. The size of the step leaves out
#: mixed segments if enough other segments remain.
MIXED = 1


@dataclass(frozen=True)
class Step:
    """A step in the parameters of an axis.

    `cause` is a parameter, FRICTION or INPUT_GAIN. `size` and `std` are relative. `since` and `until` [s] are the ends
    of the segment with the step. Estimates from `settled` [s] on belong to the time after the step. `score` is the
    largest deviation beyond the tolerance, in standard deviations. `relative` and `stds` (p,) are the change of every
    parameter and its standard deviation. `misfit` is the sum of squares that the step leaves, in standard deviations.
    `middle` (p,) has the standard deviations of a step in the middle of the series.
    """

    cause: str
    size: float
    std: float
    since: float
    until: float
    settled: float
    score: float
    relative: Floats
    stds: Floats
    misfit: float
    middle: Floats


@dataclass(frozen=True)
class Trend:
    """A straight line through the parameters of an axis.

    `cause` is as in `Step`. `size` and `std` belong to the change over the history, relative to its begin. `span` is
    the length of the history [s]. `score` is this change beyond the tolerance, in standard deviations. `misfit` is as
    in `Step`. `slopes` and `stds` (p,) belong to all parameters, relative to the value of the line at the begin [1/s].
    """

    cause: str
    size: float
    std: float
    span: float
    score: float
    misfit: float
    slopes: Floats
    stds: Floats


def step_of(series: Series, names: Sequence[str], tolerance: float) -> Step | None:
    """Return the step that explains most of a series (n, p) of usable segments, or None for too few segments.

    `tolerance` is the relative change that does not count.
    """
    n = series.start.size
    if n < 2 * SIDE:
        return None
    noise, weight = noise_of(series), 1 / series.std**2
    places = np.arange(SIDE, n - SIDE + 1)
    (left, right), (left_sum, right_sum) = _sums(weight, places), _sums(weight * series.theta, places)
    apart = (right_sum / right - left_sum / left) / noise
    k = int(places[np.argmax(np.max(apart**2 / (1 / left + 1 / right), axis=1))])
    return _measure_step(series, k, names, tolerance)


def _sums(part: Floats, places: np.ndarray) -> tuple[Floats, Floats]:
    """Return the sums of part (n, p) before each place, and from each place on."""
    total = np.cumsum(part, axis=0)
    left = total[places - 1]
    return left, total[-1] - left


def _measure_step(series: Series, k: int, names: Sequence[str], tolerance: float) -> Step:
    n = series.start.size
    k = _onset(series, k)
    later = min(k + MIXED, n - SIDE)
    first, second = series[:k], series[later:]
    old, new = mean_of(first)[0], mean_of(second)[0]
    rest = np.concatenate([(first.theta - old) / first.std, (second.theta - new) / second.std])
    size = np.maximum(np.abs(old), np.finfo(float).tiny)
    known = (first.std**-2.0).sum(axis=0), (second.std**-2.0).sum(axis=0)
    scatter = np.maximum(1.0, lasting(rest)) / size
    stds = np.sqrt(1 / known[0] + 1 / known[1]) * scatter
    relative = (new - old) / size
    scores = (np.abs(relative) - tolerance) / stds
    cause, change, std = attribute_change(relative, stds, _correlation(rest), names)
    since, before, until = float(series.start[k]), float(series.end[k - 1]), float(series.end[k])
    # The step may be in segments without information before its segment.
    times = before if since - before > 0.5 * (until - since) else since, until, float(series.start[later])
    whole = np.where(np.arange(n)[:, None] < k, old, new)
    misfit = float(np.sum(((series.theta - whole) / series.std) ** 2))
    middle = 2 / np.sqrt(known[0] + known[1]) * scatter
    return Step(cause, change, std, *times, float(np.max(scores)), relative, stds, misfit, middle)


def _correlation(rest: Floats) -> Floats:
    """Return the correlation (p, p) of the parameters' errors, from deviations (n, p).

    For few deviations the correlation shrinks towards 0.
    """
    n, p = rest.shape
    size = np.sqrt(np.mean(rest**2, axis=0))
    if not np.all(size > 0):
        return np.eye(p)
    found = (rest / size).T @ (rest / size) / n
    return np.asarray(np.eye(p) + (found - np.eye(p)) * n / (n + 2 * p))


def attribute_change(
    relative: Floats, stds: Floats, correlation: Floats, names: Sequence[str]
) -> tuple[str, float, float]:
    """Return the cause that explains relative changes (p,) best, with its relative size and standard deviation.

    A cause is a parameter, all frictions in the same proportion, or the input gain. A lower gain looks as if all
    parameters had grown in the same proportion. The size of a parameter is its own. The size of a common cause is a
    weighted mean, whose error contains the differences between its parameters.
    """
    covariance = correlation * np.outer(stds, stds) + TUNING.changes_floor**2 * np.eye(stds.size)
    friction = np.array([FRICTION in name for name in names], float)
    directions = dict(zip(names, np.eye(len(names)), strict=True)) | {INPUT_GAIN: np.ones(len(names))}
    if friction.sum() > 1:
        directions[FRICTION] = friction
    weighted = {name: np.linalg.solve(covariance, way) for name, way in directions.items()}
    gains = {name: float(relative @ way) ** 2 / float(directions[name] @ way) for name, way in weighted.items()}
    name = max(gains, key=lambda key: gains[key])
    if name in names:
        i = list(names).index(name)
        return name, float(relative[i]), float(stds[i])
    moved = directions[name] > 0
    known = stds[moved] ** -2.0
    size = float(relative[moved] @ known / known.sum())
    excess = float((relative[moved] - size) ** 2 @ known) / max(1, moved.sum() - 1)
    std = float(known.sum() ** -0.5) * max(1.0, excess**0.5)
    if name != INPUT_GAIN:
        return name, size, std
    factor = 1 / max(1 + size, 0.01)
    return name, factor - 1, std * factor**2


def _onset(series: Series, k: int) -> int:
    """Return the first segment with a part of the step at place k.

    The place that explains most may be one segment later.
    """
    old, new = mean_of(series[: max(SIDE, k - TUNING.changes_back)])[0], mean_of(series[k:])[0]
    whole = np.abs(new - old)
    for place in range(max(SIDE, k - TUNING.changes_back), k):
        before = series[:place]
        moves = np.sqrt(np.mean((before.theta - old) ** 2, axis=0))  # friction may follow the temperature
        apart = np.abs(series.theta[place] - old)
        if np.any(
            (apart > TUNING.changes_part * whole)
            & (apart > TUNING.changes_sure * np.maximum(moves, before.std.max(axis=0)))
        ):
            return place
    return k


def trend_of(series: Series, names: Sequence[str], tolerance: float) -> Trend | None:
    """Return the straight line through a series (n, p) of usable segments, or None for too few segments."""
    n = series.start.size
    if n < 2 * SIDE:
        return None
    time, weight = (series.start + series.end) / 2, 1 / series.std**2
    total = weight.sum(axis=0)
    centre = (weight * time[:, None]).sum(axis=0) / total
    mean = (weight * series.theta).sum(axis=0) / total
    x = time[:, None] - centre
    known = (weight * x**2).sum(axis=0)
    slope = (weight * x * series.theta).sum(axis=0) / known
    rest = (series.theta - mean - slope * x) / series.std
    stds = known**-0.5 * np.maximum(1.0, lasting(rest))
    span, size = float(time[-1] - time[0]), np.maximum(np.abs(mean), np.finfo(float).tiny)
    scores = (np.abs(slope) * span - tolerance * size) / (stds * span)
    begin = mean - slope * (centre - time[0])
    least = np.maximum(np.abs(begin), TUNING.least_begin * size)
    stds = np.hypot(mean * stds, slope * total**-0.5) / least**2
    slopes = slope / least
    cause = attribute_change(slopes * span, stds * span, _correlation(rest), names)
    return Trend(*cause, span, float(np.max(scores)), float(np.sum(rest**2)), slopes, stds)


def partition_series(theta: Floats, std: Floats, penalty: float) -> list[int]:
    """Return the places of all steps in theta (n, p) with errors std (n, p), by penalised least squares.

    Each step must reduce the sum of squares, in standard deviations, by more than `penalty`. The search is exact
    (optimal partitioning, Jackson et al. 2005).
    """
    n = len(theta)
    if n < 2 * SIDE:
        return []
    weight = std**-2.0
    apart = theta - np.average(theta, axis=0, weights=weight)
    sums = [np.vstack([np.zeros(apart.shape[1]), np.cumsum(weight * apart**k, axis=0)]) for k in range(3)]
    best, last = np.full(n + 1, np.inf), np.zeros(n + 1, int)
    best[0] = -penalty
    for end in range(SIDE, n + 1):
        known, first, square = (part[end] - part[: end - SIDE + 1] for part in sums)
        cost = best[: end - SIDE + 1] + (square - first**2 / known).sum(axis=1) + penalty
        last[end] = int(np.argmin(cost))
        best[end] = cost[last[end]]
    places, end = list[int](), int(last[n])
    while end:
        places.append(end)
        end = int(last[end])
    return places[::-1]


def levels_of(theta: Floats, std: Floats, places: Sequence[int]) -> Floats:
    """Return the weighted means (n, p) of the parts between the places of steps, for each row of theta (n, p)."""
    weight, starts = std**-2.0, [0, *places]
    means = np.add.reduceat(weight * theta, starts, axis=0) / np.add.reduceat(weight, starts, axis=0)
    return np.asarray(np.repeat(means, np.diff([*starts, len(theta)]), axis=0))


#: Candidates for the noise of the segments, in standard errors. The candidates for the steps of a walk between
#: segments are in root mean square differences of neighbours.
NOISE = np.geomspace(1, 100, 9)
WALK = np.r_[0.0, np.geomspace(1e-3, 2, 16)]


@dataclass(frozen=True)
class Beyond:
    """The evidence that a step or a line explains a series better than a random walk, as Student's t.

    `size` (p,) is the relative root mean square about the mean.
    """

    step: float
    line: float
    size: Floats


def compare_with_wander(series: Series, since: float) -> Beyond:
    """Return the evidence of step and trend beyond wandering, from a series (n, p) of at least three usable segments.

    `since` is the start of the first segment after the step [s].
    """
    place = int(np.searchsorted(series.start, since))
    theta, std, time = _together(series, place)
    mean = np.average(theta, axis=0, weights=std**-2.0)
    size = np.sqrt(np.mean((theta - mean) ** 2, axis=0)) / np.maximum(np.abs(mean), np.finfo(float).tiny)
    shapes = np.stack([time >= since, (time - time[0]) / (time[-1] - time[0])], axis=1).astype(np.float64)
    step, line = weigh_against_wander(theta, std, shapes)
    return Beyond(step, line, size)


def weigh_against_wander(theta: Floats, std: Floats, shapes: Floats) -> list[float]:
    """Return the evidence of each shape (n, k) beyond a random walk, as Student's t, from theta and std (n, p)."""
    n, mean = len(theta), np.average(theta, axis=0, weights=std**-2.0)
    unit = np.maximum(np.sqrt(np.mean(np.diff(theta, axis=0) ** 2, axis=0)), np.finfo(float).tiny)
    alone, *with_shape = _likelihoods((theta - mean) / unit, std / unit, shapes)
    gains = (np.max(one - alone) for one in with_shape)
    return [float(np.sqrt(max(n - 2, 1) * np.expm1(min(2 * gain / n, 100.0)))) for gain in gains]


def _together(series: Series, place: int) -> tuple[Floats, Floats, Floats]:
    """Return means of neighbouring segments (m, p), with standard errors and middle times (m,). No mean crosses
    `place`."""
    n = series.start.size
    many = -(-n // TUNING.changes_most)
    starts = np.r_[np.arange(place % many, place, many), np.arange(place, n, many)].astype(int)
    starts = np.unique(np.r_[0, starts])
    weight = series.std**-2.0
    total = np.add.reduceat(weight, starts, axis=0)
    theta = np.add.reduceat(weight * series.theta, starts, axis=0) / total
    time = np.add.reduceat((series.start + series.end) / 2, starts) / np.diff(np.r_[starts, n])
    return theta, total**-0.5, time


def _likelihoods(theta: Floats, std: Floats, shapes: Floats) -> tuple[Floats, ...]:
    """Return the largest log likelihoods (p,) of theta (n, p) with errors std (n, p), for a random walk.

    The first result is for the walk. The other results are for the walk with a multiple of each shape (n, k). One
    Kalman filter runs for all noises and walks together.
    """
    n, p = theta.shape
    seen = np.concatenate([theta[:, None, :], np.broadcast_to(shapes[:, :, None], (n, shapes.shape[1], p))], axis=1)
    noise, walk = (NOISE[:, None, None] * std[:, None, None, :]) ** 2, (WALK**2)[None, :, None]
    level = np.broadcast_to(seen[0][:, None, None, :], (seen.shape[1], NOISE.size, WALK.size, p))
    variance = np.broadcast_to(noise[0], (NOISE.size, WALK.size, p))
    logs = np.zeros(variance.shape)
    products = np.zeros((seen.shape[1], *variance.shape))  # products with the innovations of theta
    squares = np.zeros((seen.shape[1], *variance.shape))
    for now, error in zip(seen[1:], noise[1:], strict=True):
        variance = variance + walk
        total = variance + error
        innovation = now[:, None, None, :] - level
        logs += np.log(total)
        products += innovation * innovation[0] / total
        squares += innovation**2 / total
        gain = variance / total
        level, variance = level + gain * innovation, variance * (1 - gain)
    taken = products[1:] ** 2 / np.maximum(squares[1:], np.finfo(float).tiny)
    whole = [squares[0], *(squares[0] - one for one in taken)]
    return tuple(np.max(-(logs + one) / 2, axis=(0, 1)) for one in whole)


def sorts_of(place: Floats, least: int, tolerance: float) -> list[NDArray[np.intp]]:
    """Return the members of each kind of axis, from the places (m, p) of the axes.

    A place is the logarithm of the parameters over the median of the type. `least` is the least number of axes in a
    kind. `tolerance` is the least spread within a kind. If no gap separates the axes, the result is one kind with all
    axes.
    """
    found = [np.arange(len(place))]
    for column in place.T:
        found = [part for members in found for part in _split_sort(members, column, least, tolerance)]
    return found


def _split_sort(members: NDArray[np.intp], column: Floats, least: int, tolerance: float) -> list[NDArray[np.intp]]:
    """Split the members by one parameter, repeatedly."""
    ordered = members[np.argsort(column[members], kind="stable")]
    values = column[ordered]
    least = max(least, int(np.ceil(TUNING.least_part * values.size)))
    places = np.arange(least, values.size - least + 1)
    if not places.size:
        return [members]
    k = int(places[np.argmax(values[places] - values[places - 1])])
    low, high = values[:k], values[k:]
    spread = max(tolerance, _spread(low), _spread(high))
    if (
        high[0] - low[-1] < TUNING.changes_gap * spread
        or np.median(high) - np.median(low) < TUNING.changes_apart * spread
    ):
        return [members]
    parts = (np.sort(ordered[:k]), np.sort(ordered[k:]))
    return [part for one in parts for part in _split_sort(one, column, least, tolerance)]


def _spread(values: Floats) -> float:
    return float(np.median(np.abs(values - np.median(values))) / NORMAL_MEDIAN)

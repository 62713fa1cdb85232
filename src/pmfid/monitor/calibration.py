"""Thresholds, calibrated for a rate of false alarms."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from pmfid._stage import centred, weights
from pmfid.elementary import exp, log
from pmfid.encoder import quantize
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.base import Estimator
from pmfid.fit.free_motion import simulate_from_rest
from pmfid.monitor.detector import EDGE, statistics
from pmfid.monitor.scores import (
    UNUSABLE,
    UNUSABLE_AT_REST,
    Blocks,
    Scale,
    block_samples,
    make_scale,
    scores,
    start_blocks,
)
from pmfid.monitor.tuning import TUNING
from pmfid.monitor.warmth import Warmth, find_warmth
from pmfid.types import Counts, Floats


def powers(x: Floats, w: Floats, edge: float) -> tuple[Floats, Floats]:
    """Return the mean square of sums of blocks, divided by their information, and the standard error of this ratio.

    The blocks x and their information w are (runs, n, p). The ratios and errors are (lengths, p), with a row for each
    of the `calibration_lengths`. Sums without information do not count. `edge` has the meaning as in `detectors`.
    """
    means, errors = [], []
    for length in TUNING.calibration_lengths:
        n = x.shape[1] // length * length
        sums = [part[:, :n].reshape(x.shape[0] * (n // length), length, x.shape[2]).sum(axis=1) for part in (x, w)]
        informed = sums[1].mean(axis=1) > 0
        power = sums[0][informed] ** 2 / (sums[1][informed] + edge)
        count = max(1, len(power))
        means.append(power.mean(axis=0) if len(power) else np.ones(x.shape[2]))
        errors.append(power.std(axis=0) / math.sqrt(count) if len(power) else np.full(x.shape[2], np.inf))
    return np.array(means), np.array(errors)


def noisier(record: tuple[Floats, Floats], simulated: tuple[Floats, Floats], edge: float) -> bool:
    """Return whether sums of the record's blocks deviate by more than sums of simulated blocks.

    The record has x and w (n, p), and the simulation has x and w (runs, n, p).
    """
    mean, error = powers(record[0][None], record[1][None], edge)
    normal, _ = powers(*simulated, edge)
    return bool(np.any(mean - np.maximum(TUNING.calibration_larger * error, (TUNING.at_least - 1) * normal) > normal))


def piece_length(x: Floats) -> int:
    """Return the number of units per piece at which pieces of x (n, p) keep the correlation of neighbours.

    The result is the smallest number with the right variance per unit. Within chance, the variance per unit does not
    change if a sum has four times as many units.
    """
    for length in TUNING.calibration_pieces[:-1]:
        n = len(x) // (4 * length)
        chance = 2 * math.sqrt(2 / max(n, 1))
        short, long = (_variance(x, pieces) for pieces in (length, 4 * length))
        if np.all(np.abs(long / short - 1) <= max(TUNING.calibration_same, chance)):
            return length
    return TUNING.calibration_pieces[-1]


def _variance(x: Floats, length: int) -> Floats:
    """Return the mean square (p,) per unit, for sums over `length` units of x (n, p)."""
    n = len(x) // length * length
    if n == 0:
        return np.ones(x.shape[1])
    return np.asarray((x[:n].reshape(-1, length, x.shape[1]).sum(axis=1) ** 2).mean(axis=0) / length)


def resample_units(
    x: Floats, w: Floats, shape: tuple[int, int], length: int, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Draw units (runs, n, p) in pieces of `length` from random places of a record x, w (n, p).

    Mean and standard deviation of each run come from a second resampled record of the original length. The errors of
    mean and standard deviation are then as large as in a record of this length.
    """
    drawn = _rows(len(x), shape, length, rng)
    learned = _rows(len(x), (shape[0], len(x)), length, rng)
    mean = x[learned].sum(axis=1) / w[learned].sum(axis=1)
    std = np.sqrt(((x[learned] - w[learned] * mean[:, None]) ** 2).mean(axis=1))
    return (x[drawn] - w[drawn] * mean[:, None]) / std[:, None], w[drawn]


def _rows(n: int, shape: tuple[int, int], length: int, rng: np.random.Generator) -> np.ndarray:
    """Return places (runs, n) in a record of n units."""
    starts = rng.integers(n, size=(shape[0], -(-shape[1] // length), 1))
    return np.asarray(((starts + np.arange(length)) % n).reshape(shape[0], -1)[:, : shape[1]])


@dataclass(frozen=True)
class NormalWork:
    """Normal work, divided into units.

    `size` is the information of a unit [average blocks]. `offset` (p,) is the constant deviation of the parameters by
    unmodelled effects [unit of theta]. `scale` is the scale of units. `limit` (p,) is the deviation, in standard
    deviations of the scale, beyond which a unit has less weight.
    """

    size: float
    offset: Floats
    scale: Scale
    limit: Floats

    def units(self, blocks: Blocks, information: Floats) -> Blocks:
        """Return the whole units of blocks that have the information (n,) in average blocks."""
        return self.weigh(self.centre(sum_blocks(blocks, information, self.size)))

    def centre(self, blocks: Blocks) -> Blocks:
        """Return blocks, or sums of blocks, without the constant deviation."""
        return replace(blocks, score=centred(blocks.score, blocks.cross, self.offset))

    def weigh(self, units: Blocks) -> Blocks:
        """Return centred units, each multiplied by its weight."""
        weight = weights(self.scale.standardise(units)[0], self.limit)
        return Blocks(
            units.score * weight[:, None], units.cross * weight[:, None, None], units.square * weight[:, None, None]
        )


def sum_blocks(blocks: Blocks, information: Floats, size: float) -> Blocks:
    """Return sums of blocks, each with at least `size` of the information (n,)."""
    ends, gathered = [0], 0.0
    for k, part in enumerate(information.tolist()):
        gathered += part
        if gathered >= size:
            ends.append(k + 1)
            gathered = 0.0
    begins = np.array(ends[:-1], int)
    if not begins.size:
        return blocks[:0]
    used = blocks[: ends[-1]]
    return Blocks(*(np.add.reduceat(part, begins, axis=0) for part in (used.score, used.cross, used.square)))


def learn(blocks: Blocks, information: Floats) -> NormalWork:
    """Learn normal work from its blocks and their information (n,), in average blocks."""
    found = _learn_units(
        units := sum_blocks(blocks, information, TUNING.calibration_sizes[0]), TUNING.calibration_sizes[0]
    )
    for size in TUNING.calibration_sizes[1:]:
        larger = sum_blocks(blocks, information, size)
        if _alike(found.scale.standardise(found.weigh(found.centre(units)))[0]) <= TUNING.calibration_alike:
            return found
        if len(larger.score) < TUNING.least_units:
            return found
        units, found = larger, _learn_units(larger, size)
    return found


def _alike(x: Floats) -> float:
    """Return the largest correlation of x (n, p) between neighbouring units."""
    return float(np.max(np.abs((x[1:] * x[:-1]).mean(axis=0) / (x**2).mean(axis=0))))


def _learn_units(units: Blocks, size: float) -> NormalWork:
    p = units.score.shape[1]
    found = NormalWork(size, np.zeros(p), make_scale(units), np.full(p, np.inf))
    for _ in range(TUNING.calibration_passes):
        counted = found.weigh(found.centre(units))
        step = np.linalg.solve(counted.cross.sum(axis=0), counted.score.sum(axis=0))
        found = replace(found, offset=found.offset + step)
        scale = make_scale(found.weigh(found.centre(units)))
        x, _ = scale.standardise(found.centre(units))
        found = replace(found, scale=scale, limit=np.quantile(np.abs(x), TUNING.calibration_within, axis=0))
    x, w = found.scale.standardise(found.weigh(found.centre(units)))
    sigma = np.sqrt((x**2).mean(axis=0))
    scale = replace(found.scale, sigma=found.scale.sigma * sigma, energy=found.scale.energy * w.mean(axis=0))
    return replace(found, scale=scale, limit=found.limit / sigma)


#: Least number of units whose scatter gives thresholds. Each quarter of the record needs an own estimate of the
#: scatter.
LEAST_RECORD_UNITS = TUNING.calibration_parts * TUNING.least_record_blocks


@dataclass(frozen=True)
class Tail:
    """The rate of false alarms [1/h], which is rate exp(-(h - level) / slope) at a threshold h >= level.

    `maxima` (m,) has the largest interval maxima in falling order, from `hours` of simulation. `parts` has the level,
    slope and rate of each part of the record.
    """

    level: float
    slope: float
    rate: float
    hours: float
    maxima: tuple[float, ...]
    parts: tuple[tuple[float, float, float], ...] = ()

    def threshold(self, mtbf_hours: float) -> float:
        """Return the threshold for a mean time between false alarms [h], raised by one standard error."""
        careful = min(exp(self.doubt(mtbf_hours)), TUNING.calibration_careful)
        return _line(self.level, self.slope, self.rate, careful * mtbf_hours)

    def doubt(self, mtbf_hours: float) -> float:
        """Return the standard error of the logarithm of the mean time between false alarms, or 0 without parts.

        The error comes from the differences between the parts of the record.
        """
        if not self.parts:
            return 0.0
        thresholds = [_line(*part, mtbf_hours) for part in self.parts]
        return float(np.std(thresholds, ddof=1)) / math.sqrt(len(thresholds)) / self.slope


def _line(level: float, slope: float, rate: float, mtbf_hours: float) -> float:
    return level + slope * log(max(mtbf_hours * rate, 1.0))


@dataclass(frozen=True)
class Calibration:
    """The thresholds and scales of a monitor, as `calibrate` returns them.

    Attributes
    ----------
    theta
        (p,) reference parameters, in their units.
    scale
        Scale of normal work.
    tail
        Distribution of large statistics.
    noise
        (p,) standard deviation of normal work over the standard deviation in the simulation.
    hours
        Simulated time [h].
    record_hours
        Length [h] of the record whose units of work gave the tails; 0 if the simulation gave the tails.
    work
        Normal work of this record, in units; None if the simulation gave the tails.
    warmth
        How friction follows a temperature; None without a temperature.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import RIV, Drive, Encoder
    >>> from pmfid.monitor import calibrate
    >>> from pmfid.simulation import CART, make_scenario
    >>> work = make_scenario("moves", seed=1, duration=200.0)
    >>> riv = RIV(Drive(CART.input_gain), Encoder(work.resolution), work.dt, 50.0, forgetting=0.99)
    >>> theta = np.array([CART.mass, CART.viscous_friction, CART.coulomb_friction])
    >>> calibration = calibrate(riv, theta, work.motion.u, work.counts, hours=0.5)
    >>> round(calibration.tail.threshold(24.0)), calibration.hours
    (13, 0.5)
    """

    theta: Floats
    scale: Scale
    tail: Tail
    noise: Floats
    hours: float
    record_hours: float = 0.0
    work: NormalWork | None = None
    warmth: Warmth | None = None

    @property
    def left_out(self) -> int:
        """Status bits of samples that do not count, as in `scores.Scoring`."""
        return UNUSABLE if self.work is None else UNUSABLE_AT_REST

    def deviations(self, blocks: Blocks) -> tuple[Floats, Floats]:
        """Return the deviations x and information w (n, p) that the detectors take, from blocks at theta."""
        if self.work is None:
            return self.scale.standardise(blocks)
        return self.work.scale.standardise(self.work.units(blocks, self.scale.information(blocks)))


def calibrate(
    estimator: Estimator,
    theta: Floats,
    u: Floats,
    counts: Counts | None,
    *,
    hours: float,
    temperature: Floats | None = None,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Calibration:
    """Simulate hours of normal work, and return the threshold and scales.

    Parameters
    ----------
    estimator
        Estimator of the axis.
    theta
        (p,) reference parameters, in their units, at the mean temperature if there is a temperature.
    u
        (n,) input of a record of normal work [V].
    counts
        (n,) counts of the record. None if the record may not be normal; the noise then comes from the encoder alone.
    hours
        Time to simulate [h].
    temperature
        (n,) temperature of the record with `counts`, or another slow column that friction follows.
    seed
        Seed of the simulation.
    progress
        Function that is called with the completed fraction.

    Returns
    -------
    Calibration
        Thresholds and scales for `Monitor`.

    Raises
    ------
    UsageError
        If the record is too short.
    NotIdentifiableError
        If the record does not move enough.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import RIV, Drive, Encoder
    >>> from pmfid.monitor import calibrate
    >>> from pmfid.simulation import CART, make_scenario
    >>> work = make_scenario("moves", seed=1, duration=200.0)
    >>> riv = RIV(Drive(CART.input_gain), Encoder(work.resolution), work.dt, 50.0, forgetting=0.99)
    >>> theta = np.array([CART.mass, CART.viscous_friction, CART.coulomb_friction])
    >>> calibration = calibrate(riv, theta, work.motion.u, work.counts, hours=0.5)
    >>> calibration.theta.tolist(), calibration.record_hours
    ([1.07, 12.8, 0.8], 0.0)
    """
    runs = replays(estimator, theta, u, hours, np.random.default_rng(seed), progress)
    first = next(runs)
    _check(first)
    scale = make_scale(first)
    x, w = map(np.stack, zip(*(scale.standardise(blocks) for blocks in (first, *runs)), strict=True))
    sigma = np.sqrt((x**2).mean(axis=(0, 1)))
    x, scale = x / sigma, replace(scale, sigma=scale.sigma * sigma)
    block_time, zero = block_samples(estimator) * estimator.dt, np.zeros(theta.size)
    tail = fit_tail(statistics(x, w, zero), block_time)
    plain = Calibration(theta, scale, tail, np.ones(theta.size), hours)
    if counts is None:
        return plain
    if temperature is not None:
        plain = replace(plain, warmth=find_warmth(estimator, theta, u, counts, temperature)[0])
    record = _record_blocks(plain, estimator, u, counts, temperature)
    noise = noise_ratio(scale, record)
    plain = replace(plain, noise=noise, scale=replace(scale, sigma=scale.sigma * noise))
    if noisier(plain.scale.standardise(record), (x, w), EDGE):
        blocks = _record_blocks(plain, estimator, u, counts, temperature, UNUSABLE_AT_REST)
        return _calibrate_by_work(plain, estimator, u, blocks, seed)
    return plain


def _calibrate_by_work(plain: Calibration, estimator: Estimator, u: Floats, blocks: Blocks, seed: int) -> Calibration:
    """Return the calibration with units of work in place of `blocks`, and with a tail from resampled units."""
    work = learn(blocks, plain.scale.information(blocks))
    record_hours = len(blocks.score) * block_samples(estimator) * estimator.dt / 3600
    found = replace(plain, work=work, record_hours=record_hours)
    x, w = found.deviations(blocks)
    _check_units(len(x), u.size * estimator.dt)
    rng, unit_time, length = np.random.default_rng(seed), 3600 * record_hours / len(x), piece_length(x)
    size = math.ceil(plain.hours * TUNING.calibration_resampled * 3600 / unit_time / TUNING.calibration_runs)
    parts, top, zero = TUNING.calibration_parts, TUNING.calibration_tail, np.zeros(x.shape[1])

    def draw_tail(x: Floats, w: Floats, runs: int, top: int) -> Tail:
        return fit_tail(statistics(*resample_units(x, w, (runs, size), length, rng), zero), unit_time, top)

    whole = draw_tail(x, w, TUNING.calibration_runs, parts * top)
    quarters = [
        draw_tail(*part, TUNING.calibration_runs // parts, top)
        for part in zip(np.array_split(x, parts), np.array_split(w, parts), strict=True)
    ]
    return replace(found, tail=replace(whole, parts=tuple((one.level, one.slope, one.rate) for one in quarters)))


def _check_units(units: int, time: float) -> None:
    if units < LEAST_RECORD_UNITS:
        enough = LEAST_RECORD_UNITS / max(units, 1) * time
        raise UsageError(
            "the record of normal work is noisier than the encoder explains. Thresholds from its scatter "
            f"need {LEAST_RECORD_UNITS} independent stretches of motion, and it has {units} in {time:.3g} "
            f"s: record {enough:.3g} s or more, without a change of the machine"
        )


def _record_blocks(
    plain: Calibration,
    estimator: Estimator,
    u: Floats,
    counts: Counts,
    temperature: Floats | None,
    left_out: int = UNUSABLE,
) -> Blocks:
    """Return the blocks of a normal record after the time when the model reaches the plant's velocity.

    Raises UsageError if too few blocks remain.
    """
    theta, start = plain.theta, start_blocks(estimator, plain.theta)
    if plain.warmth is None or temperature is None:
        blocks = scores(estimator, theta, u, counts, left_out)[start:]
    else:
        blocks = plain.warmth.scores(estimator, theta, u, counts, temperature, left_out)[start:]
    if len(blocks.score) < TUNING.least_record_blocks:
        least = (start + TUNING.least_record_blocks) * block_samples(estimator) * estimator.dt
        raise UsageError(
            f"the record of normal work has {u.size * estimator.dt:.3g} s, too few to measure its "
            f"scatter, which takes {least:.3g} s: record longer, 10 minutes or more for good thresholds"
        )
    return blocks


def replays(
    estimator: Estimator,
    theta: Floats,
    u: Floats,
    hours: float,
    rng: np.random.Generator,
    progress: Callable[[float], None] | None = None,
) -> Iterator[Blocks]:
    """Yield the blocks of simulated runs of `run_time`, `hours` in total.

    Each simulated run repeats the input from a random moment.
    """
    samples, runs = round(TUNING.run_time / estimator.dt), max(1, round(hours * 3600 / TUNING.run_time))
    for run in range(runs):
        start = int(rng.integers(u.size))
        part = np.resize(np.roll(u, -start), samples)
        yield scores(estimator, theta, part, simulated_counts(estimator, theta, part, float(rng.random())))
        if progress is not None:
            progress((run + 1) / runs)


def simulated_counts(estimator: Estimator, theta: Floats, u: Floats, phase: float) -> Counts:
    """Return the counts (n,) of the model with the parameters theta (p,) under the input u (n,).

    `phase` is the start on the encoder's lattice, in counts.
    """
    position = simulate_from_rest(estimator.equation, theta, u[:-1], estimator.dt)
    if not np.max(np.abs(position)) < TUNING.most_counts * estimator.encoder.resolution:
        values = ", ".join(f"{name} {value:.3g}" for name, value in zip(estimator.names, theta.tolist(), strict=False))
        raise NotIdentifiableError(
            f"the model with the normal parameters ({values}) is unstable under the recorded input: "
            "correct the nominal values, or take a record of normal work that identifies the parameters"
        )
    return quantize(position + phase * estimator.encoder.resolution, estimator.encoder.resolution)


def fit_tail(statistic: Floats, block_time: float, top: int = TUNING.calibration_tail) -> Tail:
    """Return the tail from the `top` largest interval maxima of the statistic (runs, n). A block lasts `block_time`
    [s].
    """
    size = max(1, round(TUNING.interval_time / block_time))
    n = statistic.shape[1] // size
    maxima = np.sort(statistic[:, : n * size].reshape(-1, size).max(axis=1))[::-1]
    hours, top = maxima.size * size * block_time / 3600, min(top, maxima.size // 4)
    level = float(maxima[top])
    slope = float(np.mean(maxima[:top] - level))
    return Tail(level, slope, top / hours, hours, tuple(float(value) for value in maxima[: top + 1]))


def noise_ratio(scale: Scale, blocks: Blocks) -> Floats:
    """Return the standard deviation (p,) of a record's blocks, as a multiple of the scale's.

    The ratio is 1 if the difference could be chance.
    """
    x, _ = scale.standardise(blocks)
    power = (x**2).mean(axis=0)
    error = (x**2).std(axis=0) / math.sqrt(len(x))
    return np.where(np.abs(power - 1) > TUNING.calibration_noisier * error, np.sqrt(power), 1.0)


def _check(blocks: Blocks) -> None:
    if len(blocks.score) < TUNING.least_blocks:
        raise UsageError(
            f"the cutoff gives {len(blocks.score)} blocks in {TUNING.run_time:g} s, and the monitor needs "
            f"{TUNING.least_blocks}; use a higher cutoff"
        )
    mean = blocks.cross.mean(axis=0)
    size = np.sqrt(np.abs(np.diagonal(mean)))
    if not np.all(size > 0) or np.linalg.cond(mean / np.outer(size, size)) > 1e4:
        raise NotIdentifiableError(
            "the reference motion does not excite every parameter, so a detector could not distinguish "
            "their changes; record normal work in both directions, with accelerations and several speeds"
        )

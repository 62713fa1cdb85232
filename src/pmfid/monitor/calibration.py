"""Thresholds from a mean time between false alarms, by simulation of normal work.

The input of a record of normal work drives the reference model from random positions on the encoder's lattice; the
statistic of a detector is then chance. Its maxima over intervals much longer than its memory are counted; their tail is
exponential (Gumbel's domain), so log(rate) falls linearly with the threshold, and a rate that was too rare to be seen
often is read off that line. Where the record itself deviates by more than the simulation, its own units of work take
the place of the simulated blocks (`work`, `reference`): they run through the very detectors, in many more hours than
the record has, and parts of the record alone say how sure that is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmfid.encoder import quantize
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.base import Estimator
from pmfid.estimators.motion import mean_velocity
from pmfid.monitor.detectors import EDGE, ChiSquare, Detector, make_detectors, statistics
from pmfid.monitor.reference import noisier, piece_length, resample_units
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
from pmfid.monitor.work import NormalWork, learn
from pmfid.types import Counts, Floats

#: Length of one simulated run [s], and of the intervals whose maxima are counted.
RUN_TIME = 1800.0
INTERVAL_TIME = 30.0
#: Simulated time, in asked times between false alarms, and its limits [h].
HOURS_PER_MTBF, LEAST_HOURS, MOST_HOURS = 4.0, 20.0, 100.0
#: Maxima that the line through the tail is fitted to.
TAIL = 100
#: Difference of a record's noise from the simulated noise, in standard errors, from which the record's noise is used.
NOISIER = 3.0
#: Hours of resampled work for one hour of simulated work, and the number of runs that these hours are drawn in.
RESAMPLED, RUNS = 4.0, 64
#: Parts of a record whose thresholds are compared, and how much rarer than asked alarms are made at most, by what the
#: record leaves in doubt: less often is better than more often.
PARTS, CAREFUL = 4, 2.0
#: Discount of a unit of work in the memory of `ChiSquare`.
UNIT_KEEP = 0.85
#: A simulated machine that goes further runs away [counts].
MOST_COUNTS = 2.0**53
#: Blocks that a simulated run must have.
LEAST_BLOCKS = 200
#: Least blocks of a record of normal work: the scatter of fewer does not determine its noise.
LEAST_RECORD_BLOCKS = 8
#: Units of work in the record whose scatter gives thresholds: each quarter needs a scatter of its own.
LEAST_UNITS = PARTS * LEAST_RECORD_BLOCKS


@dataclass(frozen=True)
class Tail:
    """Rate of false alarms [1/h] at a threshold h: rate exp(-(h - level) / slope) from `level` on.

    maxima: (m,) the largest interval maxima, falling; hours: simulated for them; parts: level, slope and rate of parts
    of the record alone.
    """

    level: float
    slope: float
    rate: float
    hours: float
    maxima: tuple[float, ...]
    parts: tuple[tuple[float, float, float], ...] = ()

    def threshold(self, mtbf_hours: float) -> float:
        """The threshold for a mean time between false alarms [h], a standard error on the rare side."""
        careful = min(math.exp(self.doubt(mtbf_hours)), CAREFUL)
        return _line(self.level, self.slope, self.rate, careful * mtbf_hours)

    def doubt(self, mtbf_hours: float) -> float:
        """Standard error of the logarithm of that mean time, from differences of the parts; 0 without parts."""
        if not self.parts:
            return 0.0
        thresholds = [_line(*part, mtbf_hours) for part in self.parts]
        return float(np.std(thresholds, ddof=1)) / math.sqrt(len(thresholds)) / self.slope


def _line(level: float, slope: float, rate: float, mtbf_hours: float) -> float:
    return level + slope * math.log(max(mtbf_hours * rate, 1.0))


@dataclass(frozen=True)
class Calibration:
    """theta: (p,) reference; scale: of normal work; chi_square: precision of that detector; tails: by detector; noise:
    (p,) standard deviation of normal work over that of the simulation; hours: simulated; record_hours: of the record
    whose units the tails are made of, 0 if they are the simulation's; work: those units, None there."""

    theta: Floats
    scale: Scale
    chi_square: tuple[tuple[float, ...], ...]
    tails: dict[str, Tail]
    noise: Floats
    hours: float
    record_hours: float = 0.0
    work: NormalWork | None = None

    @property
    def left_out(self) -> int:
        """Status of the samples that count for nothing, as in `scores.Scoring`."""
        return UNUSABLE if self.work is None else UNUSABLE_AT_REST

    def detectors(self, estimator: Estimator) -> dict[str, Detector]:
        """By name, as they were calibrated."""
        keep = block_keep(estimator) if self.work is None else UNIT_KEEP
        return make_detectors(keep, self.chi_square)

    def deviations(self, blocks: Blocks) -> tuple[Floats, Floats]:
        """x, w: (n, p) that the detectors take, of blocks at theta."""
        if self.work is None:
            return self.scale.standardise(blocks)
        return self.work.scale.standardise(self.work.units(blocks, self.scale.information(blocks)))


def block_keep(estimator: Estimator) -> float:
    """Discount of a block in the memory of the estimator; without forgetting that of 10 blocks."""
    forgetting = float(getattr(estimator, "forgetting", 1.0))
    return forgetting ** block_samples(estimator) if forgetting < 1 else 0.9


def simulated_hours(mtbf_hours: float) -> float:
    """How long to simulate for a mean time between false alarms; both in h."""
    return min(max(HOURS_PER_MTBF * mtbf_hours, LEAST_HOURS), MOST_HOURS)


def calibrate(
    estimator: Estimator,
    theta: Floats,
    u: Floats,
    counts: Counts | None,
    *,
    hours: float,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Calibration:
    """Simulates `hours` of normal work at theta (p,) under the input u (n,) of a record of it.

    counts: (n,) of the record; None if it is not known to be normal: then the noise is the encoder's alone. Raises
    UsageError for a record that is too short and NotIdentifiableError for one that does not move enough.
    """
    runs = replays(estimator, theta, u, hours, np.random.default_rng(seed), progress)
    first = next(runs)
    _check(first)
    scale = make_scale(first)
    x, w = _stack([scale.standardise(blocks) for blocks in (first, *runs)])
    sigma = np.sqrt((x**2).mean(axis=(0, 1)))
    x, scale = x / sigma, replace(scale, sigma=scale.sigma * sigma)
    plain = Calibration(theta, scale, (), {}, np.ones(theta.size), hours)
    if counts is not None:
        record = _record_blocks(estimator, theta, u, counts)
        noise = noise_ratio(scale, record)
        plain = replace(plain, noise=noise, scale=replace(scale, sigma=scale.sigma * noise))
        own = plain.scale.standardise(record)
        if noisier(own, (x, w), EDGE):
            return _calibrate_by_work(plain, estimator, u, counts, seed)
    precision = _precision(ChiSquare(block_keep(estimator)), x, w)
    plain = replace(plain, chi_square=precision)
    tails = _tails(plain.detectors(estimator), x, w, block_samples(estimator) * estimator.dt)
    return replace(plain, tails=tails)


def _calibrate_by_work(plain: Calibration, estimator: Estimator, u: Floats, counts: Counts, seed: int) -> Calibration:
    """The calibration with units of work in place of blocks, and tails of their resampled sequence."""
    blocks = _record_blocks(estimator, plain.theta, u, counts, UNUSABLE_AT_REST)
    work = learn(blocks, plain.scale.information(blocks))
    record_hours = len(blocks.score) * block_samples(estimator) * estimator.dt / 3600
    found = replace(plain, work=work, record_hours=record_hours)
    x, w = found.deviations(blocks)
    _check_units(len(x), u.size * estimator.dt)
    found = replace(found, chi_square=_precision(ChiSquare(UNIT_KEEP), x[None], w[None]))
    rng, unit_time, length = np.random.default_rng(seed), 3600 * record_hours / len(x), piece_length(x)
    size = math.ceil(RESAMPLED * plain.hours * 3600 / unit_time / RUNS)
    detectors = found.detectors(estimator)
    top = round(RESAMPLED * TAIL)
    whole = _tails(detectors, *resample_units(x, w, (RUNS, size), length, rng), unit_time, top)
    quarters = [
        _tails(detectors, *resample_units(*part, (RUNS // PARTS, size), length, rng), unit_time, top // PARTS)
        for part in zip(np.array_split(x, PARTS), np.array_split(w, PARTS), strict=True)
    ]
    tails = {
        name: replace(tail, parts=tuple((part[name].level, part[name].slope, part[name].rate) for part in quarters))
        for name, tail in whole.items()
    }
    return replace(found, tails=tails)


def _check_units(units: int, time: float) -> None:
    if units < LEAST_UNITS:
        enough = LEAST_UNITS / max(units, 1) * time
        raise UsageError(
            f"the record of normal work is noisier than the encoder explains, and has {units} units of work in "
            f"{time:.3g} s: thresholds from its scatter need {LEAST_UNITS}; record {enough:.3g} s or more, without a "
            "change of the machine"
        )


def _tails(detectors: dict[str, Detector], x: Floats, w: Floats, block_time: float, top: int = TAIL) -> dict[str, Tail]:
    nothing = np.zeros(x.shape[-1])
    return {name: fit_tail(statistics(found, x, w, nothing), block_time, top) for name, found in detectors.items()}


def _record_blocks(estimator: Estimator, theta: Floats, u: Floats, counts: Counts, left_out: int = UNUSABLE) -> Blocks:
    """Of a record of normal work, once the model has its velocity; raises UsageError if hardly any are left."""
    start = start_blocks(estimator, theta)
    blocks = scores(estimator, theta, u, counts, left_out)[start:]
    if len(blocks.score) < LEAST_RECORD_BLOCKS:
        least = (start + LEAST_RECORD_BLOCKS) * block_samples(estimator) * estimator.dt
        raise UsageError(
            f"the record of normal work has {u.size * estimator.dt:.3g} s, its scatter shows from {least:.3g} s on: "
            "record longer, 10 minutes or more for good thresholds"
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
    """Blocks of simulated runs of RUN_TIME, `hours` in all: the input from a random moment on, over and over."""
    samples, runs = round(RUN_TIME / estimator.dt), max(1, round(hours * 3600 / RUN_TIME))
    for run in range(runs):
        start = int(rng.integers(u.size))
        part = np.resize(np.roll(u, -start), samples)
        yield scores(estimator, theta, part, simulated_counts(estimator, theta, part, float(rng.random())))
        if progress is not None:
            progress((run + 1) / runs)


def simulated_counts(estimator: Estimator, theta: Floats, u: Floats, phase: float) -> Counts:
    """Counts (n,) of the model at theta (p,) under u (n,); phase: of the start on the lattice, in counts."""
    mean = mean_velocity(estimator.equation, theta, estimator.dt, u)
    position = np.concatenate([[0.0], np.cumsum(mean[:-1] * estimator.dt)])
    if not np.max(np.abs(position)) < MOST_COUNTS * estimator.encoder.resolution:
        values = ", ".join(f"{name} {value:.3g}" for name, value in zip(estimator.names, theta.tolist(), strict=False))
        raise NotIdentifiableError(
            f"the model with the normal parameters ({values}) runs away under the recorded input: give nominal values "
            "of a machine that does not, or take a record of normal work that identifies them"
        )
    return quantize(position + phase * estimator.encoder.resolution, estimator.encoder.resolution)


def fit_tail(statistic: Floats, block_time: float, top: int = TAIL) -> Tail:
    """The tail of the `top` maxima over intervals of the statistic (runs, n) of blocks of block_time [s]."""
    maxima, hours = _maxima(statistic, block_time)
    top = min(top, maxima.size // 4)
    return _tail(maxima, hours, top)


def _maxima(statistic: Floats, block_time: float) -> tuple[Floats, float]:
    """Maxima over intervals, falling, and their hours."""
    size = max(1, round(INTERVAL_TIME / block_time))
    n = statistic.shape[1] // size
    maxima = np.sort(statistic[:, : n * size].reshape(-1, size).max(axis=1))[::-1]
    return maxima, maxima.size * size * block_time / 3600


def _tail(maxima: Floats, hours: float, top: int) -> Tail:
    level = float(maxima[top])
    slope = float(np.mean(maxima[:top] - level))
    return Tail(level, slope, top / hours, hours, tuple(float(value) for value in maxima[: top + 1]))


def noise_ratio(scale: Scale, blocks: Blocks) -> Floats:
    """(p,) standard deviation of the blocks of a record over that of the scale; 1 if it could be chance."""
    x, _ = scale.standardise(blocks)
    power = (x**2).mean(axis=0)
    error = (x**2).std(axis=0) / math.sqrt(len(x))
    return np.where(np.abs(power - 1) > NOISIER * error, np.sqrt(power), 1.0)


def _precision(detector: ChiSquare, x: Floats, w: Floats) -> tuple[tuple[float, ...], ...]:
    """Inverse covariance of the deviation of the estimate in normal work x, w: (runs, n, p)."""
    found, total = detector.deviations(x, w), np.zeros((x.shape[-1], x.shape[-1]))
    for k in range(x.shape[1]):
        total += found[:, k].T @ found[:, k]
    inverse = np.linalg.inv(total / (x.shape[0] * x.shape[1]))
    return tuple(tuple(float(value) for value in row) for row in inverse)


def _stack(parts: Sequence[tuple[Floats, Floats]]) -> tuple[Floats, Floats]:
    return np.stack([x for x, _ in parts]), np.stack([w for _, w in parts])


def _check(blocks: Blocks) -> None:
    if len(blocks.score) < LEAST_BLOCKS:
        raise UsageError(
            f"the cutoff gives {len(blocks.score)} blocks in {RUN_TIME:g} s, not {LEAST_BLOCKS}; use a higher one"
        )
    mean = blocks.cross.mean(axis=0)
    size = np.sqrt(np.abs(np.diagonal(mean)))
    if not np.all(size > 0) or np.linalg.cond(mean / np.outer(size, size)) > 1e4:
        raise NotIdentifiableError(
            "the reference motion does not excite every parameter: no detector could tell them apart; take a record of "
            "normal work with both directions, accelerations and several speeds"
        )

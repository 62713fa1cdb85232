"""Thresholds from the reference record, for a rate of false alarms."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from pmfid._stage import centred, weights
from pmfid.encoder import quantize
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.base import Estimator
from pmfid.fit.free_motion import simulate_from_rest
from pmfid.monitor.chance import Chance, measure_chance, sum_variances
from pmfid.monitor.detector import WINDOW, statistics
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
from pmfid.types import COUNT_LIMIT, Counts, Floats

#: Lengths of compared sums [blocks], up to the window of the detectors.
LENGTHS = tuple((2 ** np.arange(WINDOW.bit_length())).tolist())


def noisier(record: tuple[Floats, Floats], simulated: tuple[Floats, Floats]) -> bool:
    """Return whether sums of the record's blocks deviate by more than sums of simulated blocks, each x and w (n, p)."""
    (found, error), (normal, other) = (sum_variances(*one, LENGTHS) for one in (record, simulated))
    chance = TUNING.calibration_larger * np.hypot(error, other)
    return bool(np.any(found - np.maximum(chance, (TUNING.at_least - 1) * normal) > normal))


@dataclass(frozen=True)
class NormalWork:
    """Normal work, divided into units.

    `size` is the information of a unit [average blocks], or 0 if each block is a unit. `offset` (p,) is the constant
    deviation of the parameters by unmodelled effects [unit of theta]. `scale` is the scale of units. `limit` (p,) is
    the deviation, in standard deviations of the scale, beyond which a unit has less weight. `spread` (p,) is the
    standard deviation of the parameters by unmodelled effects, and 0 if the noise of the encoder explains the units.
    """

    size: float
    offset: Floats
    scale: Scale
    limit: Floats
    spread: Floats

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
    sizes = TUNING.calibration_sizes
    found = _learn_units(units := sum_blocks(blocks, information, sizes[0]), sizes[0])
    for size in sizes[1:]:
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
    found = NormalWork(size, np.zeros(p), make_scale(units), np.full(p, np.inf), np.zeros(p))
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
    return replace(found, scale=scale, limit=found.limit / sigma, spread=scale.sigma)


@dataclass(frozen=True)
class Calibration:
    """The thresholds and scales of a monitor, as `calibrate` returns them.

    Attributes
    ----------
    theta
        (p,) reference parameters, in their units.
    scale
        Scale of the blocks of normal work.
    work
        Normal work in units, which the detector takes.
    chance
        Chance of large statistics in normal work.
    noise
        (p,) standard deviation of normal work over the standard deviation in the simulation.
    record_hours
        Length [h] of the record that gave the units; 0 if the encoder explains its noise, so that a simulation gave
        the units.
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
    >>> calibration = calibrate(riv, theta, work.motion.u, work.counts)
    >>> float(round(calibration.chance.threshold(24.0), 1))  # for a false alarm in 24 hours
    9.6
    """

    theta: Floats
    scale: Scale
    work: NormalWork
    chance: Chance
    noise: Floats
    record_hours: float = 0.0
    warmth: Warmth | None = None

    @property
    def left_out(self) -> int:
        """Status bits of samples that do not count, as in `scores.Scoring`."""
        return UNUSABLE_AT_REST if self.record_hours else UNUSABLE

    def deviations(self, blocks: Blocks) -> tuple[Floats, Floats]:
        """Return the deviations x and information w (n, p) that the detector takes, from blocks at theta."""
        return self.work.scale.standardise(self.work.units(blocks, self.scale.information(blocks)))


def calibrate(
    estimator: Estimator, theta: Floats, u: Floats, counts: Counts | None, temperature: Floats | None = None
) -> Calibration:
    """Return the threshold and scales for normal work like a record.

    If the noise of the encoder explains the record, the units of work come from one simulation of the record, and large
    statistics from both. If the record is noisier, its own blocks give the units.

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
    temperature
        (n,) temperature of the record with `counts`, or another slow column that friction follows.

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
    >>> calibration = calibrate(riv, theta, work.motion.u, work.counts)
    >>> calibration.theta.tolist(), calibration.record_hours
    ([1.07, 12.8, 0.8], 0.0)
    """
    simulated = _simulate_blocks(estimator, theta, u)
    _check(simulated)
    scale = make_scale(simulated)
    x, w = scale.standardise(simulated)
    chance = measure_chance(_duration(estimator, simulated) / len(x), LENGTHS, x, w)
    statistic = statistics(x, w, np.zeros(theta.size))
    plain = Calibration(theta, scale, _work_of_blocks(scale), chance.inflate(statistic), np.ones(theta.size))
    if counts is None:
        return plain
    if temperature is not None:
        plain = replace(plain, warmth=find_warmth(estimator, theta, u, counts, temperature)[0])
    record = _record_blocks(plain, estimator, u, counts, temperature)
    noise = noise_ratio(scale, record)
    scale = replace(scale, sigma=scale.sigma * noise)
    plain = replace(plain, noise=noise, scale=scale, work=_work_of_blocks(scale))
    if noisier(scale.standardise(record), (x, w)):
        record = _record_blocks(plain, estimator, u, counts, temperature, UNUSABLE_AT_REST)
        return _calibrate_by_record(plain, estimator, record, u.size * estimator.dt)
    in_record = statistics(*scale.standardise(record), np.zeros(theta.size))
    return replace(plain, chance=chance.inflate(statistic, in_record))


def _work_of_blocks(scale: Scale) -> NormalWork:
    """Return normal work whose units are the blocks, for noise that the encoder explains."""
    p = len(scale.inverse)
    return NormalWork(0.0, np.zeros(p), scale, np.full(p, np.inf), np.zeros(p))


def _calibrate_by_record(plain: Calibration, estimator: Estimator, record: Blocks, seconds: float) -> Calibration:
    """Return the calibration by the blocks of a record of a duration [s] whose noise the encoder does not explain."""
    work = learn(record, information := plain.scale.information(record))
    x, w = work.scale.standardise(work.units(record, information))
    time = _duration(estimator, record)
    _check_units(len(x), seconds)
    chance = measure_chance(time / len(x), LENGTHS, x, w, growing=True)
    return replace(plain, work=work, chance=chance, record_hours=time / 3600)


def _duration(estimator: Estimator, blocks: Blocks) -> float:
    """Return the duration of blocks [s]."""
    return len(blocks.score) * block_samples(estimator) * estimator.dt


def _check_units(units: int, time: float) -> None:
    if units < WINDOW:
        enough = WINDOW / max(units, 1) * time
        raise UsageError(
            "the record of normal work is noisier than the encoder explains. Thresholds from its scatter "
            f"need {WINDOW} independent stretches of motion, and it has {units} in {time:.3g} "
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


def _simulate_blocks(estimator: Estimator, theta: Floats, u: Floats) -> Blocks:
    """Return the blocks of the model with the parameters theta (p,) under the input u (n,), repeated for enough blocks.

    The input is divided into parts that begin at different phases of the encoder. The blocks of a part follow the time
    when the model reaches the plant's velocity.
    """
    parts, start = TUNING.calibration_phases, start_blocks(estimator, theta)
    least = (TUNING.calibration_blocks + parts * start) * block_samples(estimator)
    return Blocks.concatenate(
        scores(estimator, theta, part, simulated_counts(estimator, theta, part, (k + 0.5) / parts))[start:]
        for k, part in enumerate(np.array_split(np.resize(u, max(u.size, least)), parts))
    )


def simulated_counts(estimator: Estimator, theta: Floats, u: Floats, phase: float) -> Counts:
    """Return the counts (n,) of the model with the parameters theta (p,) under the input u (n,).

    `phase` is the start on the encoder's lattice, in counts.
    """
    position = simulate_from_rest(estimator.equation, theta, u[:-1], estimator.dt)
    if not np.max(np.abs(position)) < COUNT_LIMIT * estimator.encoder.resolution:
        values = ", ".join(f"{name} {value:.3g}" for name, value in zip(estimator.names, theta.tolist(), strict=False))
        raise NotIdentifiableError(
            f"the model with the normal parameters ({values}) is unstable under the recorded input: "
            "correct the nominal values, or take a record of normal work that identifies the parameters"
        )
    return quantize(position + phase * estimator.encoder.resolution, estimator.encoder.resolution)


def noise_ratio(scale: Scale, blocks: Blocks) -> Floats:
    """Return the standard deviation (p,) of a record's blocks, as a multiple of the scale's.

    The ratio is 1 if the difference could be chance.
    """
    x, _ = scale.standardise(blocks)
    power = (x**2).mean(axis=0)
    error = (x**2).std(axis=0) / math.sqrt(len(x))
    return np.where(np.abs(power - 1) > TUNING.calibration_larger * error, np.sqrt(power), 1.0)


def _check(blocks: Blocks) -> None:
    mean = blocks.cross.mean(axis=0)
    size = np.sqrt(np.abs(np.diagonal(mean)))
    if not np.all(size > 0) or np.linalg.cond(mean / np.outer(size, size)) > 1e4:
        raise NotIdentifiableError(
            "the reference motion does not excite every parameter, so a detector could not distinguish "
            "their changes; record normal work in both directions, with accelerations and several speeds"
        )

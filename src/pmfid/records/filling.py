"""Filling of lost samples by the motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import NotIdentifiableError
from pmfid.estimators.bridges import Body
from pmfid.estimators.iv import IV
from pmfid.estimators.motion import rms
from pmfid.models.equation import MASS
from pmfid.records.gaps import Gap, best_of, fill_gaps, gaps_of, is_held
from pmfid.records.tuning import TUNING
from pmfid.types import Counts, Flags, Floats


@dataclass(frozen=True)
class Steps:
    """The smoothed deviation of the measured motion from the simulated motion.

    `start` is the deviation of the velocity at the first sample [counts/s]. `size` and `variance` (g,) belong to the
    steps of the velocity at the events, and are 0 at the first event. `deviation` (n,) is the deviation of the position
    [counts].
    """

    start: float
    size: Floats
    variance: Floats
    deviation: Floats


def smooth_deviation(
    deviation: Floats, there: Flags, events: NDArray[np.intp], steps: Floats, moves: Floats, decay: float, dt: float
) -> Steps:
    """Return the smoothed deviation (n,) [counts] and its steps, from the measured samples.

    `events` (g,) are sample numbers that start with 0. `steps` and `moves` (g,) are the variances of the changes of
    velocity and position at the events. `decay` is in 1/s.
    """
    from scipy.linalg import cho_solve_banded, cholesky_banded  # slow to import

    n, g = deviation.size, events.size
    segment = np.repeat(np.arange(g), np.diff(np.r_[events, n]))
    response = _travel(np.asarray((np.arange(n) - events[segment]) * dt, np.float64), decay)
    weight = there / TUNING.filling_count
    one, first, second, right, right_first = (
        np.add.reduceat(weight * part, events)
        for part in (np.ones(n), response, response**2, deviation, response * deviation)
    )
    lasting = np.diff(events) * dt
    along, kept, free, still = _travel(lasting, decay), np.exp(-decay * lasting), 1 / steps[1:], 1 / moves[1:]
    band = np.zeros((4, 2 * g))  # band of the lower triangle, in which position and velocity alternate
    band[0, 0::2] = one + np.r_[still, TUNING.filling_nothing] + np.r_[TUNING.filling_nothing, still]
    band[0, 1::2] = (
        second + np.r_[still * along**2 + free * kept**2, TUNING.filling_nothing] + np.r_[TUNING.filling_nothing, free]
    )
    band[1, 0::2] = first + np.r_[still * along, 0.0]
    band[1, 1:-1:2] = -still * along
    band[2, 0:-2:2], band[2, 1:-2:2] = -still, -free * kept
    factor = cholesky_banded(band, lower=True)
    found = cho_solve_banded((factor, True), np.column_stack([right, right_first]).ravel())
    position, velocity = found[0::2], found[1::2]
    size = np.r_[0.0, velocity[1:] - kept * velocity[:-1]]
    variance = np.r_[0.0, _variances(factor, kept)]
    return Steps(float(velocity[0]), size, variance, position[segment] + response * velocity[segment])


def _travel(time: Floats, decay: float) -> Floats:
    """Return the change of the position during a time after a unit deviation of the velocity."""
    return np.asarray(-np.expm1(-decay * time) / decay if decay > 0 else time)


def _variances(factor: Floats, kept: Floats) -> Floats:
    """Return the posterior variances (g - 1,) of the steps, which are velocity minus `kept` times the previous
    velocity.
    """
    from scipy.linalg import cho_solve_banded  # slow to import

    variances = np.empty(kept.size)
    for first in range(0, kept.size, TUNING.filling_chunk):
        own = np.arange(first, min(first + TUNING.filling_chunk, kept.size))
        sides = np.zeros((factor.shape[1], own.size))
        columns = np.arange(own.size)
        sides[2 * own + 3, columns], sides[2 * own + 1, columns] = 1.0, -kept[own]
        variances[own] = np.sum(sides * cho_solve_banded((factor, True), sides), axis=0)
    return variances


class FilledMachine(Body):
    """A model with its parameters, and the derived quantities that fill a gap."""

    def motion(self, u: Floats, speed: float) -> tuple[Floats, Floats]:
        """Return position [counts] from 0 and velocity [counts/s], each (n,), after a start at `speed` [counts/s]."""
        velocity = self.speeds(u, speed)[0]
        return np.r_[0.0, np.cumsum(velocity[:-1])] * self.dt, velocity

    @property
    def often(self) -> int:
        """The number of samples within which a wrong parameter hardly changes the deviation of the velocity."""
        return max(TUNING.filling_fewest, round(TUNING.filling_often / (self.cutoff * self.dt)))

    @property
    def push(self) -> float:
        """The change of the velocity by one sample of a unit input [counts/s]."""
        return self.equation.input_gain * self.dt / self.values[MASS] / self.step


def fill_by_motion(
    method: IV, u: Floats, counts: Counts, there: Flags, given: Flags | None = None
) -> tuple[Floats, Counts] | None:
    """Return input and counts (n,) with missing samples filled by the motion.

    `there` (n,) marks the measured samples, and `given` (n,) the measured inputs if there are more. The start values
    come from `fill_gaps`. A NaN input remains NaN. If the motion determines the input in a gap better than
    interpolation, the input becomes NaN. The result is None if the record identifies no motion.
    """
    line, own, held = (u, counts), np.flatnonzero(np.isfinite(u)), is_held(u, there)
    given = there if given is None else given
    parts = np.split(own, np.flatnonzero(np.diff(own) > 1) + 1)
    try:
        theta = method.settle_iteration(u, counts)[1]
        for _ in range(TUNING.filling_turns):
            machine = FilledMachine(method.equation, theta, method.dt, method.encoder.resolution, method.cutoff)
            u, counts = line[0].copy(), line[1].copy()
            for part in parts:
                if not np.all(there[part]):
                    u[part], counts[part] = _fill_part(
                        machine, line[0][part], line[1][part], there[part], given[part], held
                    )
            before, theta = theta, method.settle_iteration(u, counts)[1]
            if (
                np.max(np.abs(theta - before) / np.maximum(np.abs(theta), np.finfo(float).tiny))
                < TUNING.filling_settled
            ):
                break
    except (NotIdentifiableError, np.linalg.LinAlgError):
        return None
    return u, counts


def doubt(method: IV, u: Floats, counts: Counts, there: Flags) -> Floats:
    """Return the relative errors (p,) of the parameters by missing samples, or 1 if too few samples remain.

    The function removes an equal part of the measured samples and fills them. The resulting change of the parameters
    estimates the error that the missing samples cause.
    """
    chance, part = np.random.default_rng(TUNING.filling_again), 1 - float(np.mean(there[np.isfinite(u)]))
    fewer = there & (chance.random(u.size) >= part)
    fewer[[0, -1]] = True
    places = np.flatnonzero(fewer)
    again = fill_gaps(u[places], counts[places], places)[:2]
    line = np.where(np.isfinite(u), again[0], np.nan), again[1]
    try:
        theta, found = method.settle_iteration(u, counts)[1], fill_by_motion(method, *line, fewer) or line
        moved = method.settle_iteration(*found)[1] - theta
    except NotIdentifiableError:
        return np.ones(len(method.names))
    return np.abs(moved) / np.maximum(np.abs(theta), np.finfo(float).tiny)


def _fill_part(
    machine: FilledMachine, u: Floats, counts: Counts, there: Flags, given: Flags, held: bool
) -> tuple[Floats, Counts]:
    """Return the filled input and counts of one part (n,) with measured ends. `held` says whether the input is held."""
    place, speed = counts - counts[0] + 0.5, 0.0
    gap = _doubtful(u, given, held)
    missed, none = _estimate_input_errors(gap, u, given, held), np.zeros(0, np.intp)
    u = u.copy()
    for wrong in TUNING.filling_wrong:
        position, velocity = machine.motion(u, speed)
        found, events = _deviation(machine, gap, missed, place - position, velocity, there, wrong)
        speed += found.start
        at = np.searchsorted(events, gap.after)
        if held:
            _decide(machine, gap, u, found.size[at], found.variance[at])
    # In these gaps, the counts determine the input better than interpolation.
    by_motion = found.variance[at] < (machine.push * missed) ** 2 / 2
    if held:
        gap, missed = Gap(none, none), missed[:0]
    position, velocity = machine.motion(u, speed)
    deviation = place - position
    smooth = _deviation(machine, gap, missed, deviation, velocity, there, TUNING.filling_wrong[-1])[0].deviation
    rows = np.flatnonzero(there)
    line = np.interp(np.arange(u.size), rows, deviation[rows])
    filled = (
        np.floor(position + np.clip(smooth, line - TUNING.filling_within, line + TUNING.filling_within)).astype(
            np.int64
        )
        + counts[0]
    )
    for k in none if held else np.flatnonzero(by_motion):
        u[gap.before[k] + 1 : gap.after[k]] = np.nan
    return u, np.where(there, counts, filled)


def _doubtful(u: Floats, given: Flags, held: bool) -> Gap:
    """Return the gaps of the measured inputs in which the motion determines the input (n,).

    The motion determines the changes of a held input, and the long gaps of any other input.
    """
    gap = gaps_of(given)
    found = np.flatnonzero(u[gap.before] != u[gap.after] if held else gap.missing > TUNING.gaps_always)
    return Gap(gap.before[found], gap.after[found])


def _estimate_input_errors(gap: Gap, u: Floats, given: Flags, held: bool) -> Floats:
    """Return the standard deviations (g,) of the sum of the input (n,) over each gap."""
    if held:
        return np.asarray(np.abs(u[gap.after] - u[gap.before]) * gap.missing / np.sqrt(12))
    if not gap.before.size:
        return np.zeros(0)
    places = np.flatnonzero(given)
    local = best_of(u[places], places)
    sizes = {length: local.estimate_error(u[places], places, length) for length in np.unique(gap.missing).tolist()}
    return np.array([sizes[length] for length in gap.missing.tolist()])


def _deviation(
    machine: FilledMachine, gap: Gap, missed: Floats, deviation: Floats, velocity: Floats, there: Flags, wrong: float
) -> tuple[Steps, NDArray[np.intp]]:
    """Return the smoothed deviation (n,) [counts] of the measured motion from the simulated motion, and its events.

    Events are gaps, reversals and, for wrong parameters, one sample in every `machine.often`. `missed` (g,) is the
    standard deviation of the sum of the input over each gap. `wrong` is the error of the model at each event, relative
    to the velocity.
    """
    turns = np.flatnonzero(np.diff(np.sign(velocity))) + 1
    often = np.arange(0, deviation.size, machine.often)
    events = np.unique(np.concatenate([often, gap.after, turns]))
    at = np.searchsorted(events, gap.after)
    steps = np.full(events.size, max((wrong * rms(velocity)) ** 2, np.finfo(float).tiny))
    moves = np.full(events.size, TUNING.filling_shift**2)
    steps[at] += (machine.push * missed) ** 2
    moves[at] += steps[at] * (gap.missing * machine.dt) ** 2 / 4
    return smooth_deviation(deviation, there, events, steps, moves, machine.decay, machine.dt), events


def _decide(machine: FilledMachine, gap: Gap, u: Floats, steps: Floats, variance: Floats) -> None:
    """Set the input (n,) in gaps that hide a change.

    The steps (g,) of the velocity that the present input does not explain determine the instant of the change. An
    uncertain instant lies between two samples.
    """
    before, change = u[gap.before], u[gap.after] - u[gap.before]
    total = np.r_[0.0, np.cumsum(u)]
    inside = total[gap.after] - total[gap.before + 1] + steps / machine.push
    # `later` counts the samples after the change.
    later = np.clip((inside - gap.missing * before) / change, 0.0, gap.missing)
    known = np.sqrt(variance) < TUNING.filling_known * np.abs(machine.push * change)
    later = np.where(known, np.rint(later), later)
    whole = np.floor(later).astype(np.intp)
    for k in range(before.size):
        first, last, split = gap.before[k] + 1, gap.after[k], gap.after[k] - whole[k]
        u[first:split], u[split:last] = before[k], before[k] + change[k]
        if split > first:
            u[split - 1] += (later[k] - whole[k]) * change[k]

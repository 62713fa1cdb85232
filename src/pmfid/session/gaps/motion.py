"""Values for missing samples by the motion of the machine.

A held input that differs on the two sides of a gap has changed within it. The motion after the gap determines the
instant: a wrong one would leave a step between the simulated and the measured velocity. The counts are those of the
simulated motion, plus the smoothed deviation of the measured one. The model must be accurate only to the effect of one
sample of the input.

In a long gap, an input that is not held is interpolated (`local`). If the counts on both sides determine it better than
the interpolation, it is not known, and the motion restarts after the gap.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import NotIdentifiableError
from pmfid.estimators.bridges import Body
from pmfid.estimators.difference import rms
from pmfid.estimators.iv import IV
from pmfid.models.equation import MASS
from pmfid.session.gaps.local import best_of
from pmfid.session.gaps.smoother import Steps, smooth_deviation
from pmfid.session.gaps.standing import ALWAYS, Gap, fill_gaps, gaps_of, is_held
from pmfid.types import Counts, Flags, Floats

#: Most iterations of estimate and filling: the filled samples hardly change the estimate.
TURNS = 3
#: Relative change of the parameters below which the iteration ends.
SETTLED = 1e-4
#: Error of the velocity at an event by wrong parameters, as a part of the root mean square velocity: before and after
#: the inputs are found.
WRONG = (1e-2, 1e-3)
#: The same of the position [counts].
SHIFT = 0.1
#: Interval of further events, in filter time constants and in samples: a deviation is as smooth as the motion.
OFTEN, FEWEST = 2.0, 8
#: Seed of the samples that `doubt` removes.
AGAIN = 16
#: Largest standard deviation of a known instant [samples].
KNOWN = 0.25
#: Largest distance of the deviation in a gap from the line between its neighbours [counts].
WITHIN = 1.0


class FilledMachine(Body):
    """A model with its parameters, and the quantities of it that fill a gap."""

    def motion(self, u: Floats, speed: float) -> tuple[Floats, Floats]:
        """Position [counts] from 0 and velocity [counts/s], (n,), from a speed [counts/s] on."""
        velocity = self.speeds(u, speed)[0]
        return np.r_[0.0, np.cumsum(velocity[:-1])] * self.dt, velocity

    @property
    def often(self) -> int:
        """Samples in which a wrong parameter changes the deviation of the velocity little."""
        return max(FEWEST, round(OFTEN / (self.cutoff * self.dt)))

    @property
    def push(self) -> float:
        """Change of the velocity by one sample of a unit input [counts/s]."""
        return self.equation.input_gain * self.dt / self.values[MASS] / self.step


def fill_by_motion(method: IV, u: Floats, counts: Counts, there: Flags) -> tuple[Floats, Counts] | None:
    """Input and counts (n,) with missing samples filled by the motion. The present values are those of `fill_gaps`. An
    input that is NaN stays NaN, and becomes NaN if the motion determines it better. None if the record identifies no
    motion."""
    line, own, held = (u, counts), np.flatnonzero(np.isfinite(u)), is_held(u, there)
    parts = np.split(own, np.flatnonzero(np.diff(own) > 1) + 1)
    try:
        theta = method.settle_iteration(u, counts)[1]
        for _ in range(TURNS):
            machine = FilledMachine(method.equation, theta, method.dt, method.encoder.resolution, method.cutoff)
            u, counts = line[0].copy(), line[1].copy()
            for part in parts:
                if not np.all(there[part]):
                    u[part], counts[part] = _fill_part(machine, line[0][part], line[1][part], there[part], held)
            before, theta = theta, method.settle_iteration(u, counts)[1]
            if np.max(np.abs(theta - before) / np.maximum(np.abs(theta), np.finfo(float).tiny)) < SETTLED:
                break
    except (NotIdentifiableError, np.linalg.LinAlgError):
        return None
    return u, counts


def doubt(method: IV, u: Floats, counts: Counts, there: Flags) -> Floats:
    """(p,): relative errors of the parameters by missing samples; 1 if too few samples remain.

    An equal part of the measured samples is removed and filled again. The change of the parameters estimates their
    error by the samples that are really missing.
    """
    chance, part = np.random.default_rng(AGAIN), 1 - float(np.mean(there[np.isfinite(u)]))
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


def _fill_part(machine: FilledMachine, u: Floats, counts: Counts, there: Flags, held: bool) -> tuple[Floats, Counts]:
    """Input and counts of one part (n,) with measured ends, filled; held: is the input held between changes?"""
    place, speed = counts - counts[0] + 0.5, 0.0
    gap = _doubtful(u, there, held)
    missed, none = _estimate_input_errors(gap, u, there, held), np.zeros(0, np.intp)
    u = u.copy()
    for wrong in WRONG:
        position, velocity = machine.motion(u, speed)
        found, events = _deviation(machine, gap, missed, place - position, velocity, there, wrong)
        speed += found.start
        at = np.searchsorted(events, gap.after)
        if held:
            _decide(machine, gap, u, found.size[at], found.variance[at])
    by_motion = found.variance[at] < (machine.push * missed) ** 2 / 2  # the counts know it better than interpolation
    if held:
        gap, missed = Gap(none, none), missed[:0]
    position, velocity = machine.motion(u, speed)
    deviation = place - position
    smooth = _deviation(machine, gap, missed, deviation, velocity, there, WRONG[-1])[0].deviation
    rows = np.flatnonzero(there)
    line = np.interp(np.arange(u.size), rows, deviation[rows])
    filled = np.floor(position + np.clip(smooth, line - WITHIN, line + WITHIN)).astype(np.int64) + counts[0]
    for k in none if held else np.flatnonzero(by_motion):
        u[gap.before[k] + 1 : gap.after[k]] = np.nan
    return u, np.where(there, counts, filled)


def _doubtful(u: Floats, there: Flags, held: bool) -> Gap:
    """The gaps in which the motion determines the input (n,): changes of a held input, and long gaps of any other."""
    gap = gaps_of(there)
    found = np.flatnonzero(u[gap.before] != u[gap.after] if held else gap.missing > ALWAYS)
    return Gap(gap.before[found], gap.after[found])


def _estimate_input_errors(gap: Gap, u: Floats, there: Flags, held: bool) -> Floats:
    """(g,) standard deviations of the sum of the input (n,) over each gap."""
    if held:
        return np.asarray(np.abs(u[gap.after] - u[gap.before]) * gap.missing / np.sqrt(12))
    if not gap.before.size:
        return np.zeros(0)
    places = np.flatnonzero(there)
    local = best_of(u[places], places)
    sizes = {length: local.estimate_error(u[places], places, length) for length in np.unique(gap.missing).tolist()}
    return np.array([sizes[length] for length in gap.missing.tolist()])


def _deviation(
    machine: FilledMachine, gap: Gap, missed: Floats, deviation: Floats, velocity: Floats, there: Flags, wrong: float
) -> tuple[Steps, NDArray[np.intp]]:
    """The smoothed deviation (n,) [counts] of the measured motion from the simulated one, and its events.

    Events are gaps, reversals and, for wrong parameters, one sample in every `machine.often`. missed: (g,) standard
    deviation of the sum of the input over each gap; wrong: error of the model at each event, as a part of the velocity.
    """
    turns = np.flatnonzero(np.diff(np.sign(velocity))) + 1
    often = np.arange(0, deviation.size, machine.often)
    events = np.unique(np.concatenate([often, gap.after, turns]))
    at = np.searchsorted(events, gap.after)
    steps = np.full(events.size, max((wrong * rms(velocity)) ** 2, np.finfo(float).tiny))
    moves = np.full(events.size, SHIFT**2)
    steps[at] += (machine.push * missed) ** 2
    moves[at] += steps[at] * (gap.missing * machine.dt) ** 2 / 4
    return smooth_deviation(deviation, there, events, steps, moves, machine.decay, machine.dt), events


def _decide(machine: FilledMachine, gap: Gap, u: Floats, steps: Floats, variance: Floats) -> None:
    """Sets the input (n,) in gaps that hide a change. The steps (g,) of the velocity beyond those of the present input
    determine the instant; an instant that is not known stays between two samples."""
    before, change = u[gap.before], u[gap.after] - u[gap.before]
    total = np.r_[0.0, np.cumsum(u)]
    inside = total[gap.after] - total[gap.before + 1] + steps / machine.push
    later = np.clip((inside - gap.missing * before) / change, 0.0, gap.missing)  # samples after the change
    known = np.sqrt(variance) < KNOWN * np.abs(machine.push * change)
    later = np.where(known, np.rint(later), later)
    whole = np.floor(later).astype(np.intp)
    for k in range(before.size):
        first, last, split = gap.before[k] + 1, gap.after[k], gap.after[k] - whole[k]
        u[first:split], u[split:last] = before[k], before[k] + change[k]
        if split > first:
            u[split - 1] += (later[k] - whole[k]) * change[k]

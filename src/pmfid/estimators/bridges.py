"""Gaps in a record, in which neither input nor motion is known, filled with a motion of the model.

An input that is not a number marks a gap. The simulated motion restarts after the gap, with the speed of the counts
there. Simulation and filters go on through the gap: its input takes the simulated motion from the last position before
the gap to the first position after it. The counts of the gap are those of this motion. The equation holds exactly for
them at every theta, so they carry no information.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pmfid.estimators.motion import Intervals, first_speed, simulate_motion, sum_travel
from pmfid.estimators.tuning import TUNING
from pmfid.models.equation import (
    COULOMB_BACKWARD,
    COULOMB_FORWARD,
    MASS,
    OFFSET,
    VISCOUS_BACKWARD,
    VISCOUS_FORWARD,
    Equation,
)
from pmfid.types import Counts, Flags, Floats


@dataclass(frozen=True)
class Body:
    """An equation at theta (p,), sampled every dt [s]; step: of the encoder [unit of y]; cutoff: of the filters
    [rad/s]; uneven: (n,) time from each sample to the next [s], None: dt."""

    equation: Equation
    theta: Floats
    dt: float
    step: float
    cutoff: float
    uneven: Floats | None = None

    def speeds(self, u: Floats, start: float) -> tuple[Floats, float]:
        """Mean speed (n,) under u (n,), from a start, and the speed at the end [counts/s]."""
        mean, end = simulate_motion(self.equation, self.theta, self.intervals, u, start * self.step)
        return mean / self.step, end / self.step

    @property
    def intervals(self) -> Intervals:
        """dt, or (n,) the time from each sample to the next [s]."""
        return self.dt if self.uneven is None else self.uneven

    def part(self, part: slice) -> Body:
        """The same for a part of the samples."""
        return self if self.uneven is None else replace(self, uneven=self.uneven[part])

    @property
    def decay(self) -> float:
        """The decay rate of a deviation of the speed [1/s]."""
        values = self.values
        return max(0.0, (values[VISCOUS_FORWARD] + values[VISCOUS_BACKWARD]) / 2 / values[MASS])

    @property
    def least(self) -> int:
        """Samples of the shortest part whose speed can be read."""
        return max(TUNING.bridges_fewest, int(1 / (self.cutoff * self.dt)))

    @property
    def reading(self) -> int:
        """Samples in which the speed after a gap is read."""
        return max(
            self.least, int(TUNING.bridges_read / (min(self.cutoff, max(self.decay, 0.1 * self.cutoff)) * self.dt))
        )

    @cached_property
    def values(self) -> list[float]:
        known = self.equation.known_at(np.asarray(self.theta)[len(self.equation.names) :])
        return list(known.role_values(self.theta))


def parts_of(u: Floats, least: int = 1) -> list[slice]:
    """The parts of a record between gaps, in which the input (n,) is a number. A part with fewer than `least` samples
    gives no speed and belongs to the gap."""
    known = np.flatnonzero(np.isfinite(u))
    if known.size == 0:
        return []
    breaks = np.flatnonzero(np.diff(known) > 1)
    firsts, lasts = np.r_[known[0], known[breaks + 1]], np.r_[known[breaks], known[-1]]
    return [slice(int(a), int(b) + 1) for a, b in zip(firsts, lasts, strict=True) if b - a + 1 >= least]


def gaps_in(u: Floats) -> tuple[tuple[int, int], ...]:
    """The gaps of a record: the first sample of each whose input (n,) is no number, and the first one after it."""
    parts = parts_of(u)
    edges = [0, *(edge for part in parts for edge in (part.start, part.stop)), u.size]
    return tuple((a, b) for a, b in zip(edges[0::2], edges[1::2], strict=True) if b > a) if parts else ()


def bridge_gaps(body: Body, u: Floats, counts: Counts) -> tuple[Floats, Counts, Flags]:
    """A record u, counts: (n,) with filled gaps, and flags (n,) of the samples outside gaps."""
    parts, there = parts_of(u, body.least), np.zeros(u.size, bool)
    for part in parts:
        there[part] = True
    filled, whole = np.where(there, u, 0.0), counts.copy()
    starts = [read_start_speed(body.part(part), u[part], counts[part]) for part in parts]
    for before, part, start, target in zip(parts[:-1], parts[1:], starts[:-1], starts[1:], strict=True):
        gap = slice(before.stop, part.start)
        mean, end = body.part(before).speeds(u[before], start)
        last = float(mean[-1]) * _last(body.part(before).intervals)  # from the last count to where the gap begins
        moved_by = int(counts[part.start] - counts[gap.start - 1]) - last
        filled[gap], travel = _across(_even(body.part(gap)), gap.stop - gap.start, end, target, moved_by)
        tilt = (moved_by - travel[-1]) / travel.size
        places = last + np.r_[0.0, travel[:-1]] + tilt * np.arange(travel.size)
        whole[gap] = counts[gap.start - 1] + np.rint(places).astype(np.int64)
    return filled, whole, there


def _last(intervals: Intervals) -> float:
    return float(intervals[-1]) if isinstance(intervals, np.ndarray) else intervals


def _even(body: Body) -> Body:
    """In a gap, whose rows are even."""
    return body if body.uneven is None else replace(body, dt=float(np.mean(body.uneven)), uneven=None)


def read_start_speed(body: Body, u: Floats, counts: Counts) -> float:
    """The speed [counts/s] at the start of the motion under u (n,), fitted to the counts (n,)."""
    near = min(u.size, body.reading)
    place, time = (
        (counts[:near] - counts[0]).astype(np.float64),
        sum_travel(np.ones(near), body.part(slice(near)).intervals),
    )
    response = -np.expm1(-body.decay * time) / body.decay if body.decay * time[-1] > TUNING.bridges_little else time
    around = response - np.mean(response)
    body = body.part(slice(near))
    speed = first_speed(place, body.intervals, body.cutoff, 1.0)
    for _ in range(TUNING.bridges_turns):
        travel = sum_travel(body.speeds(u[:near], speed)[0], body.intervals)
        step = float((place - travel) @ around / (around @ around))
        speed += step
        if abs(step) < TUNING.bridges_close * abs(speed):
            break
    return speed


def _across(body: Body, samples: int, start: float, target: float, distance: float) -> tuple[Floats, Floats]:
    """The input (samples,) that takes the motion from a speed to another [counts/s] over a distance [counts], by way of
    speeds on a parabola, and its travel [counts] to the end of every sample."""
    at, time = np.arange(samples + 1) / samples, samples * body.dt
    hill = 6 * at * (1 - at) / time  # of unit distance
    line = start + (target - start) * at
    missing = distance - (start + target) / 2 * time
    for _ in range(TUNING.bridges_turns):
        u = _input_for(body, _insert_rests(line + missing * hill))
        travel = np.cumsum(body.speeds(u, start)[0]) * body.dt
        missing += distance - travel[-1]
        if abs(distance - travel[-1]) < TUNING.bridges_close * (abs(distance) + 1.0):
            break
    return u, travel


def _insert_rests(speeds: Floats) -> Floats:
    """Speeds (m + 1,) that turn where they are zero, and not between two samples."""
    turning = np.flatnonzero(speeds[1:-2] * speeds[2:-1] < 0) + 1
    nearer = turning + (np.abs(speeds[turning + 1]) < np.abs(speeds[turning]))
    speeds = speeds.copy()
    speeds[nearer] = 0.0
    return speeds


def _input_for(body: Body, speeds: Floats) -> Floats:
    """The input (m,) under which the motion has these speeds (m + 1,) [counts/s] at the samples."""
    values = body.values
    mass, offset = values[MASS], values[OFFSET]
    first, last = speeds[:-1] * body.step, speeds[1:] * body.step
    side = np.sign(first + last)
    viscous = np.where(side < 0, values[VISCOUS_BACKWARD], values[VISCOUS_FORWARD])
    coulomb = np.where(side < 0, values[COULOMB_BACKWARD], values[COULOMB_FORWARD])
    lost = -np.expm1(-viscous / mass * body.dt)
    held = np.where(
        lost > TUNING.bridges_little, viscous / np.where(lost > TUNING.bridges_little, lost, 1.0), mass / body.dt
    )
    force = held * (last - first) + viscous * first
    return np.asarray((force + side * coulomb + offset) / body.equation.input_gain)

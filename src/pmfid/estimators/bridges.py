"""Bridges over gaps: a simulated motion in place of the unknown motion in each gap of a record.

An input that is not a number marks a gap. The simulated motion restarts after the gap, with the speed of the counts
there. Simulation and filters continue through the gap. The input of the gap takes the simulated motion from the last
position before the gap to the first position after it, and the counts of the gap are those of this motion. The equation
holds exactly in the gap for every theta, so that the gap carries no information.
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
    """An equation at theta (p,), sampled every `dt` [s].

    `step` is the encoder's step [unit of y], and `cutoff` the pole of the filters [rad/s]. `uneven` (n,) is the time
    from each sample to the next [s]; None means `dt`.
    """

    equation: Equation
    theta: Floats
    dt: float
    step: float
    cutoff: float
    uneven: Floats | None = None

    def speeds(self, u: Floats, start: float) -> tuple[Floats, float]:
        """Return the mean speed (n,) in every sample and the speed at the end [counts/s].

        `u` (n,) is the input, and `start` the speed at the first sample [counts/s].
        """
        mean, end = simulate_motion(self.equation, self.theta, self.intervals, u, start * self.step)
        return mean / self.step, end / self.step

    @property
    def intervals(self) -> Intervals:
        """Sample period dt, or the time from each sample to the next (n,) [s]."""
        return self.dt if self.uneven is None else self.uneven

    def part(self, part: slice) -> Body:
        """Return the body for a part of the samples."""
        return self if self.uneven is None else replace(self, uneven=self.uneven[part])

    @property
    def decay(self) -> float:
        """Decay rate of a deviation of the speed [1/s]."""
        values = self.values
        return max(0.0, (values[VISCOUS_FORWARD] + values[VISCOUS_BACKWARD]) / 2 / values[MASS])

    @property
    def least(self) -> int:
        """Number of samples in the shortest part that determines a speed."""
        return max(TUNING.bridges_fewest, int(1 / (self.cutoff * self.dt)))

    @property
    def reading(self) -> int:
        """Number of samples that determine the speed after a gap."""
        return max(
            self.least, int(TUNING.bridges_read / (min(self.cutoff, max(self.decay, 0.1 * self.cutoff)) * self.dt))
        )

    @cached_property
    def values(self) -> list[float]:
        known = self.equation.known_at(np.asarray(self.theta)[len(self.equation.names) :])
        return list(known.role_values(self.theta))


def parts_of(u: Floats, least: int = 1) -> list[slice]:
    """Return the parts of a record between gaps, in which the input (n,) is a number.

    A part with fewer than `least` samples determines no speed and belongs to the gap.
    """
    there = np.isfinite(u)
    if np.all(there):
        return [slice(0, u.size)] if u.size >= max(least, 1) else []
    known = np.flatnonzero(there)
    if known.size == 0:
        return []
    breaks = np.flatnonzero(np.diff(known) > 1)
    firsts, lasts = np.r_[known[0], known[breaks + 1]], np.r_[known[breaks], known[-1]]
    return [slice(int(a), int(b) + 1) for a, b in zip(firsts, lasts, strict=True) if b - a + 1 >= least]


def gaps_in(u: Floats) -> tuple[tuple[int, int], ...]:
    """Return the gaps of a record, each as its first sample and the first sample after it. In a gap, the input (n,)
    is not a number.
    """
    parts = parts_of(u)
    edges = [0, *(edge for part in parts for edge in (part.start, part.stop)), u.size]
    return tuple((a, b) for a, b in zip(edges[0::2], edges[1::2], strict=True) if b > a) if parts else ()


def bridge_gaps(body: Body, u: Floats, counts: Counts) -> tuple[Floats, Counts, Flags]:
    """Return the record u, counts: (n,) with filled gaps, and flags (n,) of the samples outside gaps."""
    parts, there = parts_of(u, body.least), np.zeros(u.size, bool)
    for part in parts:
        there[part] = True
    filled, whole = np.where(there, u, 0.0), counts.copy()
    starts = [read_start_speed(body.part(part), u[part], counts[part]) for part in parts]
    for before, part, start, target in zip(parts[:-1], parts[1:], starts[:-1], starts[1:], strict=True):
        gap = slice(before.stop, part.start)
        mean, end = body.part(before).speeds(u[before], start)
        # distance from the last count to the beginning of the gap
        last = float(mean[-1]) * _last(body.part(before).intervals)
        moved_by = int(counts[part.start] - counts[gap.start - 1]) - last
        filled[gap], travel = _across(_even(body.part(gap)), gap.stop - gap.start, end, target, moved_by)
        tilt = (moved_by - travel[-1]) / travel.size
        places = last + np.r_[0.0, travel[:-1]] + tilt * np.arange(travel.size)
        whole[gap] = counts[gap.start - 1] + np.rint(places).astype(np.int64)
    return filled, whole, there


def _last(intervals: Intervals) -> float:
    return float(intervals[-1]) if isinstance(intervals, np.ndarray) else intervals


def _even(body: Body) -> Body:
    """Return the body with an even step, for a gap, whose rows are even."""
    return body if body.uneven is None else replace(body, dt=float(np.mean(body.uneven)), uneven=None)


def read_start_speed(body: Body, u: Floats, counts: Counts) -> float:
    """Return the speed [counts/s] at the start of the motion under u (n,), fitted to the counts (n,)."""
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
    """Return the input (samples,) of a motion between two speeds [counts/s] over a distance [counts], and its travel
    [counts] to each sample's end.

    The speeds of the motion lie on a parabola.
    """
    at, time = np.arange(samples + 1) / samples, samples * body.dt
    hill = 6 * at * (1 - at) / time  # parabola with an area of 1
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
    """Return the speeds (m + 1,) with zeros at reversals, so that no reversal lies between two samples."""
    turning = np.flatnonzero(speeds[1:-2] * speeds[2:-1] < 0) + 1
    nearer = turning + (np.abs(speeds[turning + 1]) < np.abs(speeds[turning]))
    speeds = speeds.copy()
    speeds[nearer] = 0.0
    return speeds


def _input_for(body: Body, speeds: Floats) -> Floats:
    """Return the input (m,) that causes the speeds (m + 1,) [counts/s] at the samples."""
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

"""What engineers drive an axis with: velocity profiles and input signals, as wishes that the limits may still bend."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pmfid.design.problem.problem import Problem
from pmfid.types import Floats

__all__ = ["RISES", "SIGNALS", "Leg", "input_wish", "legs", "velocity_wish"]

#: Velocity profile -> parts of a leg's time in which the velocity rises, and as much in which it falls, the usual one
#: first; None: the curve of least jerk.
RISES: dict[str, tuple[float | None, ...]] = {
    "trapezoid": (1 / 3, 0.4, 0.25, 0.5, 0.15, 0.1),
    "s_curve": (None,),
}
SIGNALS = ("pulses", "prbs", "multisine", "chirp")
#: Periods of the pulses in the whole motion, intervals for which a value of the PRBS is held.
PULSES, CLOCK = 4, 3
#: The highest frequency of multisine and chirp, as a part of the rate of the intervals.
HIGHEST = 0.2


@dataclass(frozen=True)
class Leg:
    """A part of the motion in one direction (1 or -1), from node first to node last; free: its end is."""

    first: int
    last: int
    direction: int
    free: bool


def legs(problem: Problem) -> list[Leg]:
    """The legs of the motion. Only the end of the last one may be given."""
    edges = [int(edge) for edge in np.flatnonzero(np.diff(np.r_[9, problem.sense, 9]))]
    moving = [(a, b) for a, b in pairwise(edges) if problem.sense[a]]
    last = moving[-1][1] if moving and problem.end[0] is not None else None
    return [Leg(a, b, problem.sense[a], b != last) for a, b in moving]


def velocity_wish(problem: Problem, leg: Leg, rise: float | None, peak: float) -> Floats:
    """Velocities at the leg's nodes [m/s], (last - first + 1,).

    A trapezoid that rises during the part `rise` of the time; None: the curve of least jerk (Flash and Hogan 1985).
    peak >= 0: [m/s], on top of the line between the velocities of start and end; inside never below the least speed.
    """
    tau = np.linspace(0.0, 1.0, leg.last - leg.first + 1)
    shape = 16 * (tau * (1 - tau)) ** 2 if rise is None else np.minimum(1.0, np.minimum(tau, 1 - tau) / rise)
    begin = leg.direction * problem.start[1] if leg.first == 0 else 0.0
    end = leg.direction * (problem.end[1] or 0.0) if leg.last == problem.intervals else 0.0
    speed = begin + (end - begin) * tau + peak * shape
    inside = slice(1, None if leg.last == problem.intervals and problem.end[1] is None else -1)
    speed[inside] = np.maximum(speed[inside], problem.limits.min_speed)
    return np.asarray(leg.direction * speed)


def input_wish(problem: Problem, name: str, low: float, high: float, rng: np.random.Generator) -> Floats:
    """Inputs (n,) between low and high: pulses, prbs, multisine (phases of Schroeder 1970) or chirp."""
    n = problem.intervals
    middle, size = (high + low) / 2, (high - low) / 2
    if name == "pulses":
        signal = np.where((np.arange(n) * 2 * PULSES // n) % 2 == 0, 1.0, -1.0)
    elif name == "prbs":
        signal = np.repeat(rng.integers(0, 2, size=-(-n // CLOCK)) * 2.0 - 1.0, CLOCK)[:n]
    elif name == "multisine":
        signal = _multisine(n, max(1, int(HIGHEST * n)))
    else:
        tau = np.arange(n) / n
        signal = np.cos(2 * np.pi * tau * (1 + (HIGHEST * n - 1) * tau / 2))
    return np.asarray(middle + size * signal)


def _multisine(samples: int, tones: int) -> Floats:
    """Tones 1 to `tones` per period (samples,), largest value 1; the crest factor is about 1.7 for many tones."""
    k = np.arange(1, tones + 1)
    phase = -np.pi * k * (k - 1) / tones
    total = np.cos(2 * np.pi * np.outer(np.arange(samples) / samples, k) + phase).sum(axis=1)
    return np.asarray(total / np.abs(total).max())

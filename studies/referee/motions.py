"""Seven motions: the input of five, and reference and controller of two. Times are in samples, inputs in 1."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from pmfid.types import Floats

Rng = np.random.Generator


@dataclass(frozen=True)
class Pace:
    """What a motion must know of its axis: mass and viscous friction (input 1, counts, samples), Coulomb friction as a
    part of the largest input, time constant, samples per level of the input, and counts per sample."""

    mass: float
    viscous: float
    coulomb: float
    time_constant: float
    clock: int
    speed: float


@dataclass(frozen=True)
class Command:
    """The input (n,) of an open loop, or the reference (n,) in counts with the gains of the controller."""

    feed: Floats
    reference: Floats
    kp: float = 0.0
    kd: float = 0.0
    window: int = 1


def open_loop(feed: Floats, rng: Rng) -> Command:
    """Scale an input to a largest value of 0.7 to 1."""
    return Command(feed * rng.uniform(0.7, 1.0) / np.max(np.abs(feed)), np.zeros(feed.size))


def prbs(n: int, pace: Pace, rng: Rng) -> Command:
    return open_loop(np.repeat(rng.choice([-1.0, 1.0], n // pace.clock + 1), pace.clock)[:n], rng)


def levels(n: int, pace: Pace, rng: Rng) -> Command:
    holds = rng.integers(pace.clock, 3 * pace.clock + 1, n // pace.clock + 1)
    return open_loop(np.repeat(rng.uniform(-1, 1, holds.size), holds)[:n], rng)


def multisine(n: int, pace: Pace, rng: Rng) -> Command:
    tones = np.geomspace(0.05, 0.4, 10) / pace.clock
    phases = rng.uniform(0, 2 * np.pi, tones.size)
    return open_loop(np.sin(2 * np.pi * np.outer(np.arange(n), tones) + phases).sum(axis=1), rng)


def chirp(n: int, pace: Pace, rng: Rng) -> Command:
    first, last = 0.05 / pace.clock, 0.35 / pace.clock
    k = np.arange(n)
    return open_loop(np.sin(2 * np.pi * (first * k + 0.5 * (last - first) * k * k / n)), rng)


def trapezoids(n: int, pace: Pace, rng: Rng) -> Command:
    """Ramp up, hold, ramp down and rest, with alternating sign and random height."""
    c = pace.clock
    ramp = np.arange(1, c + 1) / c
    pulse = np.r_[ramp, np.ones(2 * c), 1 - ramp, np.zeros(c)]
    heights = rng.uniform(0.5, 1.0, n // pulse.size + 1) * np.resize([1.0, -1.0], n // pulse.size + 1)
    return open_loop(np.outer(heights, pulse).ravel()[:n], rng)


def stop_and_go(n: int, pace: Pace, rng: Rng) -> Command:
    """Moves to and fro, with rests, under PD control."""
    return _moves(n, pace, rng, lambda count: np.resize([1.0, 0.0], count), damped=True)


def point_to_point(n: int, pace: Pace, rng: Rng) -> Command:
    """Moves to random positions under PD control, or P control if friction damps the axis enough."""
    damped = pace.time_constant > 60 or rng.random() < 0.5
    return _moves(n, pace, rng, lambda count: rng.uniform(-1.5, 1.5, count), damped)


def _moves(n: int, pace: Pace, rng: Rng, targets: Callable[[int], Floats], damped: bool) -> Command:
    """One count of noise moves the input of the controller by at most 0.2; its bandwidth follows from that."""
    bandwidth = min(0.15, (0.07 / pace.mass) ** 0.5) if damped else 0.8 / pace.time_constant
    kp, kd = pace.mass * bandwidth**2, max(0.0, 1.4 * pace.mass * bandwidth - pace.viscous)
    time = int(max(2 * pace.clock, 5 / bandwidth))
    rest = int(time * rng.uniform(0.3, 1.0))
    stroke = max(rng.uniform(0.15, 0.3) * pace.speed * time, 3 * pace.coulomb / kp)
    ends = stroke * np.r_[0.0, targets(n // (time + rest) + 1)]
    rise = np.r_[0.5 - 0.5 * np.cos(np.pi * np.arange(1, time + 1) / time), np.ones(rest)]
    reference = (ends[:-1, None] + np.outer(np.diff(ends), rise)).ravel()[:n]
    return Command(np.zeros(n), reference, kp, kd if damped else 0.0, max(1, int(0.5 / bandwidth)))


MOTIONS: Mapping[str, Callable[[int, Pace, Rng], Command]] = MappingProxyType(
    {
        "prbs": prbs,
        "levels": levels,
        "multisine": multisine,
        "chirp": chirp,
        "trapezoids": trapezoids,
        "stop-and-go": stop_and_go,
        "point-to-point": point_to_point,
    }
)

"""Random machines: a design without dimensions, an unmodelled effect, and the scale in SI units.

Units of a design: one count, one sample, and the largest input.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from pmfid.types import Floats
from studies.referee.motions import MOTIONS, Command, Pace, Rng

SAMPLES = (2000, 4000)
WARM_UP = 200


@dataclass(frozen=True)
class Scale:
    """The size of a machine: mass [kg or kg m2], sample period [s], travel per turn [m or rad], and largest input."""

    mass: float
    dt: float
    turn: float
    top: float
    rotary: bool


@dataclass(frozen=True)
class Machine:
    """A machine, its motion, and its log. `effect` has fields of the simulated axis, (n,) for push and friction.

    The log starts after `first` samples. The encoder starts at the part `zero` of a count. `step` (n,) is the time
    between samples, and `missing` (n,) are lost counts.
    """

    kind: str
    motion: str
    index: int
    pace: Pace
    increments: int
    scale: Scale
    command: Command
    first: int
    zero: float
    step: Floats
    missing: np.ndarray[tuple[int], np.dtype[np.bool_]]
    effect: Mapping[str, float | Floats]


def log_uniform(rng: Rng, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def draw_scale(rng: Rng, increments: int, speed: float, dt: float, rotary: bool) -> Scale:
    """Draw the size of a machine. A linear axis moves by at most 3 m/s."""
    top = float(rng.choice([1.0, 10.0, 24.0, 300.0]))
    if rotary:
        return Scale(log_uniform(rng, 1e-5, 10.0), dt, 2 * np.pi, top, True)
    return Scale(
        log_uniform(rng, 0.1, 500.0), dt, min(log_uniform(rng, 0.002, 0.3), 3 * dt * increments / speed), top, False
    )


def draw_pace(rng: Rng, increments: int, dt: float) -> Pace:
    """Draw time constant (4 ms to 1 s), friction (3 to 35 % of the largest input) and speed (0.1 to 60 turns/s)."""
    time_constant = log_uniform(rng, max(4.0, 0.004 / dt), min(300.0, 1.0 / dt))
    clock = int(log_uniform(rng, max(3.0, min(0.5 * time_constant, 40.0)), min(max(2.0 * time_constant, 6.0), 100.0)))
    speed = log_uniform(rng, max(0.3, 0.1 * dt * increments), min(1000.0, 60 * dt * increments))
    coulomb = rng.uniform(0.03, 0.35)
    mass = (1 - coulomb) * time_constant * (1 - np.exp(-clock / time_constant)) / speed
    return Pace(mass, mass / time_constant, coulomb, time_constant, clock, speed)


def draw_machine(seed: int, kind: str, index: int) -> Machine:
    """Draw the machine `index` of a kind. The same arguments give the same machine."""
    rng = np.random.default_rng([seed, list(KINDS).index(kind), index])
    motion = list(MOTIONS)[index % len(MOTIONS)]
    increments, dt = 2 ** int(rng.integers(6, 17)), log_uniform(rng, 2e-4, 2e-2)
    pace = draw_pace(rng, increments, dt)
    rotary = bool(rng.random() < 0.5) or kind in ("gravity", "eccentric encoder")
    n, first = int(rng.integers(SAMPLES[0], SAMPLES[1] + 1)), int(rng.integers(0, WARM_UP) * rng.integers(0, 2))
    uneven = rng.random() < 0.2 and "dead time" not in kind
    step = 1 + uneven * 0.4 * rng.uniform(-1, 1, first + n)
    missing = np.zeros(n, bool)
    for start in rng.integers(1, n - 40, 8) if rng.random() < 0.2 else []:
        missing[start : start + rng.integers(1, 30)] = True
    command = MOTIONS[motion](first + n, pace, rng)
    scale = draw_scale(rng, increments, pace.speed, dt, rotary)
    effect = KINDS[kind](rng, pace, increments, first + n, dt)
    return Machine(kind, motion, index, pace, increments, scale, command, first, rng.random(), step, missing, effect)


Effect = Callable[[Rng, Pace, int, int, float], Mapping[str, float | Floats]]


def plain(name: str, low: float, high: float, factor: Callable[[Pace], float] = lambda pace: 1.0) -> Effect:
    """Return the effect of one field with a random size in units of `factor`."""
    return lambda rng, pace, *_: {name: rng.uniform(low, high) * factor(pace)}


def stribeck(size: float) -> Effect:
    return lambda rng, pace, *_: {
        "stribeck": size * pace.coulomb,
        "stribeck_speed": log_uniform(rng, 0.02, 0.3) * pace.speed,
    }


def gravity(rng: Rng, pace: Pace, increments: int, *_: float) -> dict[str, float]:
    return {"wave": rng.uniform(0.3, 1.5) * pace.coulomb, "period": float(increments), "phase": rng.uniform(0, 6.3)}


def cogging(rng: Rng, pace: Pace, increments: int, *_: float) -> dict[str, float]:
    pitch = max(2.0, increments / float(rng.integers(4, 61)))
    return {"wave": rng.uniform(0.05, 0.3) * pace.coulomb, "period": pitch, "phase": rng.uniform(0, 6.3)}


def asymmetry(rng: Rng, pace: Pace, *_: float) -> dict[str, float]:
    coulomb, viscous = rng.uniform(0.1, 0.3, 2) * rng.choice([-1, 1], 2)
    return {"coulomb_asymmetry": coulomb, "viscous_asymmetry": viscous}


def drift(rng: Rng, pace: Pace, increments: int, n: int, *_: float) -> dict[str, Floats]:
    """Coulomb friction falls while the axis warms up."""
    return {"friction": 1 + rng.uniform(0.2, 0.5) * np.exp(-np.arange(n) / (n * rng.uniform(0.15, 1.0)))}


def force_noise(rng: Rng, pace: Pace, increments: int, n: int, *_: float) -> dict[str, Floats]:
    """A random walk with a spring, 5 to 25 % of Coulomb friction."""
    keep, force, size = np.exp(-1 / log_uniform(rng, 3, 200)), np.zeros(n), rng.uniform(0.05, 0.25) * pace.coulomb
    shocks = size * np.sqrt(1 - keep**2) * rng.standard_normal(n)
    for k in range(1, n):
        force[k] = keep * force[k - 1] + shocks[k]
    return {"push": force}


def second_mass(rng: Rng, pace: Pace, load: float, frequency: float, ratio: float) -> dict[str, float]:
    """Split the mass, so that the resonance has `frequency` [rad/sample] and the damping `ratio`."""
    motor = pace.mass - load * pace.mass
    reduced = motor * load
    return {
        "mass": motor,
        "viscous": pace.viscous * (1 - load),
        "second_mass": load * pace.mass,
        "second_viscous": load * pace.viscous,
        "stiffness": reduced * frequency**2,
        "damping": 2 * ratio * frequency * reduced,
    }


def resonance(rng: Rng, pace: Pace, increments: int, n: int, dt: float) -> dict[str, float]:
    frequency = 2 * np.pi * log_uniform(rng, 10, 60) * dt
    return second_mass(rng, pace, rng.uniform(0.25, 0.75), frequency, rng.uniform(0.01, 0.1))


def backlash(rng: Rng, pace: Pace, *_: float) -> dict[str, float]:
    """Play of 1 to 10 % of a move; the contact rings with 6 rad/sample."""
    gap = log_uniform(rng, 0.01, 0.1) * pace.speed * pace.clock
    return second_mass(rng, pace, rng.uniform(0.2, 0.6), 6.0, 0.3) | {"gap": gap}


def eccentric(rng: Rng, pace: Pace, increments: int, *_: float) -> dict[str, float]:
    """The disc is off its axis by 0.05 to 1 % of a turn."""
    size = log_uniform(rng, 0.0005, 0.01) * increments
    return {"eccentricity": size, "turn": float(increments), "runout": rng.uniform(0, 6.3)}


RIGHT = "right"
KINDS: Mapping[str, Effect] = MappingProxyType(
    {
        RIGHT: lambda *_: {},
        "dead time 0.3": lambda *_: {"delay": 0.3},
        "dead time 1": lambda *_: {"delay": 1.0},
        "lag": plain("lag", 0.3, 2.0),
        "Stribeck 20 %": stribeck(0.2),
        "Stribeck 50 %": stribeck(0.5),
        "quadratic": plain("quadratic", 0.15, 0.5, lambda pace: pace.viscous / pace.speed),
        "load": plain("load", 0.1, 0.5, lambda pace: pace.coulomb),
        "gravity": gravity,
        "spring": plain("spring", 0.1, 1.0, lambda pace: pace.coulomb / (pace.speed * pace.clock)),
        "cogging": cogging,
        "dead zone": plain("dead_zone", 0.02, 0.08),
        "bending": plain("bending", 0.05, 0.2),
        "saturation": plain("limit", 0.5, 0.65),
        "asymmetry": asymmetry,
        "friction drift": drift,
        "force noise": force_noise,
        "backlash": backlash,
        "second mass": resonance,
        "eccentric encoder": eccentric,
    }
)

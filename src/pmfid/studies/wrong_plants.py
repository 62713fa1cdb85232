"""Plants that the drive's model does not describe, simulated by small fixed steps; not an exact solver of events.

Runge-Kutta of fourth order with ten steps per sample. A step on whose way the velocity changes its sign is cut where a
straight line through both velocities is zero, and goes on from rest. For the right model the tests hold the difference
to the exact simulation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from pmfid.simulation import CART, CART_DT, prbs, quantize, resolution_of, stop_and_go
from pmfid.studies.truth import Floats, Record

STEPS = 10
KP, KD, U_MAX = 200.0, 5.0, 6.0  # those of the scenario "stop-and-go"


@dataclass(frozen=True)
class Plant:
    """The cart, and what the model lacks.

    stribeck: friction at rest beyond Coulomb's [N], which falls with exp(-(v/stribeck_speed)^2), stribeck_speed [m/s];
    quadratic: [N s^2/m^2]; spring: [N/m], at rest at x = 0; gain: part of the input gain; delay: of the input as a part
    of dt, 0 to 1.
    """

    stribeck: float = 0.0
    stribeck_speed: float = 0.02
    quadratic: float = 0.0
    spring: float = 0.0
    gain: float = 1.0
    delay: float = 0.0

    def friction(self, speed: float) -> float:
        """Friction [N] at a speed >= 0 [m/s]."""
        extra = self.stribeck * math.exp(-((speed / self.stribeck_speed) ** 2)) if self.stribeck else 0.0
        return CART.coulomb_friction + extra + (CART.viscous_friction + self.quadratic * speed) * speed

    def step(self, x: float, v: float, force: float, h: float) -> tuple[float, float]:
        """x [m] and v [m/s] after h [s] under a constant motor force [N]."""
        drive = force - self.spring * x
        if v == 0.0 and abs(drive) <= self.friction(0.0):
            return x, 0.0
        way = math.copysign(1.0, v if v != 0.0 else drive)

        def acceleration(at: float, speed: float) -> float:
            return (force - self.spring * at - way * self.friction(max(way * speed, 0.0))) / CART.mass

        a1 = acceleration(x, v)
        a2 = acceleration(x + h / 2 * v, v + h / 2 * a1)
        a3 = acceleration(x + h / 2 * v + h**2 / 4 * a1, v + h / 2 * a2)
        a4 = acceleration(x + h * v + h**2 / 2 * a2, v + h * a3)
        v_new = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        if way * v_new <= 0.0:
            if v == 0.0:
                return x, 0.0
            part = v / (v - v_new)
            return self.step(x + part * h * v / 2, 0.0, force, (1 - part) * h)
        return x + h * v + h**2 / 6 * (a1 + a2 + a3), v_new

    def sample(self, x: float, v: float, before: float, now: float) -> tuple[float, float]:
        """x and v one sample later; the input before [V] acts for `delay` of it, then the one now."""
        h = CART_DT / STEPS
        for i in range(STEPS):
            u = before if i < round(self.delay * STEPS) else now
            x, v = self.step(x, v, self.gain * CART.input_gain * u, h)
        return x, v


#: What is wrong -> the plant; the first is right, so that the simulation itself can be judged.
PLANTS: Mapping[str, Plant] = MappingProxyType(
    {
        "nothing": Plant(),
        "Stribeck friction": Plant(stribeck=0.4),
        "quadratic friction": Plant(quadratic=6.4),
        "load spring": Plant(spring=5.0),
        "input gain": Plant(gain=1.1),
        "input delay": Plant(delay=0.5),
        "small input delay": Plant(delay=0.1),
    }
)
DESCRIPTIONS: Mapping[str, str] = MappingProxyType(
    {
        "nothing": "the right model in the same simulation",
        "Stribeck friction": "0.4 N more at rest (Coulomb: 0.8 N), gone by exp(-(v / 0.02 m/s)²)",
        "quadratic friction": "6.4 N s²/m² v |v| besides 12.8 N s/m: a fifth more at 0.4 m/s",
        "load spring": "5 N/m about the start",
        "input gain": "2.2 N/V where the model has 2: every parameter is 1/1.1 of the truth, -9.1 %",
        "input delay": "5 ms, half a sample",
        "small input delay": "1 ms, a tenth of a sample",
    }
)


def wrong_record(plant: Plant, scenario: str, seed: int, increments: int, samples: int = 3000) -> Record:
    """The scenario "prbs" or "stop-and-go" with another plant; the same random numbers in the same order."""
    rng = np.random.default_rng(seed)
    resolution = resolution_of(increments)
    phase = resolution * rng.random()
    if scenario == "prbs":
        u = prbs(samples, clock=10, amplitude=3.0, rng=rng)
        return Record(u, quantize(_open_loop(plant, u), resolution, phase), resolution)
    reference = stop_and_go(samples, CART_DT, stroke=0.2, move_time=0.8, dwell_time=0.5)
    return _closed_loop(plant, reference, resolution, phase)


def _open_loop(plant: Plant, u: Floats) -> Floats:
    x, v, before, positions = 0.0, 0.0, 0.0, []
    for now in u.tolist():
        positions.append(x)
        x, v = plant.sample(x, v, before, now)
        before = now
    return np.array(positions)


def _closed_loop(plant: Plant, reference: Floats, resolution: float, phase: float) -> Record:
    x, v, before, u, counts = 0.0, 0.0, 0.0, [], []
    for wanted in reference.tolist():
        counts.append(math.floor((x + phase) / resolution))
        change = counts[-1] - (counts[-2] if len(counts) > 1 else counts[-1])
        now = KP * (wanted - resolution * counts[-1]) - KD * resolution * change / CART_DT
        now = min(max(now, -U_MAX), U_MAX)
        u.append(now)
        x, v = plant.sample(x, v, before, now)
        before = now
    return Record(np.array(u), np.array(counts, dtype=np.int64), resolution)

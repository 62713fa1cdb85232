"""Servos simulated apart from the package: steps of 50 us for all servos at once, and a loop at 1 kHz on counts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pmfid.types import Floats

#: Step of the integration and period of the loop [s].
STEP = 5e-5
LOOP = 1e-3


@dataclass(frozen=True)
class TrueServo:
    """A servo under position commands, in SI units. `phase` in [0, 1) is that of the ticks of the loop."""

    inertia: float
    viscous: float
    coulomb: float
    kp: float
    delay: float
    resolution: float
    kd: float = 0.0
    gravity: float = 0.0
    torque_limit: float = 1e12
    stribeck: float = 0.0
    stribeck_speed: float = 1.0
    load_friction: float = 0.0
    phase: float = 0.0

    def find_delay(self, t: Floats, goal: Floats) -> float:
        """Return the mean time [s] from a command to the tick at which the command acts."""
        acts = t[1:][np.diff(goal) != 0] + self.delay
        return self.delay + float(np.mean(-(acts / LOOP + self.phase) % 1.0) * LOOP)


def simulate_servos(servos: Sequence[TrueServo], t: Floats, goals: Sequence[Floats]) -> list[Floats]:
    """Return the rounded positions (n,) [rad] of servos at the times t (n,) [s] under the goals (n,) [rad].

    Friction is implicit, and the viscous part of a step is exact.
    """
    own = {name: np.array([getattr(servo, name) for servo in servos]) for name in TrueServo.__dataclass_fields__}
    count, every = round(float(t[-1]) / STEP) + 1, round(LOOP / STEP)
    now = np.arange(count) * STEP
    rows = [np.searchsorted(t + servo.delay, now + 1e-9, side="right") - 1 for servo in servos]
    held = np.stack([goal[np.maximum(row, 0)] for goal, row in zip(goals, rows, strict=True)], axis=1)
    rate = np.maximum(own["viscous"] / own["inertia"] * STEP, 1e-12)
    left, gain = np.exp(-rate), -np.expm1(-rate) / rate * STEP / own["inertia"]
    first = np.round(own["phase"] * every).astype(int)
    x, v, torque, before = (np.zeros(len(servos)) for _ in range(4))
    out = np.empty((count, len(servos)))
    for k in range(count):
        out[k], tick = x, (k + first) % every == 0
        seen = own["resolution"] * np.rint(x / own["resolution"])
        wanted = own["kp"] * (held[k] - seen) - own["kd"] * (seen - before) / LOOP
        torque = np.where(tick, np.clip(wanted, -own["torque_limit"], own["torque_limit"]), torque)
        before = np.where(tick, seen, before)
        load = own["gravity"] * np.sin(x)
        force, transmitted = torque - load, np.abs(torque + load)  # the gearbox has the motor on one side
        friction = own["coulomb"] + own["load_friction"] * transmitted
        friction = friction + own["stribeck"] * np.exp(-np.abs(v) / own["stribeck_speed"])
        moved, stop = left * v + gain * force, gain * friction
        moved = np.where(np.abs(moved) > stop, moved - np.copysign(stop, moved), 0.0)
        x, v = x + 0.5 * STEP * (v + moved), moved
    return [
        servo.resolution * np.rint(np.interp(t, now, out[:, j]) / servo.resolution) for j, servo in enumerate(servos)
    ]

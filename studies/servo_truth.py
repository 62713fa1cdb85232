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
    """A servo under position commands, in SI units. `phase` in [0, 1) is that of the ticks of the loop.

    The gain `kd` acts on differences of the counts, `kd_true` on the true velocity, and `kd_filtered` on the
    differences after a lag of `velocity_filter`. The friction `load_stribeck` times the transmitted torque falls off
    with the square of the velocity over `stribeck_speed`.

    The last seven are effects that the package's model does not have. `asymmetry` is a part of the viscous friction,
    `ripple` a part of the Coulomb friction that turns with the position `waves` times a turn, and `cogging` a torque
    that does so. `root` is a friction at 1 rad/s that grows with the root of the speed. A friction with `bristle` needs
    this way [rad] to turn round. The encoder has `backlash` [rad].
    """

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
    kd_true: float = 0.0
    kd_filtered: float = 0.0
    velocity_filter: float = 1e-3
    ki: float = 0.0
    load_stribeck: float = 0.0
    asymmetry: float = 0.0
    ripple: float = 0.0
    cogging: float = 0.0
    waves: float = 1.0
    root: float = 0.0
    bristle: float = 0.0
    backlash: float = 0.0

    def find_delay(self, t: Floats, goal: Floats) -> float:
        """Return the mean time [s] from a command to the tick at which the command acts."""
        every = round(LOOP / STEP)
        acts = t[1:][np.diff(goal) != 0] + self.delay + round(self.phase * every) / every * LOOP
        return self.delay + float(np.mean(-(acts - 1e-9) / LOOP % 1.0) * LOOP)


def simulate_servos(servos: Sequence[TrueServo], t: Floats | Sequence[Floats], goals: Sequence[Floats]) -> list[Floats]:
    """Return the rounded positions (n,) [rad] of servos under the goals (n,) [rad] at the times t (n,) [s] of each.

    Friction is implicit, and the viscous part of a step is exact.
    """
    own = {name: np.array([getattr(servo, name) for servo in servos]) for name in TrueServo.__dataclass_fields__}
    clocks = [t] * len(servos) if isinstance(t, np.ndarray) else t
    count, every = round(max(float(clock[-1]) for clock in clocks) / STEP) + 1, round(LOOP / STEP)
    now = np.arange(count) * STEP
    held = np.empty((count // every + 2, len(servos)))
    for j, (servo, clock, goal) in enumerate(zip(servos, clocks, goals, strict=True)):
        ticks = (np.arange(len(held)) - round(servo.phase * every) / every) * LOOP
        rows = np.searchsorted(clock + servo.delay, ticks + 1e-9, side="right") - 1
        held[:, j] = goal[np.maximum(rows, 0)]
    rate = np.maximum(own["viscous"] / own["inertia"] * STEP, 1e-12)
    left, gain = np.exp(-rate), -np.expm1(-rate) / rate * STEP / own["inertia"]
    first = np.round(own["phase"] * every).astype(int)
    x, v, torque, before, shown, slip, slow, total = (np.zeros(len(servos)) for _ in range(8))
    share = -np.expm1(-LOOP / own["velocity_filter"])
    soft, bristle, play = own["bristle"] > 0, np.maximum(own["bristle"], 1e-12), 0.5 * own["backlash"]
    out, columns = np.empty((count, len(servos)), np.float32), np.arange(len(servos))
    for k in range(count):
        shown, tick = np.clip(shown, x - play, x + play), (k + first) % every == 0
        out[k] = shown
        seen = own["resolution"] * np.rint(shown / own["resolution"])
        apart, change = held[(k + first) // every, columns] - seen, (seen - before) / LOOP
        slow, total = np.where(tick, slow + share * (change - slow), slow), np.where(tick, total + LOOP * apart, total)
        wanted = own["kp"] * apart + own["ki"] * total - own["kd"] * change
        wanted = wanted - own["kd_true"] * v - own["kd_filtered"] * slow
        torque = np.where(tick, np.clip(wanted, -own["torque_limit"], own["torque_limit"]), torque)
        before, wave, speed = np.where(tick, seen, before), np.sin(own["waves"] * x), np.abs(v)
        load = own["gravity"] * np.sin(x)
        transmitted = np.abs(torque + load)  # the gearbox has the motor on one side
        dry = own["coulomb"] * (1 + own["ripple"] * wave)
        force = torque - load - own["cogging"] * wave - own["asymmetry"] * own["viscous"] * speed
        force = force - np.where(soft, dry * slip / bristle, 0.0)
        friction = np.where(soft, 0.0, dry) + own["load_friction"] * transmitted + own["root"] * np.sqrt(speed)
        falling = np.exp(-np.square(speed / own["stribeck_speed"]))
        friction = friction + (own["stribeck"] + own["load_stribeck"] * transmitted) * falling
        moved, stop = left * v + gain * force, gain * friction
        moved = np.where(np.abs(moved) > stop, moved - np.copysign(stop, moved), 0.0)
        way = 0.5 * STEP * (v + moved)
        x, v, slip = x + way, moved, np.clip(slip + way, -bristle, bristle)
    return [
        servo.resolution * np.rint(np.interp(clock, now, out[:, j]) / servo.resolution)
        for j, (servo, clock) in enumerate(zip(servos, clocks, strict=True))
    ]

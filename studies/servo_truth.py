"""Servos simulated apart from the package: steps of 50 us for all servos at once, and a loop on counts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pmfid.types import Floats

#: Step of the integration [s].
STEP = 5e-5


@dataclass(frozen=True)
class TrueServo:
    """A servo under position commands, in SI units. `phase` in [0, 1) is that of the ticks of the loop.

    The gain `kd` acts on differences of the counts, `kd_true` on the true velocity, and `kd_filtered` on the
    differences after a lag of `velocity_filter`. The friction `load_stribeck` times the transmitted torque falls off
    with the square of the velocity over `stribeck_speed`. `motor_friction` and `motor_stribeck` are the same times the
    motor's torque, from which `back_emf` takes its part of the velocity beyond the limit. The limit of the torque falls
    to 0 at the speed `no_load` [rad/s].

    `cogging` is a torque that turns with the position `waves` times a turn. What follows is not in the table of terms.
    A friction with `bristle` needs this way [rad] to turn round, and the encoder has `backlash` [rad]. The motor loses
    `deadzone` [N m] of the torque. The Coulomb friction is larger by the part `warming` at first, for some 3 s. The
    goal moves at most at `slew` [rad/s]. The gain grows by the part `stiffening` at an error of 0.3 rad. A torque of
    0.3 kp for some 0.5 s weakens the motor by the part `sag`. The inertia turns with the position by the part `swing`.
    The shaft twists by `windup` [rad/(N m)] before the encoder. The loop has a `loop_period` [s] that nobody knows.
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
    cogging: float = 0.0
    waves: float = 1.0
    motor_friction: float = 0.0
    motor_stribeck: float = 0.0
    back_emf: float = 0.0
    bristle: float = 0.0
    backlash: float = 0.0
    deadzone: float = 0.0
    warming: float = 0.0
    slew: float = 1e9
    stiffening: float = 0.0
    no_load: float = 1e9
    sag: float = 0.0
    swing: float = 0.0
    windup: float = 0.0
    loop_period: float = 1e-3

    def find_delay(self, t: Floats, goal: Floats) -> float:
        """Return the mean time [s] from a command to the tick at which the command acts."""
        period, every = self.loop_period, round(self.loop_period / STEP)
        acts = t[1:][np.diff(goal) != 0] + self.delay + round(self.phase * every) / every * period
        return self.delay + float(np.mean(-(acts - 1e-9) / period % 1.0) * period)


def simulate_servos(
    servos: Sequence[TrueServo],
    t: Sequence[Floats],
    goals: Sequence[Floats],
    read: Sequence[Floats] | None = None,
) -> list[Floats]:
    """Return the rounded positions (n,) [rad] of servos under the goals (n,) [rad] at the times t (n,) [s] of each.

    `read` are the times (n,) [s] of the readings of each, if they differ from those of the goals.
    Friction is implicit, and the viscous part of a step is exact.
    """
    own = {name: np.array([getattr(servo, name) for servo in servos]) for name in TrueServo.__dataclass_fields__}
    read = t if read is None else read
    count = round(max(float(clock[-1]) for clock in (*t, *read)) / STEP) + 1
    now, period, columns = np.arange(count) * STEP, own["loop_period"], np.arange(len(servos))
    every = np.round(period / STEP).astype(int)
    first = np.round(own["phase"] * every).astype(int)
    held = np.empty((count // int(every.min()) + 2, len(servos)))
    for j, (servo, clock, goal) in enumerate(zip(servos, t, goals, strict=True)):
        ticks = (np.arange(len(held)) - round(servo.phase * every[j]) / every[j]) * servo.loop_period
        rows = np.searchsorted(clock + servo.delay, ticks + 1e-9, side="right") - 1
        held[:, j] = goal[np.maximum(rows, 0)]
    for row in range(1, len(held)):
        held[row] = np.clip(held[row], held[row - 1] - own["slew"] * period, held[row - 1] + own["slew"] * period)
    x, v, torque, before, shown, slip, slow, total, drawn = (np.zeros(len(servos)) for _ in range(9))
    share = -np.expm1(-period / own["velocity_filter"])
    soft, bristle, play = own["bristle"] > 0, np.maximum(own["bristle"], 1e-12), 0.5 * own["backlash"]
    out = np.empty((count, len(servos)), np.float32)
    for k in range(count):
        wound, tick = x - own["windup"] * torque, (k + first) % every == 0
        shown = np.clip(shown, wound - play, wound + play)
        out[k] = shown
        seen = own["resolution"] * np.rint(shown / own["resolution"])
        apart, change = held[(k + first) // every, columns] - seen, (seen - before) / period
        slow = np.where(tick, slow + share * (change - slow), slow)
        total = np.where(tick, total + period * apart, total)
        wanted = own["kp"] * apart * (1 + own["stiffening"] * np.square(apart / 0.3)) + own["ki"] * total
        wanted = wanted - own["kd"] * change - own["kd_true"] * v - own["kd_filtered"] * slow
        speed, inertia = np.abs(v), own["inertia"] * (1 + own["swing"] * np.cos(x))
        most = own["torque_limit"] * np.maximum(1 - speed / own["no_load"], 0.0)
        wanted = np.copysign(np.maximum(np.abs(wanted) - own["deadzone"], 0.0), wanted)
        torque = np.where(tick, np.clip(wanted, -most, most) / (1 + own["sag"] * drawn), torque)
        drawn = drawn + STEP / 0.5 * (np.abs(torque) / (0.3 * own["kp"]) - drawn)
        before, wave = np.where(tick, seen, before), np.sin(own["waves"] * x)
        load, motor = own["gravity"] * np.sin(x), torque - own["back_emf"] * v
        transmitted = np.abs(motor + load)  # the gearbox has the motor on one side
        dry = own["coulomb"] * (1 + own["warming"] * math.exp(-k * STEP / 3.0))
        force = motor - load - own["cogging"] * wave - np.where(soft, dry * slip / bristle, 0.0)
        force = force + 0.5 * own["inertia"] * own["swing"] * np.sin(x) * v * v
        friction = np.where(soft, 0.0, dry) + own["load_friction"] * transmitted
        falling = np.exp(-np.square(speed / own["stribeck_speed"]))
        friction = friction + (own["stribeck"] + own["load_stribeck"] * transmitted) * falling
        friction = friction + (own["motor_friction"] + own["motor_stribeck"] * falling) * np.abs(motor)
        rate = np.maximum(own["viscous"] / inertia * STEP, 1e-12)
        gain = -np.expm1(-rate) / rate * STEP / inertia
        moved, stop = np.exp(-rate) * v + gain * force, gain * friction
        moved = np.where(np.abs(moved) > stop, moved - np.copysign(stop, moved), 0.0)
        way = 0.5 * STEP * (v + moved)
        x, v, slip = x + way, moved, np.clip(slip + way, -bristle, bristle)
    return [
        servo.resolution * np.rint(np.interp(clock, now, out[:, j]) / servo.resolution)
        for j, (servo, clock) in enumerate(zip(servos, read, strict=True))
    ]

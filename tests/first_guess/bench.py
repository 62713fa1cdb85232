"""Simulated axes whose signals the logs show under many names."""

from __future__ import annotations

from functools import cache

import numpy as np

from pmfid.types import Floats

Signals = dict[str, Floats]
#: Step of the simulation [s], and its length in steps.
STEP, N = 1e-3, 9000
MASS, VISCOUS, COULOMB = 0.5, 0.8, 0.4


@cache
def simulate(kind: str, seed: int) -> Signals:
    """Return the signals (N,) of an axis: "open" under steps of force, "servo" under a position loop, "speed" under a
    velocity loop, "rest" without motion.
    """
    rng = np.random.default_rng(seed)
    goal, goal_speed = _goals(kind, rng)
    wanted = np.repeat(rng.choice([-2.4, -1.3, 1.3, 2.4], N // 150 + 1), 150)[:N]
    x = v = force = total = 0.0
    rows = np.empty((N, 4))
    for k in range(N):
        if kind == "servo":
            wanted[k] = 60.0 * (goal[k] - x) + 9.0 * (goal_speed[k] - v)
        elif kind == "speed":
            total += STEP * (goal_speed[k] - v)
            wanted[k] = 12.0 * (goal_speed[k] - v) + 40.0 * total
        force += 0.25 * (wanted[k] - force)  # the current loop is fast, not infinitely fast
        push = force - VISCOUS * v - COULOMB * np.tanh(v / 2e-3)
        rows[k] = x, v, force, push / MASS
        if kind != "rest":
            v += STEP * push / MASS
            x += STEP * v
    return _signals(rows, wanted, goal, goal_speed, rng)


def _goals(kind: str, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return set points (N,) of position and velocity, which are moves between random places with pauses."""
    if kind == "speed":
        speed = np.repeat(rng.uniform(-1, 1, N // 900 + 1), 900)[:N]
        ramp = np.convolve(speed, np.ones(120) / 120)[:N]
        return np.cumsum(ramp) * STEP, ramp
    places = np.repeat(rng.uniform(-0.3, 0.3, N // 1000 + 1), 1000)[:N]
    goal = np.convolve(np.convolve(places, np.ones(300) / 300), np.ones(150) / 150)[:N]
    return goal, np.gradient(goal) / STEP


def _signals(rows: Floats, wanted: Floats, goal: Floats, goal_speed: Floats, rng: np.random.Generator) -> Signals:
    """Return the signals of a run from position, velocity, force and acceleration (N, 4)."""
    x, v, force, pull = rows.T
    t, noise = STEP * np.arange(N), rng.normal(size=(4, N))
    fine = np.floor(x / 1e-4) * 1e-4
    return {
        "t": t,
        "ms": 1e3 * t,
        "us": np.round(1e6 * t) + 4_120_008,
        "index": np.arange(N, dtype=float),
        "wanted": wanted,
        "force": force + 0.01 * noise[0],
        "current": force / 0.35 + 0.03 * noise[1],
        "late": np.r_[force[:10] * 0, force[:-10]] / 0.35,
        "voltage": 1.2 * force / 0.35 + 2.5 * v,
        "duty": np.round(255 * np.clip(wanted / 6, -1, 1)),
        "position": x,
        "fine": fine,
        "mm": 1e3 * x,
        "deg": x * 180 / np.pi,
        "counts": np.floor(x / 1e-4),
        "second": x + 1e-3 * np.sin(40 * x),
        "again": fine + 1e-5 * np.sin(t),
        "velocity": v,
        "tacho": v + 0.002 * noise[2],
        "rpm": (v + 0.002 * noise[2]) * 30 / np.pi,
        "pull": pull,
        "goal": goal,
        "goal_mm": 1e3 * goal,
        "goal_counts": 1e4 * goal,
        "goal_speed": goal_speed,
        "goal_rpm": goal_speed * 30 / np.pi,
        "error": goal - x,
        "warm": 31.0 + 3 * (1 - np.exp(-t / 6)) + 0.05 * noise[3],
        "status": np.where(t < 0.05, 0.0, 39.0),
        "bus": 24 + 0.02 * np.sin(t),
        "ripple": 0.02 * np.cos(7 * t),
    }

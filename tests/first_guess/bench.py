"""Simulated axes whose signals the logs show under many names."""

from __future__ import annotations

from functools import cache

import numpy as np

from pmfid.types import Floats

Signals = dict[str, Floats]
#: Step of the simulation [s], and its length in steps.
STEP, N = 1e-3, 12_000
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
    x, v, force, pull = rows.T
    t = STEP * np.arange(N)
    noise = rng.normal(size=(4, N))
    return {
        "t": t,
        "index": np.arange(N, dtype=float),
        "wanted": wanted,
        "force": force + 0.01 * noise[0],
        "current": force / 0.35 + 0.03 * noise[1],
        "voltage": 1.2 * force / 0.35 + 2.5 * v,
        "duty": np.round(255 * np.clip(wanted / 6, -1, 1)),
        "position": x,
        "counts": np.floor(x / 1e-4),
        "second": x + 1e-3 * np.sin(40 * x),
        "velocity": v,
        "tacho": v + 0.002 * noise[2],
        "pull": pull,
        "goal": goal,
        "goal_speed": goal_speed,
        "error": goal - x,
        "warm": 31.0 + 3 * (1 - np.exp(-t / 6)) + 0.05 * noise[3],
        "status": np.where(t < 0.05, 0.0, 39.0),
    }


def _goals(kind: str, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return set points (N,) of position and velocity, which are moves between random places with pauses."""
    if kind == "speed":
        speed = np.repeat(rng.uniform(-1, 1, N // 900 + 1), 900)[:N]
        ramp = np.convolve(speed, np.ones(120) / 120)[:N]
        return np.cumsum(ramp) * STEP, ramp
    places = np.repeat(rng.uniform(-0.3, 0.3, N // 1000 + 1), 1000)[:N]
    goal = np.convolve(np.convolve(places, np.ones(300) / 300), np.ones(150) / 150)[:N]
    return goal, np.gradient(goal) / STEP

"""Compare the simulated drive to an ODE solver that locates every stop and reversal."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pmfid.simulation import CART, DriveParameters, simulate_drive
from pmfid.types import Floats

RTOL, ATOL = 1e-10, 1e-13
DT, SAMPLES, HELD = 0.02, 500, 4
#: Input levels [V]. With OFFSET, stiction holds the cart at the small levels.
LEVELS = (-3.0, -0.35, 0.0, 0.35, 3.0)
OFFSET = 0.1  # [N]


@dataclass(frozen=True)
class Agreement:
    """Largest difference of position [m] and velocity [m/s] over `duration` [s], with counts of special samples. The
    counts are reversals, samples at rest, and samples with a stop or a reversal inside."""

    position: float
    velocity: float
    duration: float
    reversals: int
    at_rest: int
    events: int


def agreement(seed: int = 5) -> Agreement:
    """Compare the drive under a random input of five levels to `ode_interval`."""
    drive = replace(CART, offset=OFFSET)
    u = np.repeat(np.random.default_rng(seed).choice(LEVELS, SAMPLES // HELD), HELD)
    motion = simulate_drive(drive, u, DT)
    x, v, expected = 0.0, 0.0, []
    for value in u:
        expected.append((x, v))
        x, v = ode_interval(drive, drive.input_gain * float(value) - drive.offset, DT, x, v)
    apart = np.abs(np.column_stack((motion.x, motion.v)) - expected).max(axis=0)
    sides = np.sign(motion.v[motion.v != 0.0])
    inside = (motion.moving > 0.0) & (np.abs(motion.direction) < 1.0)
    counts = (np.count_nonzero(np.diff(sides)), np.count_nonzero(motion.moving == 0.0), np.count_nonzero(inside))
    return Agreement(float(apart[0]), float(apart[1]), SAMPLES * DT, *map(int, counts))


def ode_interval(p: DriveParameters, force: float, dt: float, x: float, v: float) -> tuple[float, float]:
    """Return position and velocity after one interval of constant force [N], by SciPy's DOP853 from event to event."""
    from scipy.integrate import solve_ivp

    t = 0.0
    while t < dt and not (v == 0.0 and abs(force) <= p.coulomb_friction):
        side = np.sign(v) if v else np.sign(force)

        def rhs(_: float, state: Floats, side: float = side) -> list[float]:
            return [state[1], (force - p.viscous_friction * state[1] - side * p.coulomb_friction) / p.mass]

        def stop(_: float, state: Floats) -> float:
            return float(state[1])

        stop.terminal, stop.direction = True, -side  # type: ignore[attr-defined]
        result = solve_ivp(rhs, (t, dt), [x, v], "DOP853", events=stop, rtol=RTOL, atol=ATOL)
        t, x, v = float(result.t[-1]), float(result.y[0, -1]), float(result.y[1, -1])
        v = 0.0 if result.status == 1 else v
    return x, v

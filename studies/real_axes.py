"""Axes of real machines, from a mirror to a crane; none is the cart, and no constant was chosen on them."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from pmfid.simulation import DriveParameters
from studies.machines import Axis

#: Position control: natural frequency over that of a move, damping, and force over the need of a move.
STIFF, DAMPED, REACH = 4.0, 0.8, 4.0
#: Force of the open loop over the need of the mean speed, and clock over the dominant time constant.
PUSH, CLOCK = 2.0, 0.3
#: Length of a record in moves and rests.
MOVES = 16


def axis(
    parameters: tuple[float, float, float, float], dt: float, resolution: float, stroke: float, move: float
) -> Axis:
    """Return an axis on its bench.

    `parameters` are mass [kg or kg m2], viscous and Coulomb friction, and force per unit of input. dt is in s, and the
    resolution in m or rad. Moves of a stroke [m or rad] last `move` [s], rests half as long.
    """
    drive = DriveParameters(*parameters)
    mass, viscous, coulomb, gain = parameters
    peak, speed = 5.77 * mass * stroke / move**2, stroke / move
    frequency = STIFF * 2 * np.pi / move
    control = {
        "kp": mass * frequency**2 / gain,
        "kd": max(2 * DAMPED * mass * frequency - viscous, 0.0) / gain,
        "u_max": REACH * (peak + 1.875 * viscous * speed + coulomb) / abs(gain),
    }
    settles = min(mass / viscous, move)
    return Axis(
        drive,
        dt,
        round(MOVES * 1.5 * move / dt),
        (coulomb + PUSH * (viscous * speed + mass * speed / settles)) / abs(gain),
        max(2, round(CLOCK * settles / dt)),
        MappingProxyType(control),
        stroke,
        move,
        move / 2,
        resolution,
        0.05 * speed,
    )


def turn(increments: int) -> float:
    return 2 * np.pi / increments


REAL: Mapping[str, Axis] = MappingProxyType(
    {
        "mirror": axis((1e-5, 2e-5, 8e-4, 0.03), 1e-4, turn(4000), 0.6, 0.04),
        "wheel": axis((2.6e-5, 1.1e-5, 1.4e-3, 0.021), 1e-3, turn(512), 9.0, 0.25),
        "pump": axis((3e-4, 1e-3, 0.02, 0.1), 5e-4, turn(2048), 20.0, 0.3),
        "flywheel": axis((0.02, 4e-4, 3e-3, 0.08), 2e-3, turn(1000), 12.0, 0.8),
        "joint": axis((0.35, 0.9, 2.1, 12.0), 2e-3, turn(16384), 1.5, 0.7),
        "antenna": axis((40.0, 60.0, 25.0, 30.0), 0.02, turn(8192), 0.8, 4.0),
        "coil": axis((0.35, 1.2, 0.15, 12.0), 2e-4, 1e-6, 0.02, 0.06),
        "plotter": axis((0.8, 6.0, 2.2, 3.5), 4e-3, 42e-6, 0.25, 0.5),
        "syringe": axis((2.0, 220.0, 15.0, 50.0), 1e-3, 2.5e-6, 0.03, 0.4),
        "linear": axis((8.0, 12.0, 9.0, 60.0), 5e-4, 5e-6, 0.3, 0.35),
        "conveyor": axis((60.0, 150.0, 40.0, 15.0), 5e-3, 1e-4, 1.2, 1.5),
        "door": axis((110.0, 90.0, 35.0, 22.0), 0.01, 2e-4, 0.9, 2.5),
        "mill": axis((250.0, 1800.0, 120.0, 95.0), 1e-3, 1e-6, 0.15, 0.6),
        "crane": axis((500.0, 900.0, 180.0, 800.0), 0.02, 5e-4, 2.5, 5.0),
    }
)

"""Benches and frictions of the study of model spread. The study of confidence has the same ones except two."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from pmfid.simulation import DriveParameters, Machine
from studies.machines import AXES, TURN, Axis

#: A small motor, sampled every half millisecond, and a slow slide.
FURTHER: Mapping[str, Axis] = MappingProxyType(
    {
        "motor": Axis(
            DriveParameters(1e-5, 2e-5, 8e-4, 0.03),
            0.0005, 6000, 0.12, 20, MappingProxyType({"kp": 0.02, "kd": 3e-4, "u_max": 1.0}), 12.0, 0.4, 0.15, TURN,
            1.0,
        ),
        "slide": Axis(
            DriveParameters(4.0, 25.0, 6.0, 8.0),
            0.01, 3000, 2.0, 12, MappingProxyType({"kp": 30.0, "kd": 3.0, "u_max": 5.0}), 0.25, 1.2, 0.5, 20e-6, 0.01,
        ),
    }
)  # fmt: skip
BENCHES: Mapping[str, Axis] = MappingProxyType({**AXES, **FURTHER})
HELD_BACK = ("rotary", "gantry", "heavy", "motor", "slide")
#: Friction of the machine beyond the model's friction; the first machine has none.
FRICTIONS: Mapping[str, Callable[[Axis], Machine]] = MappingProxyType(
    {
        "nothing": lambda axis: Machine(axis.drive),
        "Stribeck 20 %": lambda axis: stribeck(axis, 0.2),
        "Stribeck 50 %": lambda axis: stribeck(axis, 0.5),
        "quadratic 20 %": lambda axis: Machine(axis.drive, quadratic=0.2 * axis.drive.viscous_friction / axis.speed),
        "directional 15 %": lambda axis: Machine(axis.drive, asymmetry=0.15),
    }
)


def stribeck(axis: Axis, part: float) -> Machine:
    """Return the axis with friction at rest that exceeds Coulomb friction by a fraction."""
    return Machine(axis.drive, stribeck=part * axis.drive.coulomb_friction, stribeck_speed=axis.stribeck_speed)

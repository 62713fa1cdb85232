"""A case for tests of designs: a cart moves 0.4 m in 2 s from rest to rest (paper, section IV-A)."""

from __future__ import annotations

from pmfid.design.problem import Limits, Problem
from pmfid.models.drive import Drive

NOMINAL = {"mass": 1.5, "viscous_friction": 6.0, "coulomb_friction": 0.6}
UNKNOWN = {"m": ("mass",), "m, d": ("mass", "viscous_friction"), "m, d, F_c": tuple(NOMINAL)}
LIMITS = Limits(input=3.0, position=(0.0, 0.4), min_speed=0.01)
MIN_SPEED = LIMITS.min_speed
RESOLUTION = 22.75e-6


def case(
    unknown: str,
    *,
    min_speed: float = MIN_SPEED,
    resolution: float = RESOLUTION,
    samples_per_interval: int = 1,
) -> Problem:
    """Return the case for a key of UNKNOWN; min_speed [m/s], resolution [m per count]."""
    return Problem(
        Drive(2.0),
        NOMINAL,
        UNKNOWN[unknown],
        horizon=2.0,
        intervals=40,
        limits=Limits(input=3.0, position=(0.0, 0.4), min_speed=min_speed),
        resolution=resolution,
        end=(0.4, 0.0),
        samples_per_interval=samples_per_interval,
    )

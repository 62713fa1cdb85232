"""Linear and rotary axes, which have the same equations with different units and names."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

AxisKind = Literal["linear", "rotary"]
AXES: Final = ("linear", "rotary")
INERTIA: Final = "kg m2"
#: The unit on a rotary axis for each unit on a linear axis.
_ROTARY = {
    "kg": INERTIA,
    "N": "N m",
    "N s/m": "N m s/rad",
    "N/m": "N m/rad",
    "N s2/m2": "N m s2/rad2",
    "m/s": "rad/s",
    "m": "rad",
    "N per u": "N m per u",
}


@dataclass(frozen=True)
class Units:
    """Units of travel, speed, force and inertia, and the name of the inertia."""

    travel: str
    speed: str
    force: str
    of_inertia: str
    inertia: str


LINEAR, ROTARY = Units("m", "m/s", "N", "kg", "mass"), Units("rad", "rad/s", "N m", INERTIA, "inertia")


def rotary(unit: str) -> str:
    """Return the unit on a rotary axis that corresponds to a unit on a linear axis."""
    return _ROTARY.get(unit, unit)


def units_by(inertia: str) -> Units:
    """Return the units of an axis, given the unit of its mass or inertia."""
    return ROTARY if inertia == INERTIA else LINEAR

"""Changes of the cart."""

from __future__ import annotations

from dataclasses import replace

from pmfid.simulation.drive import DriveParameters
from pmfid.simulation.scenarios import CART

#: Time before a change, and time after it [s].
BEFORE, AFTER = 12.0, 8.0
#: Name, parameter of the cart, factor.
CHANGES = {
    "mass +10 %": ("mass", 1.1),
    "mass -10 %": ("mass", 0.9),
    "viscous friction +10 %": ("viscous_friction", 1.1),
    "Coulomb friction +30 %": ("coulomb_friction", 1.3),
    "input gain -10 %": ("input_gain", 0.9),
}


def changed(name: str, factor: float) -> DriveParameters:
    """Return the cart after a change."""
    return replace(CART, **{name: factor * getattr(CART, name)})

"""What people ask of two masses on a spring: resonance, antiresonance, damping ratios and the ratio of the inertias."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pmfid.types import Floats


@dataclass(frozen=True)
class Coupling:
    """Derived values of two masses, each with its standard error, as (value, std).

    `resonance` and `antiresonance` are those of the motor [Hz], without friction. `damping_ratio` belongs to the
    resonance, and `load_damping_ratio` to the antiresonance. `total` is the sum of the inertias, in their unit, and
    `ratio` is the load's inertia over the motor's.
    """

    resonance: tuple[float, float]
    antiresonance: tuple[float, float]
    damping_ratio: tuple[float, float]
    load_damping_ratio: tuple[float, float]
    total: tuple[float, float]
    ratio: tuple[float, float]

    @property
    def lines(self) -> tuple[str, str]:
        """The values in words."""
        return (
            f"resonance {_text(*self.resonance)} Hz, damping ratio {_text(*self.damping_ratio)}",
            f"antiresonance {_text(*self.antiresonance)} Hz, load over motor {_text(*self.ratio)}",
        )

    def to_json(self) -> dict[str, object]:
        return {name: {"value": value, "std": std} for name, (value, std) in vars(self).items()}


def _text(value: float, std: float) -> str:
    digits = 4 if not 0 < std < value else min(8, 2 + math.floor(math.log10(value)) - math.floor(math.log10(std)))
    return f"{value:.{digits}g} ± {std:.2g}"


def derive(motor: float, load: float, stiffness: float, damping: float) -> Floats:
    """Return the values of `Coupling` (6,) in their order."""
    reduced = motor * load / (motor + load)
    free, held = math.sqrt(stiffness / reduced), math.sqrt(stiffness / load)
    ratios = (damping / (2 * reduced * free), damping / (2 * load * held))
    return np.array([free / (2 * math.pi), held / (2 * math.pi), *ratios, motor + load, load / motor])


def couple(values: Floats, covariance: Floats) -> Coupling:
    """Return the derived values of motor, load, stiffness and damping (4,) with a covariance (4, 4)."""
    middle = derive(*values.tolist())
    steps = np.diag(1e-6 * np.abs(values))
    slopes = np.column_stack([(derive(*(values + step).tolist()) - middle) / np.sum(step) for step in steps])
    std = np.sqrt(np.maximum(np.diag(slopes @ covariance @ slopes.T), 0.0))
    return Coupling(*zip(middle.tolist(), std.tolist(), strict=True))

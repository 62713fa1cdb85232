"""The drive with viscous and Coulomb friction."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from pmfid.errors import UsageError
from pmfid.models.equation import Equation, Term


@dataclass(frozen=True)
class Drive:
    """m x'' + d x' + F_c sign(x') [+ offset] = input_gain u  (paper eq. 37 and 42, F_c as a force).

    input_gain: force per unit of input [N/V, or 1 where u is a force], finite, not 0.
    offset: estimate a constant force as well [N], as gravity or a biased current measurement give it.
    Parameters: mass [kg], viscous_friction [N s/m], coulomb_friction [N] [, offset [N]].
    Raises UsageError for an input gain that is 0 or not finite.
    """

    kind: ClassVar[str] = "drive"

    input_gain: float
    offset: bool = False

    def __post_init__(self) -> None:
        if not math.isfinite(self.input_gain) or self.input_gain == 0:
            raise UsageError(
                f"input_gain must be finite and not 0, got {self.input_gain}; "
                "it is the force per unit of input, 1 where the input is the force itself"
            )

    @property
    def equation(self) -> Equation:
        unknown = [
            Term("output", 2, "mass", "kg", noisy=True),
            Term("output", 1, "viscous_friction", "N s/m", noisy=True),
            Term("direction", 0, "coulomb_friction", "N"),
        ]
        if self.offset:
            unknown.append(Term("moving", 0, "offset", "N"))
        return Equation(tuple(unknown), (Term("input", 0, coefficient=self.input_gain),))

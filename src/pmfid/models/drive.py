"""The drive with viscous and Coulomb friction."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from pmfid.errors import UsageError
from pmfid.models.equation import Equation, Term

FRICTIONS = ("symmetric", "directional")

#: What the auxiliary model of the kernel takes each role's value from (csrc/pmf.h), first name that exists.
ROLES = (
    ("mass",),
    ("viscous_friction", "viscous_friction_forward"),
    ("viscous_friction", "viscous_friction_backward"),
    ("coulomb_friction", "coulomb_friction_forward"),
    ("coulomb_friction", "coulomb_friction_backward"),
    ("offset",),
)


@dataclass(frozen=True)
class Drive:
    """m x'' + d x' + F_c sign(x') [+ offset] = input_gain u  (paper eq. 37 and 42, F_c as a force).

    input_gain: force per unit of input [N/V, or 1 where u is a force], finite, not 0.
    offset: estimate a constant force as well [N], as gravity or a biased current measurement give it.
    friction: "symmetric", or "directional": viscous and Coulomb friction differ between forward and backward.
    Parameters: mass [kg], viscous_friction [N s/m], coulomb_friction [N] [, offset [N]]; directional:
    mass, viscous_friction_forward, viscous_friction_backward, coulomb_friction_forward, coulomb_friction_backward.
    With directional friction the offset cannot be told from the two Coulomb frictions and must stay out.
    Raises UsageError for an input gain that is 0 or not finite, an unknown friction, or both of the last.
    """

    kind: ClassVar[str] = "drive"

    input_gain: float
    offset: bool = False
    friction: str = "symmetric"

    def __post_init__(self) -> None:
        if not 1e-30 < abs(self.input_gain) < 1e30:
            raise UsageError(
                f"input_gain must be finite and not 0, got {self.input_gain}; "
                "it is the force per unit of input, 1 where the input is the force itself"
            )
        if self.friction not in FRICTIONS:
            raise UsageError(f"friction must be one of {FRICTIONS}, got {self.friction!r}")
        if self.friction == "directional" and self.offset:
            raise UsageError(
                "offset and directional friction cannot be told apart; leave the offset out: "
                "it is half the difference of the two Coulomb frictions"
            )

    @property
    def equation(self) -> Equation:
        unknown = [Term("output", 2, "mass", "kg", noisy=True), *_FRICTION_TERMS[self.friction]]
        if self.offset:
            unknown.append(Term("moving", 0, "offset", "N"))
        return Equation(tuple(unknown), (Term("input", 0, coefficient=self.input_gain),))

    @property
    def symmetric(self) -> Drive:
        """The drive that can be identified before the directions are told apart."""
        if self.friction == "symmetric":
            return self
        return replace(self, friction="symmetric", offset=True)

    def roles(self) -> tuple[int | None, ...]:
        """For each role of the auxiliary model the index of its parameter, or None."""
        names = self.equation.names
        return tuple(next((names.index(name) for name in role if name in names), None) for role in ROLES)


_FRICTION_TERMS = {
    "symmetric": (
        Term("output", 1, "viscous_friction", "N s/m", noisy=True),
        Term("direction", 0, "coulomb_friction", "N"),
    ),
    "directional": (
        Term("forward_output", 1, "viscous_friction_forward", "N s/m", noisy=True),
        Term("backward_output", 1, "viscous_friction_backward", "N s/m", noisy=True),
        Term("forward", 0, "coulomb_friction_forward", "N"),
        Term("backward", 0, "coulomb_friction_backward", "N"),
    ),
}

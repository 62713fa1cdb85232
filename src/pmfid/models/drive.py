"""Models: the drive with viscous and Coulomb friction, and an equation of the user's own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Real
from typing import ClassVar, Literal, Protocol

from pmfid.errors import UsageError
from pmfid.models.equation import ESTIMATE, Equation, Term, check_dead_time

FRICTIONS = ("symmetric", "directional")


class Model(Protocol):
    """What an estimator needs to know of a plant."""

    kind: ClassVar[str]

    @property
    def equation(self) -> Equation: ...

    @property
    def symmetric(self) -> Model:
        """The model that can be identified before the directions of motion are told apart."""
        ...

    @property
    def simple(self) -> Model:
        """The same, and without a dead time that is to be found: what methods that simulate no motion can identify."""
        ...

    def at_dead_time(self, seconds: float) -> Model:
        """The same with a known dead time of the input [s]."""
        ...


@dataclass(frozen=True)
class EquationModel:
    """A model from a user's own terms: any `Equation`.

    The methods that simulate (iv, riv, output-error, interval) need one unknown second derivative of the output and
    no known term but the input; the others take every equation.
    """

    kind: ClassVar[str] = "equation"

    equation: Equation

    @property
    def symmetric(self) -> EquationModel:
        return EquationModel(self.equation.symmetric)

    @property
    def simple(self) -> EquationModel:
        found = self.equation.dead_time == ESTIMATE
        return self.symmetric.at_dead_time(0.0) if found else self.symmetric

    def at_dead_time(self, seconds: float) -> EquationModel:
        return EquationModel(self.equation.at_dead_time(seconds))


@dataclass(frozen=True)
class Drive:
    """m x'' + d x' + F_c sign(x') [+ k x] [+ offset] = input_gain u  (paper eq. 37 and 42, F_c as a force).

    input_gain: force per unit of input [N/V, or 1 where u is a force], finite, not 0.
    offset: estimate a constant force as well [N], as gravity or a biased current measurement give it.
    friction: "symmetric", or "directional": viscous and Coulomb friction differ between forward and backward.
    spring: the load hangs on a spring [N/m]; x counts from the first sample, where the spring's force is the offset,
    which comes with it.
    Parameters: mass [kg], viscous_friction [N s/m], coulomb_friction [N] [, offset [N]] [, stiffness [N/m]];
    directional: mass, viscous_friction_forward, viscous_friction_backward, coulomb_friction_forward,
    coulomb_friction_backward [, stiffness]. With directional friction the offset cannot be told from the two Coulomb
    frictions and must stay out.
    dead_time: by which u acts late, or the counts are [s], any part of a sample; "estimate": a parameter, too, up to 20
    samples, for the methods that simulate (iv, riv, output-error, interval).
    Friction that falls with speed near standstill (Stribeck) is not in the model: the status says `unmodelled`.
    Raises UsageError for an input gain that is 0 or not finite, an unknown friction, or both of the last.
    """

    kind: ClassVar[str] = "drive"

    input_gain: float
    offset: bool = False
    friction: str = "symmetric"
    spring: bool = False
    dead_time: float | Literal["estimate"] = 0.0

    def __post_init__(self) -> None:
        if not isinstance(self.input_gain, Real) or not 1e-30 < abs(self.input_gain) < 1e30:
            raise UsageError(
                f"input_gain must be finite and not 0, got {self.input_gain!r}; "
                "it is the force per unit of input, 1 where the input is the force itself"
            )
        check_dead_time(self.dead_time)
        if self.friction not in FRICTIONS:
            raise UsageError(f"friction must be one of {FRICTIONS}, got {self.friction!r}")
        if self.friction == "directional" and self.offset:
            raise UsageError(
                "offset and directional friction cannot be told apart; leave the offset out: "
                "it is half the difference of the two Coulomb frictions"
            )

    @cached_property
    def equation(self) -> Equation:
        unknown = [Term("output", 2, "mass", "kg"), *_FRICTION_TERMS[self.friction]]
        if self.offset or (self.spring and self.friction == "symmetric"):
            unknown.append(Term("moving", 0, "offset", "N"))
        if self.spring:
            unknown.append(Term("output", 0, "stiffness", "N/m"))
        known = (Term("input", 0, coefficient=self.input_gain),)
        return Equation(tuple(unknown), known, dead_time=self.dead_time)

    @property
    def symmetric(self) -> Drive:
        """The drive that can be identified before the directions are told apart."""
        if self.friction == "symmetric":
            return self
        return replace(self, friction="symmetric", offset=True)

    @property
    def simple(self) -> Drive:
        return self.symmetric.at_dead_time(0.0) if self.dead_time == ESTIMATE else self.symmetric

    def at_dead_time(self, seconds: float) -> Drive:
        return replace(self, dead_time=seconds)


_FRICTION_TERMS = {
    "symmetric": (
        Term("output", 1, "viscous_friction", "N s/m"),
        Term("direction", 0, "coulomb_friction", "N"),
    ),
    "directional": (
        Term("forward_output", 1, "viscous_friction_forward", "N s/m"),
        Term("backward_output", 1, "viscous_friction_backward", "N s/m"),
        Term("forward", 0, "coulomb_friction_forward", "N"),
        Term("backward", 0, "coulomb_friction_backward", "N"),
    ),
}

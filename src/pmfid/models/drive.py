"""Models of a machine: a drive with viscous and Coulomb friction, and an equation with a user's own terms."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Real
from typing import ClassVar, Literal, Protocol, TypeVar, get_args

from pmfid.errors import UsageError, check_choice
from pmfid.models.axes import AXES, LINEAR, ROTARY, AxisKind, rotary
from pmfid.models.equation import DEAD_TIME, ESTIMATE, LAG, Equation, Term, check_late
from pmfid.models.shapes import Square, Stribeck, Wave
from pmfid.models.signals import Signal

Friction = Literal["symmetric", "directional"]
FRICTIONS: tuple[Friction, ...] = get_args(Friction)
Body = Literal["rigid", "two-mass"]
BODIES: tuple[Body, ...] = get_args(Body)
TWO_MASS: Body = "two-mass"
Side = Literal["motor", "load"]
SIDES: tuple[Side, ...] = get_args(Side)
#: Fields of `Drive` whose force depends on the position.
POSITION_KEYS = ("spring", "gravity", "cogging", "friction_period")

Late = float | Literal["estimate"]


class Model(Protocol):
    """Properties and methods of a plant's model that an estimator uses."""

    kind: ClassVar[str]

    @property
    def equation(self) -> Equation: ...

    @property
    def symmetric(self) -> Model:
        """Model with equal friction in both directions of motion, for the start of an identification."""
        ...

    @property
    def simple(self) -> Model:
        """Model for methods that simulate no motion: equal friction in both directions, and no unknown dead time or
        lag.
        """
        ...

    def replace_dead_time(self, seconds: Late) -> Model:
        """Return a copy with another dead time of the input [s]."""
        ...

    def replace_lag(self, seconds: Late) -> Model:
        """Return a copy with another lag of the input [s]."""
        ...


@dataclass(frozen=True)
class EquationModel:
    """A model from a user's own terms, which can be any `Equation`.

    Parameters
    ----------
    equation : Equation
        Terms of the model.

    Notes
    -----
    The methods that simulate (iv, riv, fit) need an unknown second derivative of the output. The
    input must be the only known term for these methods. All other methods accept every equation.

    Examples
    --------
    The equation of the example is m x'' + d x' = u:

    >>> from pmfid import Equation, EquationModel, Term
    >>> unknown = (Term("output", 2, "mass", "kg"), Term("output", 1, "damping", "N s/m"))
    >>> EquationModel(Equation(unknown, (Term("input"),))).equation.names
    ('mass', 'damping')
    """

    kind: ClassVar[str] = "equation"

    equation: Equation

    @property
    def symmetric(self) -> EquationModel:
        return EquationModel(self.equation.symmetric)

    @property
    def simple(self) -> EquationModel:
        return remove_unknown_lateness(self.symmetric)

    def replace_dead_time(self, seconds: Late) -> EquationModel:
        return EquationModel(self.equation.replace_dead_time(seconds))

    def replace_lag(self, seconds: Late) -> EquationModel:
        return EquationModel(self.equation.replace_lag(seconds))


@dataclass(frozen=True)
class Drive:
    """Model of a drive: m x'' + d x' + F_c sign(x') [+ k x] [+ offset] = input_gain u  (paper eq. 37 and 42, F_c as a
    force).

    Parameters
    ----------
    input_gain : float or "estimate"
        Force per unit of input [N/V, or 1 if u is a force], finite, not 0. "estimate" makes the gain an unknown.
        `pmfid.identify` then needs a known force, as given = {"mass": 1.25}.
    offset : bool
        If True, a constant force is estimated as well [N]. Gravity or a biased current measurement cause such a force.
    friction : {"symmetric", "directional"}
        With "directional", viscous and Coulomb friction differ between forward and backward. Directional friction
        excludes an offset, because the two Coulomb frictions already contain the offset.
    spring : bool
        If True, the load hangs on a spring [N/m], and an offset is unknown too. The position x counts from the first
        sample, so that the spring's force at the first sample is part of the offset.
    dead_time : float or "estimate"
        Delay of u, or of the counts [s], with any fraction of a sample. "estimate" makes the dead time a parameter, up
        to 20 samples, for the methods that simulate (iv, riv, fit).
    stribeck : float or "estimate", optional
        Stribeck speed [m/s], > 0. The friction at rest beyond Coulomb friction falls with exp(-(v / stribeck)^2). With
        "estimate", fit finds the speed as well.
    quadratic : bool
        If True, friction has a further part in proportion to v |v|.
    gravity : bool or float
        Unbalanced load on a rotary axis: forces with the sin and cos of the angle. True stands for an angle in rad. A
        number is the length of one turn in the unit of y.
    cogging : float, optional
        Pitch [m] of a cogging force, which has a sin and a cos term.
    friction_period : float, optional
        Period [m] of friction that changes along the travel.
    lag : float or "estimate"
        Time constant [s] of a first-order lag of the input, as in a current loop, up to 20 samples. "estimate" makes
        the lag a parameter, off-line (iv, fit).
    body : {"rigid", "two-mass"}
        With "two-mass", a load follows on a spring with damping, as on a belt, a coupling or a harmonic drive. The
        input acts on the motor, and gravity acts on the load. The off-line fit estimates such an axis, and no recursion
        does.
    output : {"motor", "load"}
        The mass of a two-mass body that the encoder shows.
    play : bool
        True for a gap between motor and load, as in a gear. Stiffness and damping then belong to the contact.
    axis : {"linear", "rotary"}
        With "rotary", y is an angle, forces are torques, and the mass is an inertia [kg m2]. For a rotary axis, the
        units m and N on this page stand for rad and N m.

    Raises
    ------
    UsageError
        The input gain is 0 or not finite, the friction or axis is unknown, or an offset stands with directional
        friction. The same error names an invalid dead time, lag, speed or period.

    Notes
    -----
    The parameters are mass [kg], viscous_friction [N s/m], coulomb_friction [N] [, offset [N]] [, stiffness [N/m]].

    With directional friction, the parameters are mass, viscous_friction_forward, viscous_friction_backward,
    coulomb_friction_forward, coulomb_friction_backward [, stiffness].

    Further parameters follow in this order: [, stribeck_friction [N]] [, quadratic_friction [N s2/m2]] [, gravity_sin,
    gravity_cos [N]] [, cogging_sin, cogging_cos [N]] [, friction_sin, friction_cos [N]] [, dead_time [s]] [, lag [s]]
    [, stribeck_speed [m/s]].

    With body="two-mass", the first parameter is motor_mass [kg] or motor_inertia [kg m2], and load_mass or
    load_inertia, load_viscous_friction, load_coulomb_friction, stiffness [N/m], damping [N s/m] and, with play, play
    [m] follow. The other forces and frictions act on the motor.

    For forces and friction that depend on the position, the position counts from the first sample.

    Examples
    --------
    >>> from pmfid import Drive
    >>> Drive(2.0, offset=True).equation.names
    ('mass', 'viscous_friction', 'coulomb_friction', 'offset')
    >>> Drive(1.0, axis="rotary", gravity=True).equation.units
    ('kg m2', 'N m s/rad', 'N m', 'N m', 'N m')
    """

    kind: ClassVar[str] = "drive"

    input_gain: float | Literal["estimate"]
    offset: bool = False
    friction: Friction = "symmetric"
    spring: bool = False
    dead_time: Late = 0.0
    stribeck: float | Literal["estimate"] | None = None
    quadratic: bool = False
    gravity: bool | float = False
    cogging: float | None = None
    friction_period: float | None = None
    lag: Late = 0.0
    body: Body = "rigid"
    play: bool = False
    output: Side = "motor"
    axis: AxisKind = "linear"

    def __post_init__(self) -> None:
        check_choice("axis", self.axis, AXES)
        known = self.input_gain != ESTIMATE
        if known and (not isinstance(self.input_gain, Real) or not 1e-30 < abs(self.input_gain) < 1e30):
            raise UsageError(
                f"input_gain must be finite and not 0, got {self.input_gain!r}; give the force per unit of input, or 1 "
                "if the input is the force"
            )
        check_late(DEAD_TIME, self.dead_time)
        check_late(LAG, self.lag)
        check_choice("friction", self.friction, FRICTIONS)
        check_choice("body", self.body, BODIES)
        if self.body == TWO_MASS and (self.spring or self.lag):
            name = "spring" if self.spring else "lag"
            raise UsageError(f'body = "{TWO_MASS}" excludes {name}; leave {name} out, or use body = "rigid"')
        check_choice("output", self.output, SIDES)
        if self.body != TWO_MASS and (self.play or self.output != "motor"):
            name = "play" if self.play else 'output = "load"'
            raise UsageError(f'{name} needs body = "{TWO_MASS}"; set that, or leave {name.split()[0]} out')
        if self.play and self.output != "motor":
            raise UsageError('play needs counts of the motor; leave play out, or use output = "motor"')
        if self.friction == "directional" and self.offset:
            raise UsageError(
                "offset and directional friction cannot be distinguished; leave the offset out, because it equals half "
                "the difference of the two Coulomb frictions"
            )
        if isinstance(self.stribeck, str) and self.stribeck != ESTIMATE:
            raise UsageError(f'stribeck must be a speed in the unit of y per s, or "{ESTIMATE}", got {self.stribeck!r}')
        _ = self.equation  # the equation checks its shapes

    @cached_property
    def equation(self) -> Equation:
        turns, elastic = self.axis == "rotary", self.body == TWO_MASS
        inertia = ROTARY.inertia if turns else LINEAR.inertia
        second = (
            tuple((name, rotary(unit) if turns else unit) for name, unit in _second(inertia, self.play))
            if elastic
            else ()
        )
        unknown = [
            Term("output", 2, f"motor_{inertia}" if elastic else inertia, "kg"),
            *_FRICTION_TERMS[self.friction],
        ]
        if self.offset or (self.spring and self.friction == "symmetric"):
            unknown.append(Term("moving", 0, "offset", "N"))
        if self.spring:
            unknown.append(Term("output", 0, "stiffness", "N/m"))
        unknown += self._make_shaped_terms()
        if turns:
            unknown = [replace(term, unit=rotary(str(term.unit))) for term in unknown]
        # forces are relative to the gain if the gain is unknown
        gain = 1.0 if isinstance(self.input_gain, str) else self.input_gain
        known = (Term("input", 0, coefficient=gain),)
        return Equation(
            tuple(unknown),
            known,
            dead_time=self.dead_time,
            lag=self.lag,
            second=second,
            shows_load=self.output == "load",
        )

    def _make_shaped_terms(self) -> list[Term]:
        terms = []
        if self.stribeck is not None:
            terms.append(Term("friction", 0, "stribeck_friction", "N", shape=Stribeck(self.stribeck)))
        if self.quadratic:
            terms.append(Term("friction", 0, "quadratic_friction", "N s2/m2", shape=Square()))
        if self.gravity is not False:
            terms += _waves("place", "gravity", 2 * math.pi if self.gravity is True else self.gravity)
        if self.cogging is not None:
            terms += _waves("place", "cogging", self.cogging)
        if self.friction_period is not None:
            terms += _waves("friction", "friction", self.friction_period)
        return terms

    @property
    def symmetric(self) -> Drive:
        """Drive that can be identified without a simulated motion: one mass with equal friction in both directions."""
        both = self.friction == "symmetric"
        plain = replace(self, friction="symmetric", offset=self.offset or not both, stribeck=None, quadratic=False)
        plain = replace(plain, body="rigid", play=False, output="motor")
        return self if self == plain else plain

    @property
    def simple(self) -> Drive:
        return remove_unknown_lateness(self.symmetric)

    def replace_dead_time(self, seconds: Late) -> Drive:
        return replace(self, dead_time=seconds)

    def replace_lag(self, seconds: Late) -> Drive:
        return replace(self, lag=seconds)


Machine = TypeVar("Machine", EquationModel, Drive)


def remove_unknown_lateness(model: Machine) -> Machine:
    """Return the model without a dead time or lag if the model has an unknown one."""
    plain = model.replace_dead_time(0.0) if model.equation.dead_time == ESTIMATE else model
    return plain.replace_lag(0.0) if model.equation.lag == ESTIMATE else plain


def _second(inertia: str, play: bool) -> tuple[tuple[str, str], ...]:
    """Return names and units of a load on a spring on a linear axis (see `Equation`)."""
    return (
        (f"load_{inertia}", "kg"),
        ("load_viscous_friction", "N s/m"),
        ("load_coulomb_friction", "N"),
        ("stiffness", "N/m"),
        ("damping", "N s/m"),
        *((("play", "m"),) if play else ()),
    )


def _waves(signal: Signal, name: str, period: float) -> list[Term]:
    return [Term(signal, 0, f"{name}_{part}", "N", shape=Wave(period, part == "cos")) for part in ("sin", "cos")]


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

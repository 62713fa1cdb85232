"""Equation of a plant, as a sum of terms that is linear in the unknown coefficients. Each term is a derivative of a
signal.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Real
from typing import Literal

from pmfid.errors import UsageError, did_you_mean
from pmfid.kernel.configuration import ShapeTable
from pmfid.models.axes import LINEAR, Units, rotary, units_by
from pmfid.models.shapes import ESTIMATE as ESTIMATE
from pmfid.models.shapes import Shape, Stribeck
from pmfid.models.signals import PROCESS_SIGNALS, SIGNALS, Signal, SignalFacts
from pmfid.types import Floats

#: Signal and derivative of the terms that fill each role in the kernel's auxiliary model (csrc/pmf.h).
ROLES: tuple[tuple[tuple[Signal, int], ...], ...] = (
    (("output", 2),),
    (("output", 1), ("forward_output", 1)),
    (("output", 1), ("backward_output", 1)),
    (("direction", 0), ("forward", 0)),
    (("direction", 0), ("backward", 0)),
    (("moving", 0),),
    (("output", 0),),
)
MASS, VISCOUS_FORWARD, VISCOUS_BACKWARD, COULOMB_FORWARD, COULOMB_BACKWARD, OFFSET, STIFFNESS = range(7)
#: Roles whose value is never negative, which are inertia and friction.
POSITIVE_ROLES = (MASS, VISCOUS_FORWARD, VISCOUS_BACKWARD, COULOMB_FORWARD, COULOMB_BACKWARD)
DEAD_TIME, LAG = "dead_time", "lag"
#: Longest dead time, and longest lag, in samples.
MOST_LATE = 20


@dataclass(frozen=True)
class Term:
    """A term of an equation, coefficient * d^derivative signal / dt^derivative. A coefficient with a name is unknown.

    Parameters
    ----------
    signal : str
        One of `Signal`. The signal `output` counts from its first sample.
    derivative : int
        0 to 2 for `output`, 1 for `forward_output` and `backward_output`, 0 for other signals of a machine. For a
        process, 0 to 6 for the output, and less than that for the input.
    name : str, optional
        Name of an unknown coefficient.
    unit : str
        Unit of an unknown coefficient.
    coefficient : float
        Value of a known coefficient. An unknown coefficient has this factor, for example -1 on the other side of the
        equation.
    shape : Shape, optional
        Form of a friction or of a force at a place. The size of the force remains unknown.

    Raises
    ------
    UsageError
        The signal, the derivative or a value is not allowed.

    Examples
    --------
    >>> from pmfid import Term
    >>> Term("output", 2, "mass", "kg").name
    'mass'
    """

    signal: Signal
    derivative: int = 0
    name: str | None = None
    unit: str = ""
    coefficient: float = 1.0
    shape: Shape | None = None

    def __post_init__(self) -> None:
        known = list(SIGNALS)
        if self.signal not in known:
            raise UsageError(
                f"a term's signal must be one of {known}, got {self.signal!r}{did_you_mean(self.signal, known)}"
            )
        low, high = self.facts.derivatives
        if not low <= self.derivative <= high:
            allowed = f"{low}" if low == high else f"{low} to {high}"
            hint = '; for a dead time write dead_time = "estimate"' if self.signal == "input" else ""
            raise UsageError(f"derivative of a term of {self.signal} must be {allowed}, got {self.derivative}{hint}")
        if self.name is not None and not self.name.isidentifier():
            raise UsageError(f"name of a term must be a plain word such as 'inertia', got {self.name!r}")
        if not 1e-30 < abs(self.coefficient) < 1e30 or not math.isfinite(self.coefficient):
            raise UsageError(f"coefficient of a term must be finite and not 0, got {self.coefficient}")
        self._check_shape()

    def _check_shape(self) -> None:
        if not self.facts.shaped:
            if self.shape is not None:
                raise UsageError(
                    f"a term of {self.signal} cannot have a shape; leave the shape out, or use the signal "
                    '"friction" or "place"'
                )
            return
        if not isinstance(self.shape, Shape):
            raise UsageError(f"a term of {self.signal} needs a shape such as Stribeck(0.02), got {self.shape!r}")
        if self.signal == "place" and self.shape.of_speed:
            raise UsageError(f'{self.shape.reads} depends on the speed: use the signal "friction" instead of "place"')
        if self.name is None or self.coefficient != 1.0:
            raise UsageError(
                f"the coefficient of the term of {self.signal} is estimated; give the term a name and no coefficient"
            )

    @property
    def facts(self) -> SignalFacts:
        return SIGNALS[self.signal]

    @property
    def noisy(self) -> bool:
        """True if the term carries the noise of the measured output. The output of a machine itself counts as free of
        noise, because an encoder step is small against the travel.
        """
        return self.facts.measured and (self.facts.of_process or self.derivative > 0)

    @property
    def reads(self) -> str:
        """Signal and derivative as text for people."""
        read = f"{self.facts.reads}{chr(39) * self.derivative}"
        return read if self.shape is None else f"{self.shape.reads} {read}"

    @property
    def place(self) -> tuple[object, ...]:
        """Key that distinguishes the term from all other terms."""
        return (self.signal, self.derivative) if self.shape is None else (self.signal, self.derivative, self.shape)


@dataclass(frozen=True)
class Equation:
    """Equation of a plant, in which the `unknown` terms and the `known` terms have equal sums.

    In the notation of the theory, sum theta_i D^j w_i = D^j w_0.

    Parameters
    ----------
    unknown, known : tuple of Term
        Terms of the two sides. The order of the equation is the highest derivative of the output.
    delay : int
        Dead time of the input in whole samples, for a process only.
    only_simulated : str
        Reason why only methods that simulate can estimate a process; empty if all methods can.
    further : tuple of (name, unit)
        Unknowns in which the equation is not linear, for methods that simulate. Unknown parameters of shapes are added
        to this list.
    dead_time : float or "estimate"
        Dead time of a machine's input [s], any part of a sample. Late counts have the same effect as a late input. With
        "estimate", the dead time is one of `further`.
    lag : float or "estimate"
        Time constant [s] of a first-order lag of the input, as in a current loop. With "estimate", the lag is one of
        `further`.
    second : tuple of (name, unit)
        Inertia, viscous and Coulomb friction of a second mass, stiffness and damping of the spring between the masses,
        and perhaps the gap between them, or nothing. The terms belong to the first mass, on which the input acts.
    shows_load : bool
        Whether the output is the position of the second mass, and not that of the first one.

    Raises
    ------
    UsageError
        The equation has no unknown or no known term, two unknowns share a name, or a term occurs twice. The same error
        is raised if an unknown term has no name, or a known term has one.

    Examples
    --------
    >>> from pmfid import Equation, Term
    >>> equation = Equation((Term("output", 2, "mass", "kg"),), (Term("input", coefficient=2.0),))
    >>> equation.names, equation.order
    (('mass',), 2)
    """

    unknown: tuple[Term, ...]
    known: tuple[Term, ...]
    delay: int = 0
    only_simulated: str = ""
    further: tuple[tuple[str, str], ...] = ()
    dead_time: float | Literal["estimate"] = 0.0
    lag: float | Literal["estimate"] = 0.0
    second: tuple[tuple[str, str], ...] = ()
    shows_load: bool = False

    def __post_init__(self) -> None:
        self._check_late()
        object.__setattr__(self, "unknown", tuple(self.unknown))
        object.__setattr__(self, "known", tuple(self.known))
        names = [term.name for term in self.unknown]
        if not self.unknown or not self.known or None in names or len(set(names)) < len(names):
            raise UsageError(
                f"an equation needs unknown terms with different names and at least one known term, got {names}"
            )
        if any(term.name is not None for term in self.known):
            raise UsageError("a known term must have no name; put the term among the unknown ones, or drop the name")
        if self.process:
            self._check_process()
        elif not any(term.signal == "input" for term in self.known):
            raise UsageError("one known term must be the input; add it, to give the unknown terms their scale")
        if not any(term.noisy for term in self.unknown) and not self.only_simulated:
            raise UsageError(
                "no unknown term is a derivative of the output; add one, such as the term of a mass or of "
                "viscous friction"
            )
        free = tuple((f"{term.name}_speed".replace("_friction", ""), self.motion.speed) for term in self._free)
        late = ((DEAD_TIME, "s"),) if self.dead_time == ESTIMATE else ()
        lag = ((LAG, "s"),) if self.lag == ESTIMATE else ()
        object.__setattr__(self, "further", tuple(dict.fromkeys((*late, *lag, *self.second, *self.further, *free))))
        places = [term.place for term in (*self.unknown, *self.known)]
        if len(set(places)) < len(places):
            raise UsageError(
                "two terms have the same signal and derivative, and cannot be distinguished; drop one of the two terms"
            )

    def _check_late(self) -> None:
        check_late(DEAD_TIME, self.dead_time)
        check_late(LAG, self.lag)
        if self.dead_time and self.process:
            raise UsageError("the dead time of a linear process belongs to its TransferFunction; leave dead_time out")
        if self.lag and self.process:
            raise UsageError("a lag of a linear process is one of its poles; leave lag out, and increase n by 1")

    def replace_dead_time(self, seconds: float | Literal["estimate"]) -> Equation:
        """Return a copy with another dead time [s]."""
        return replace(self, further=tuple(one for one in self.further if one[0] != DEAD_TIME), dead_time=seconds)

    def replace_lag(self, seconds: float | Literal["estimate"]) -> Equation:
        """Return a copy with another lag of the input [s]."""
        return replace(self, further=tuple(one for one in self.further if one[0] != LAG), lag=seconds)

    @property
    def at_once(self) -> Equation:
        """Equation without dead time and lag of the input."""
        return self.replace_dead_time(0.0).replace_lag(0.0)

    def role_values(self, theta: Sequence[float] | Floats | None) -> list[float]:
        """Return the value of each role of the simulated body from the parameters (p,). A role without a term has the
        value 0, and None stands for zeros.
        """
        return [0.0 if index is None or theta is None else float(theta[index]) for index in self.roles]

    def _check_process(self) -> None:
        terms = (*self.unknown, *self.known)
        if any(term.signal not in PROCESS_SIGNALS for term in terms):
            raise UsageError(f"an equation of a linear process must have only terms of {list(PROCESS_SIGNALS)}")
        if not any(term.signal == "process_input" for term in terms):
            raise UsageError("one term must be the process_input")
        if self.relative_degree < 1 and not self.only_simulated:
            raise UsageError("the highest derivative of the output must be higher than the input's")

    @cached_property
    def process(self) -> bool:
        """True for the equation of a linear process, which has no moving fractions."""
        return any(term.signal in PROCESS_SIGNALS for term in (*self.unknown, *self.known))

    @property
    def relative_degree(self) -> int:
        """Relative degree of a process, as the highest derivative of the output minus that of the input."""
        terms = (*self.unknown, *self.known)
        return self.order - max(term.derivative for term in terms if term.signal == "process_input")

    @cached_property
    def names(self) -> tuple[str, ...]:
        return tuple(term.name or "" for term in self.unknown)

    @property
    def units(self) -> tuple[str, ...]:
        return tuple(term.unit for term in self.unknown)

    @property
    def order(self) -> int:
        return max(term.derivative for term in (*self.unknown, *self.known) if term.facts.measured)

    @cached_property
    def noisy(self) -> tuple[int, ...]:
        """Indices of the columns that carry noise, the highest derivative first. The matrix G of paper eq. 22 selects
        these columns.
        """
        columns = [i for i, term in enumerate(self.unknown) if term.noisy]
        return tuple(sorted(columns, key=lambda i: -self.unknown[i].derivative))

    @property
    def instrument_powers(self) -> tuple[int, ...]:
        """Powers of s over f(s) in the instruments, one for each entry of `noisy`. The powers fall to 1 for a machine.
        The powers fall to 0 for a process, which has a term with y itself.
        """
        lowest = 0 if self.process else 1
        return tuple(reversed(range(lowest, lowest + len(self.noisy))))

    @property
    def driving(self) -> tuple[Term, ...]:
        """Terms from which the instruments are made. For a machine, these are the known terms. For a process, the known
        terms contain the output, so that only the input remains."""
        return (Term("process_input"),) if self.process else self.known

    @property
    def leading(self) -> int:
        """Index of the leading parameter, which belongs to the highest derivative (the mass of a drive)."""
        return self.noisy[0]

    @property
    def motion(self) -> Units:
        """Units of travel, speed and force."""
        second = [term.unit for term in self.unknown if term.signal == "output" and term.derivative == 2]
        return units_by(second[0] if second else "")

    @cached_property
    def roles(self) -> tuple[int | None, ...]:
        """Index of the parameter for each role of the auxiliary model, or None if no parameter fills the role."""
        places = {term.place: i for i, term in enumerate(self.unknown)}
        body = tuple(next((places[place] for place in role if place in places), None) for role in ROLES)
        return (*body, *(i for i, term in enumerate(self.unknown) if term.shape is not None))

    @property
    def _free(self) -> list[Term]:
        return [term for term in self.unknown if term.shape is not None and term.shape.free]

    @cached_property
    def shaped(self) -> tuple[Term, ...]:
        """Terms with a shape, in the order of their roles, which follow the roles of the body."""
        return tuple(term for term in self.unknown if term.shape is not None)

    @cached_property
    def shapes(self) -> tuple[tuple[ShapeTable, bool], ...]:
        """The table of each shape, and whether the shape acts against the motion. Raises UsageError if a shape has an
        unknown parameter.
        """
        return tuple((term.shape.table(), term.signal == "friction") for term in self.shaped if term.shape is not None)

    @property
    def place_matters(self) -> bool:
        """True if a force depends on the position."""
        return self.roles[STIFFNESS] is not None or any(not term.shape.of_speed for term in self.shaped if term.shape)

    def known_at(self, further: Sequence[float] | Floats) -> Equation:
        """Return the equation with dead time, lag and shape parameters set to the values `further` (f,). All unknowns
        of the result are linear.
        """
        known, values = self, list(further)
        if self.dead_time == ESTIMATE:
            known = known.replace_dead_time(max(0.0, float(values.pop(0))))
        if self.lag == ESTIMATE:
            known = known.replace_lag(max(0.0, float(values.pop(0))))
        return known.replace_shapes(values)

    def replace_shapes(self, further: Sequence[float] | Floats) -> Equation:
        """Return the equation with the shape parameters set to the last values of `further` (f,)."""
        if not self._free:
            return self
        values = iter(further[len(further) - len(self._free) :])
        unknown = tuple(
            replace(term, shape=Stribeck(float(next(values)))) if term.shape is not None and term.shape.free else term
            for term in self.unknown
        )
        return replace(self, unknown=unknown, further=tuple(one for one in self.further if one[0] in (DEAD_TIME, LAG)))

    @cached_property
    def positive(self) -> tuple[bool, ...]:
        """Truth values (p,), True for inertia and friction, which are never negative in a machine."""
        chosen = {self.roles[role] for role in POSITIVE_ROLES}
        return tuple(
            i in chosen or (term.shape is not None and term.shape.positive) for i, term in enumerate(self.unknown)
        )

    @property
    def input_gain(self) -> float:
        """Known coefficient of the input."""
        return next(term.coefficient for term in self.known if term.signal == "input")

    @property
    def symmetric(self) -> Equation:
        """Equation whose parameters the counts determine without a simulated model. Friction is equal in both
        directions, a constant load takes up their difference, and only shapes of the place remain.
        """
        split = [term.facts.one_way for term in self.unknown]
        fast = [term.shape is not None and term.shape.of_speed for term in self.unknown]
        if not any(split) and not any(fast):
            return self
        kept = [term for term, *out in zip(self.unknown, split, fast, strict=True) if not any(out)]
        if not any(split):
            return replace(self, unknown=tuple(kept), further=())
        there = {(term.signal, term.derivative) for term in kept}
        both = (
            SYMMETRIC if self.motion is LINEAR else tuple(replace(term, unit=rotary(term.unit)) for term in SYMMETRIC)
        )
        merged = [term for term in both if (term.signal, term.derivative) not in there]
        return replace(self, unknown=(*kept, *merged), further=())

    @property
    def elastic(self) -> bool:
        """Whether a second mass follows on a spring."""
        return bool(self.second)

    def refuse_second_mass(self, what: str) -> str:
        """Return why `what`, which knows one mass, refuses the equation; empty if it has one mass."""
        way = 'estimate a two-mass axis off-line: pmfid identify with method = "fit"'
        return f"{what} knows one mass; {way}" if self.elastic else ""

    @property
    def text(self) -> str:
        """Equation in one line, for people."""
        if not self.process:
            left = [f"{term.name} {term.reads}" for term in self.unknown]
            late = DEAD_TIME if self.dead_time == ESTIMATE else f"{self.dead_time:.9g} s"
            driven = " + ".join(f"{term.coefficient:.9g} {term.reads}" for term in self.known)
            lag = LAG if self.lag == ESTIMATE else f"{self.lag:.9g} s"
            delay = (f", u from {late} before" if self.dead_time else "") + (
                f", u lagging by {lag}" if self.lag else ""
            )
            second = f" - {self.second[3][0]} twist - {self.second[4][0]} twist'" if self.elastic else ""
            return f"{' + '.join(left)} = {driven}{second}{delay}"
        # the known term is the highest derivative of the output, and terms of the input have the factor -1
        highest = Term("process_output", self.order).reads
        left, right = (
            [f"{t.name} {t.reads}".strip() for t in self.unknown if (t.coefficient < 0) == right]
            for right in (False, True)
        )
        return f"{' + '.join([highest, *left])} = {' + '.join(right)}"

    @property
    def without_simulation(self) -> str:
        """Reason why the auxiliary model cannot simulate the equation. The text is empty if the model can."""
        known = {(term.signal, term.derivative) for term in self.known}
        if self.elastic:
            return "a second mass follows on a spring, which the off-line fit estimates"
        if self.process:
            return "the equation belongs to a linear process"
        if self.roles[MASS] is None:
            return "the equation has no unknown second derivative of the output (a mass)"
        if known != {("input", 0)}:
            return "the equation has known terms in addition to the input"
        signals = {term.signal for term in self.unknown}
        if any(len(signals & {way, way.replace("for", "back")}) == 1 for way in ("forward", "forward_output")):
            return "the equation has friction in one direction only"
        return ""


def check_late(name: str, value: object) -> None:
    """Raise UsageError unless `value` is a time [s] or "estimate". `name` is the dead time or the lag."""
    number = isinstance(value, Real) and not isinstance(value, bool) and 0 <= float(value) < math.inf
    if not number and value != ESTIMATE:
        raise UsageError(f'{name} must be a time in s, at least 0, or "estimate", got {value!r}')


#: Terms that replace the terms with a direction.
SYMMETRIC = (
    Term("output", 1, "viscous_friction", "N s/m"),
    Term("direction", 0, "coulomb_friction", "N"),
    Term("moving", 0, "offset", "N"),
)

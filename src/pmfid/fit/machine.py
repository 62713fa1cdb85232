"""From the equation of a machine to the parameters of the simulated body (csrc/fit/body.h)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pmfid._body import BASE, ELASTIC_BASE, KINDS, run
from pmfid.errors import UsageError
from pmfid.models.axes import ROTARY
from pmfid.models.equation import DEAD_TIME, ESTIMATE, LAG, Equation, Term
from pmfid.models.shapes import Shape, Square, Stribeck, Wave
from pmfid.types import Floats

MASS, VISCOUS, COULOMB, OFFSET, DIRECTIONAL, DELAY, LAGGING, X0, V0 = range(BASE)
#: Further parameters of an elastic body, whose first mass has the others (csrc/fit/elastic.h).
LOAD_MASS, LOAD_VISCOUS, LOAD_COULOMB, STIFFNESS, DAMPING, TWIST, SLIP, PLAY = range(BASE, ELASTIC_BASE)

#: Share of each term of the body's first parameters. Friction in one direction is the mean of both directions and half
#: of their difference.
SHARES: dict[tuple[str, int], dict[int, float]] = {
    ("output", 2): {MASS: 1.0},
    ("output", 1): {VISCOUS: 1.0},
    ("forward_output", 1): {VISCOUS: 0.5, DIRECTIONAL: 0.5},
    ("backward_output", 1): {VISCOUS: 0.5, DIRECTIONAL: -0.5},
    ("direction", 0): {COULOMB: 1.0},
    ("forward", 0): {COULOMB: 0.5, OFFSET: 0.5},
    ("backward", 0): {COULOMB: 0.5, OFFSET: -0.5},
    ("moving", 0): {OFFSET: 1.0},
}


#: Forces of the position, and those whose sign is that of the velocity in addition.
AT_POSITION, RUBS = ("spring", "wave", "place"), ("rub", "rub_place")


@dataclass(frozen=True, eq=False)
class BodyForce:
    """A force of given form: one of `KINDS`, with the constants p and q, a table, or the number of a column. A free
    force has its constant p among the parameters. A force on the `load` acts on the second mass."""

    kind: str
    p: float = 0.0
    q: float = 0.0
    table: Floats = field(default_factory=lambda: np.zeros(1))
    column: int = 0
    free: bool = False
    load: bool = False

    def hold(self, column: int) -> BodyForce:
        """Return the force as a column of the record, with its values at the measured positions."""
        return replace(self, kind="column" if self.kind in AT_POSITION else "column_friction", column=column)

    def evaluate(self, x: Floats) -> Floats:
        """Return a force of the position at x (n,), in one direction of motion."""
        if self.kind == "spring":
            return x - self.q
        if self.kind in ("wave", "rub"):
            return np.asarray(np.sin(2 * np.pi / self.p * x + self.q))
        return np.interp(x, self.p + self.q * np.arange(self.table.size), self.table)

    def pack(self) -> tuple[int, int, bool, Floats, float, float, bool]:
        return KINDS[self.kind], self.column, self.free, self.table, self.p, self.q, self.load


@dataclass(frozen=True, eq=False)
class BodyModel:
    """Body of an equation with p parameters.

    The parameters of the body (w,) are `rest` (w,) + `lift` (w, p) theta. `lead` is the index of the mass, and
    `lowest` (p,) are the lower bounds of the parameters.
    `turn` is the length of a turn of a rotary axis, or 0. `precision` (p,) are the precisions of the parameters'
    Gaussian priors about zero; None means no prior. An `elastic` body has two masses and shows its `load` or the motor.
    `further` are the indices of its second mass, stiffness, damping and, with play, gap. Its friction contains the
    effects named in `within`.
    """

    names: tuple[str, ...]
    forces: tuple[BodyForce, ...]
    rest: Floats
    lift: Floats
    lead: int
    lowest: Floats
    turn: float = 0.0
    precision: Floats | None = field(default=None, kw_only=True)
    elastic: bool = field(default=False, kw_only=True)
    further: tuple[int, ...] = field(default=(), kw_only=True)
    within: tuple[str, ...] = field(default=(), kw_only=True)
    load: bool = field(default=False, kw_only=True)

    @property
    def base(self) -> int:
        """Number of parameters of the body before the sizes of its forces."""
        return ELASTIC_BASE if self.elastic else BASE

    @property
    def starts(self) -> tuple[int, ...]:
        """Indices of the start state among the parameters of the body."""
        return (X0, V0, TWIST, SLIP) if self.elastic else (X0, V0)

    @property
    def plays(self) -> bool:
        """Whether there is a gap between two masses."""
        return self.elastic and bool(np.any(self.lift[PLAY]))

    @property
    def logs(self) -> list[int]:
        """Indices of the parameters that the fit searches as logarithms: masses and stiffness."""
        return [self.lead, *self.further[:2]]

    def body(self, theta: Floats) -> Floats:
        """Return the parameters (w,) of the body without its start state."""
        return np.asarray(self.rest + self.lift @ theta)

    def lift_at(self, theta: Floats) -> Floats:
        """Return the derivatives (w, p) of the body's parameters, which do not depend on theta (p,)."""
        return self.lift

    @property
    def loops(self) -> int:
        """Number of the parameters of a controller, at the end of the body's parameters."""
        return 0


def force_of(term: Term, elastic: bool = False) -> BodyForce:
    """Return the force of a term with a shape, or of a spring. The gravity of an elastic body acts on its load."""
    shape, rubs = term.shape, term.signal == "friction"
    loads = elastic and str(term.name).startswith("gravity")  # gravity turns the load
    if shape is None:
        return BodyForce("spring")
    if isinstance(shape, Stribeck):
        return BodyForce("stribeck", 1.0 if shape.free else float(shape.speed), free=shape.free)
    if isinstance(shape, Square):
        return BodyForce("power", 2.0, 1.0)
    if isinstance(shape, Wave):
        return BodyForce("rub" if rubs else "wave", shape.period, np.pi / 2 if shape.cosine else 0.0, load=loads)
    return _table(shape, rubs)


def _table(shape: Shape, rubs: bool) -> BodyForce:
    table = shape.table()
    kind = "speed" if shape.of_speed else "rub_place" if rubs else "place"
    return BodyForce(kind, table.start, table.step, np.asarray(table.knots, np.float64))


def machine_of(equation: Equation) -> BodyModel:
    """Return the body of an equation. Raises UsageError for an equation that no body simulates."""
    if equation.without_simulation and not equation.elastic:
        raise UsageError(f"the motion cannot be simulated, because {equation.without_simulation}")
    shaped = [i for i, term in enumerate(equation.unknown) if term.shape is not None or term.place[:2] == ("output", 0)]
    forces = tuple(force_of(equation.unknown[i], equation.elastic) for i in shaped)
    names = equation.names + tuple(name for name, _ in equation.further)
    free = [j for j, force in enumerate(forces) if force.free]
    base = ELASTIC_BASE if equation.elastic else BASE
    lift = np.zeros((base + len(forces) + len(free), len(names)))
    for i, term in enumerate(equation.unknown):
        for row, share in SHARES.get((term.signal, term.derivative), {}).items():
            lift[row, i] = share * term.coefficient
    for j, i in enumerate(shaped):
        lift[base + j, i] = equation.unknown[i].coefficient
    for name, row in _further_rows(equation, free, shaped, base + len(forces)).items():
        lift[row, names.index(name)] = 1.0
    rest = np.zeros(len(lift))
    rest[DELAY] = 0.0 if equation.dead_time == ESTIMATE else float(equation.dead_time)
    rest[LAGGING] = 0.0 if equation.lag == ESTIMATE else float(equation.lag)
    positive = np.append(equation.positive, np.ones(len(equation.further), bool))
    lowest = np.where(positive & (np.arange(len(names)) != equation.leading), 0.0, -np.inf)
    turn = 2 * np.pi if equation.motion is ROTARY else 0.0
    rows = (LOAD_MASS, STIFFNESS, DAMPING, PLAY) if equation.elastic else ()
    further = tuple(int(np.flatnonzero(lift[row])[0]) for row in rows if np.any(lift[row]))
    lowest[list(further[:2])] = -np.inf
    fields = names, forces, rest, lift, equation.leading, lowest, turn
    return BodyModel(*fields, elastic=equation.elastic, load=equation.shows_load, further=further)


def _further_rows(equation: Equation, free: Sequence[int], shaped: Sequence[int], first: int) -> dict[str, int]:
    """Return the row of each parameter in which the motion is not linear."""
    rows = {DEAD_TIME: DELAY} if equation.dead_time == ESTIMATE else {}
    if equation.lag == ESTIMATE:
        rows[LAG] = LAGGING
    if equation.elastic:
        places = (LOAD_MASS, LOAD_VISCOUS, LOAD_COULOMB, STIFFNESS, DAMPING, PLAY)
        rows |= dict(zip((name for name, _ in equation.second), places, strict=False))
    speeds = [f"{equation.unknown[shaped[j]].name}_speed".replace("_friction", "") for j in free]
    return rows | {name: first + j for j, name in enumerate(speeds)}


@dataclass(frozen=True, eq=False)
class Excitation:
    """Input of a body over n intervals: lengths `step` (n,) [s], forces `u` (n,), `columns` (c, n) of the record, and
    the instants `row` (k,) in the result, 0 to n. With a controller, `u` are goals, `tick` is the longest part of an
    interval [s], and the controller is off where `on` (n,) is 0."""

    step: Floats
    u: Floats
    row: NDArray[np.int32]
    columns: Floats
    tick: float = 0.0
    on: Floats | None = None


def simulate(
    drive: Excitation,
    forces: Sequence[BodyForce],
    body: Floats,
    parts: int,
    lift: Floats | None = None,
    elastic: bool = False,
    load: bool = False,
    count: float = 0.0,
) -> tuple[Floats, Floats, Floats]:
    """Return positions (k,), velocities (k,) and derivatives (k, p) of the positions by coordinates, of which `lift`
    (w, p) has the derivatives of the body's parameters (w,). There are none without it.

    The positions are infinite after an overflow. A controller with a `count` of its encoder acts in ticks, at
    which `on` is 1, or -1 while it is off.
    """
    packed = [force.pack() for force in forces]
    inputs = (packed, drive.step, drive.u, drive.row, drive.columns, np.ascontiguousarray(body))
    y, v, S, _ = run(*inputs, parts, lift, drive.tick, drive.on, elastic, load, count)
    return y, v, S

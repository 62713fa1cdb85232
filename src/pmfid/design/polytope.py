"""The inputs that the limits allow."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import null_space
from scipy.optimize import lsq_linear, nnls

from pmfid.design.fisher import VELOCITY, drive_regime, node_states
from pmfid.design.problem import InfeasibleError, Problem
from pmfid.types import Floats

#: Largest violation of a limit, relative to the terms that the limit compares. The linear solver works to it.
SOLVER_PRECISION = 1e-7

#: Share of the Coulomb friction that the input may use while friction shall hold the axis.
HOLD = 0.9

#: Limits that can be relaxed, with their units, by the name that the user knows.
UNITS = {
    "input": "",
    "input_rate": "1/s",
    "position": "m",
    "velocity": "m/s",
    "acceleration": "m/s^2",
    "jerk": "m/s^3",
    "min_speed": "m/s",
    "end position": "m",
    "end velocity": "m/s",
}
FREE = (-math.inf, math.inf)

#: Limit, matrix (r, K), offset (r,), lower and upper bound of the rows lower <= matrix u + offset <= upper.
Rows = tuple[str, Floats, ArrayLike, ArrayLike, ArrayLike]


@dataclass(frozen=True, eq=False)
class InputSet:
    """The inputs u (K,) that meet all limits, which are lower <= matrix u <= upper (r,) and |u| <= radius.

    `names` (r,) has the limit of each row. `radius` comes from energy and rms, or is infinite. Nominal positions and
    velocities at the nodes are states u + offset, with `states` (2, K+1, K) and `offset` (2, K+1).
    """

    matrix: Floats
    lower: Floats
    upper: Floats
    names: tuple[str, ...]
    radius: float
    states: Floats
    offset: Floats

    @property
    def size(self) -> int:
        """Number of intervals K."""
        return int(self.matrix.shape[1])

    def excess(self, u: Floats) -> tuple[Floats, Floats]:
        """Return the amount by which u (K,) misses each row (r,), and the size of the terms that the row compares.

        The amount is negative inside the limit.
        """
        values = self.matrix @ u
        size = np.abs(self.matrix).sum(axis=1) * max(1.0, float(np.abs(u).max()))
        return np.maximum(self.lower - values, values - self.upper), size


def input_set(problem: Problem) -> InputSet:
    """Return all limits of a problem, in its nominal case and its scenarios."""
    rows = [*_input_rows(problem)]
    for case in ({}, *problem.scenarios):
        rows += _case_rows(problem, case)
    names = [name for name, matrix, *_ in rows for _ in matrix]
    offset, lower, upper = (
        np.concatenate([np.broadcast_to(row[part], len(row[1])) for row in rows]) for part in (2, 3, 4)
    )
    kept = np.isfinite(lower) | np.isfinite(upper)
    return InputSet(
        np.concatenate([matrix for _, matrix, *_ in rows])[kept],
        (lower - offset)[kept],
        (upper - offset)[kept],
        tuple(name for name, own in zip(names, kept, strict=True) if own),
        _radius(problem),
        *node_states(problem),
    )


def _radius(problem: Problem) -> float:
    limits = problem.limits
    energy = min(limits.energy or math.inf, (limits.rms or math.inf) ** 2 * problem.horizon)
    return math.sqrt(energy / problem.dt)


def _input_rows(problem: Problem) -> Iterator[Rows]:
    unit, rate = np.eye(problem.intervals), problem.limits.input_rate or math.inf
    yield ("input", unit, 0.0, *(problem.limits.pair("input") or FREE))
    yield "input_rate", (unit - np.eye(problem.intervals, k=-1)) / problem.dt, 0.0, -rate, rate


def _case_rows(problem: Problem, case: Mapping[str, float]) -> Iterator[Rows]:
    """Yield the limits of the motion with the parameters of a scenario. An empty `case` is the nominal one."""
    values = {**problem.nominal, **case}
    (x, v), (x0, v0) = node_states(problem, case)
    yield from _position_rows(problem, x, x0, nominal=not case)
    yield from _velocity_rows(problem, v, v0)
    yield from _end_rows(problem, (x[-1:], v[-1:]), (x0[-1], v0[-1]), nominal=not case)
    yield _hold_rows(problem, values)
    if problem.limits.acceleration is not None:
        yield from _acceleration_rows(problem, values, v, v0)
    if problem.limits.jerk is not None:
        yield _jerk_rows(problem, problem.limits.jerk, v, v0)


def _position_rows(problem: Problem, x: Floats, x0: Floats, *, nominal: bool) -> Iterator[Rows]:
    exact = problem.end[0] is not None and problem.end_tolerance[0] == 0
    # A motion in one direction to an exact end stays within the limits.
    if not (nominal and exact and not {1, -1} <= set(problem.sense)):
        yield ("position", x[1:], x0[1:], *(problem.limits.pair("position") or FREE))


def _velocity_rows(problem: Problem, v: Floats, v0: Floats) -> Iterator[Rows]:
    yield ("velocity", v[1:], v0[1:], *(problem.limits.pair("velocity") or FREE))
    before = np.array(problem.sense)
    rest = (before == 0) | (np.r_[before[1:], before[-1]] == 0)
    yield "rest", v[1:][rest], v0[1:][rest], 0.0, 0.0
    speed = np.full(before.size, problem.limits.min_speed)
    if problem.end[1] is not None:
        speed[-1] = 0.0
    along = before[~rest]
    yield "min_speed", along[:, None] * v[1:][~rest], along * v0[1:][~rest], speed[~rest], math.inf


def _end_rows(
    problem: Problem, last: tuple[Floats, Floats], offset: tuple[float, float], *, nominal: bool
) -> Iterator[Rows]:
    for state, name in enumerate(("end position", "end velocity")):
        wanted, tolerance = problem.end[state], problem.end_tolerance[state]
        if wanted is not None and (nominal or tolerance > 0):
            yield name, last[state], offset[state], wanted - tolerance, wanted + tolerance


def _hold_rows(problem: Problem, values: Mapping[str, float]) -> Rows:
    """Return rows that keep the input within the force that friction holds, while the axis rests."""
    rests = np.array(problem.sense) == 0
    load, force = values.get("offset", 0.0), problem.drive.equation.input_gain * np.eye(problem.intervals)[rests]
    friction = HOLD * min(value for name, value in values.items() if name.startswith("coulomb_friction"))
    return "hold", force, -load, -friction, friction


def _acceleration_rows(problem: Problem, values: Mapping[str, float], v: Floats, v0: Floats) -> Iterator[Rows]:
    """Yield the acceleration limits as rows at both ends of every interval of motion."""
    regimes = {d: drive_regime(problem.drive, values, (), d) for d in set(problem.sense)}
    A, b, g = (
        np.array([part[VELOCITY] for part in parts])
        for parts in zip(*((r.A[:, VELOCITY], r.b, r.g) for r in map(regimes.__getitem__, problem.sense)), strict=True)
    )
    moving = b != 0
    for node in (slice(None, -1), slice(1, None)):
        matrix, offset = A[:, None] * v[node] + np.diag(b), A * v0[node] + g
        yield ("acceleration", matrix[moving], offset[moving], *(problem.limits.pair("acceleration") or FREE))


def _jerk_rows(problem: Problem, jerk: float, v: Floats, v0: Floats) -> Rows:
    """Return rows for the second differences of the velocity.

    The acceleration is 0 before the start, and after an end at rest.
    """
    K = problem.intervals
    node = np.arange(K + (problem.end[1] == 0.0))
    back, ahead = np.maximum(node - 1, 0), np.minimum(node + 1, K)
    matrix, offset = ((part[back] - 2.0 * part[node] + part[ahead]) / problem.dt**2 for part in (v, v0))
    return "jerk", matrix, offset, -jerk, jerk


#: Bounds of a row that are closer than this make the row an equation, and a limit that is missed by less, relative to
#: its size, counts as met.
EQUAL = 1e-9


def violation(inputs: InputSet, u: Floats) -> float:
    """Return the amount by which u (K,) leaves the limits, relative to the size of each row. The amount is 0 if u meets
    all limits.
    """
    excess, size = inputs.excess(u)
    relative = excess / np.maximum(size, 1e-300)
    return max(0.0, float(relative.max(initial=0.0)), float(np.linalg.norm(u)) / inputs.radius - 1.0)


def violations(inputs: InputSet, u: Floats) -> dict[str, float]:
    """Return the limits that the input breaks, each with the excess in the unit of the limit."""
    broken: dict[str, float] = {}
    excess, size = inputs.excess(u)
    for i in np.flatnonzero(excess > SOLVER_PRECISION * size):
        broken[inputs.names[i]] = max(float(excess[i]), broken.get(inputs.names[i], 0.0))
    over = float(np.linalg.norm(u)) - inputs.radius
    return broken | ({"energy": over} if over > SOLVER_PRECISION * inputs.radius else {})


def nearest(inputs: InputSet, wish: Floats) -> Floats:
    """Return the input u (K,) that meets all limits and is nearest to the wish (K,) in the sum of squares.

    The problem is a least distance problem (Lawson and Hanson 1974, chapter 23). The nearest input may take more energy
    than allowed. In this case the result is the first input with allowed energy on the way from the nearest input to
    the input of least energy. Raises InfeasibleError if no input meets the limits.
    """
    u = nearest_of_any_energy(inputs, wish)
    if np.linalg.norm(u) <= inputs.radius:
        return u
    least = nearest_of_any_energy(inputs, np.zeros(len(wish)))
    if np.linalg.norm(least) > inputs.radius:
        raise InfeasibleError(
            "every input within the other limits exceeds the limit energy or rms; raise the limit energy or rms"
        )
    return retreat(inputs, least, u)


def retreat(inputs: InputSet, centre: Floats, u: Floats) -> Floats:
    """Return the last input on the way from the centre (K,) to u (K,) with no more energy than allowed."""
    d = u - centre
    a, b, c = (float(v) for v in (d @ d, d @ centre, centre @ centre - inputs.radius**2))
    part = (-b + math.sqrt(max(0.0, b * b - a * c))) / a
    return np.asarray(centre + d * max(0.0, part))


def nearest_of_any_energy(inputs: InputSet, wish: Floats) -> Floats:
    """Return the input that is nearest to the wished input, without the limit of energy.

    The input is u = wish + base + Z d with the least norm of d, where `base` meets the equations.
    """
    equal = inputs.upper - inputs.lower <= EQUAL
    E, f = inputs.matrix[equal], inputs.upper[equal] - inputs.matrix[equal] @ wish
    base, Z = (np.linalg.lstsq(E, f)[0], null_space(E)) if len(E) else (np.zeros(len(wish)), np.eye(len(wish)))
    up, down = np.isfinite(inputs.upper) & ~equal, np.isfinite(inputs.lower) & ~equal
    A = np.vstack([inputs.matrix[up], -inputs.matrix[down]])
    b = np.r_[inputs.upper[up], -inputs.lower[down]]
    size = np.linalg.norm(A @ Z, axis=1)
    free = size > EQUAL * np.linalg.norm(A, axis=1)  # the other rows are constant where the equations hold
    G, h = -(A @ Z)[free] / size[free, None], (A @ (wish + base) - b)[free] / size[free]
    return np.asarray(wish + base + Z @ _least_distance(G, h))


def _least_distance(G: Floats, h: Floats) -> Floats:
    """Return the vector d of least norm with G d >= h, where the rows of G have unit length."""
    size = float(h.max(initial=0.0))
    if size <= 0.0:
        return np.zeros(G.shape[1])
    # The largest shortfall is the unit. If no such d exists, the residual is then 0 and not 1 / (1 + |d|^2).
    return size * _least_distance_of_one(G, h / size)


def _least_distance_of_one(G: Floats, h: Floats) -> Floats:
    """Return the vector d of least norm with G d >= h, where the largest entry of h is 1.

    If limits of position and velocity coincide next to a standstill, the active set of `nnls` may become singular. In
    this case the result of `nnls` is no minimum. The result is therefore checked, and computed in another way if the
    check fails.
    """
    matrix, wanted = np.vstack([G.T, h]), np.r_[np.zeros(G.shape[1]), 1.0]
    try:
        d = _distance_of_dual(G, h, nnls(matrix, wanted)[0])
        if np.max(h - G @ d) <= EQUAL:
            return d
    except RuntimeError:
        pass
    return _distance_of_dual(G, h, lsq_linear(matrix, wanted, (0.0, np.inf), method="bvls", tol=1e-15).x)


def _distance_of_dual(G: Floats, h: Floats, y: Floats) -> Floats:
    residual = np.r_[G.T @ y, h @ y - 1.0]
    if abs(residual[-1]) < EQUAL:
        raise InfeasibleError("no input meets all limits; relax one of them")
    return np.asarray(-residual[:-1] / residual[-1])

"""The inputs that the limits allow."""

from __future__ import annotations

import math
from dataclasses import dataclass

import highspy
import numpy as np
from scipy.linalg import null_space
from scipy.optimize import nnls
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import spsolve

from pmfid.design.fisher import VELOCITY, Regime, StateStep, discretise, drive_regime
from pmfid.design.problem import InfeasibleError, Problem
from pmfid.types import Floats

__all__ = ["least_norm", "model"]

#: The primal simplex goes on from the last vertex when the objective changes.
OPTIONS: dict[str, bool | int | str] = {
    "output_flag": False,
    "threads": 1,
    "presolve": "off",
    "simplex_strategy": 4,
}


def model(matrix: csc_matrix, lower: Floats, upper: Floats, low: Floats, high: Floats) -> highspy.Highs:
    """HiGHS with lower <= matrix z <= upper, low <= z <= high and no objective yet."""
    lp = highspy.HighsLp()
    lp.num_row_, lp.num_col_ = matrix.shape
    lp.col_cost_ = np.zeros(lp.num_col_)
    lp.col_lower_, lp.col_upper_ = low, high
    lp.row_lower_, lp.row_upper_ = lower, upper
    lp.a_matrix_.format_ = highspy.MatrixFormat.kColwise
    lp.a_matrix_.start_, lp.a_matrix_.index_ = matrix.indptr, matrix.indices
    lp.a_matrix_.value_ = matrix.data
    highs = highspy.Highs()  # type: ignore[no-untyped-call]
    for name, value in OPTIONS.items():
        highs.setOptionValue(name, value)
    highs.passModel(lp)
    return highs


def least_norm(G: Floats, h: Floats) -> Floats:
    """d (n,) of least norm with G d >= h, (m, n) and (m,), by the quadratic solver of HiGHS, to 1e-6.

    Raises InfeasibleError if there is none.
    """
    n = G.shape[1]
    highs = model(csc_matrix(G), h, np.full(len(h), np.inf), np.full(n, -np.inf), np.full(n, np.inf))
    hessian = highspy.HighsHessian()
    hessian.dim_, hessian.format_ = n, highspy.HessianFormat.kTriangular
    hessian.start_, hessian.index_, hessian.value_ = np.arange(n + 1), np.arange(n), np.ones(n)
    highs.passHessian(hessian)
    highs.run()
    if highs.getModelStatus() != highspy.HighsModelStatus.kOptimal:
        raise InfeasibleError("no input meets all limits; relax one of them")
    return np.array(highs.getSolution().col_value)


#: Share of the Coulomb friction that the input may use while friction is to hold the axis.
HOLD = 0.9

#: Limits that can be relaxed, by the name under which a user finds them, and their units.
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

Terms = dict[int, float]

FREE = (-math.inf, math.inf)


@dataclass(frozen=True, eq=False)
class Polytope:
    """lower <= matrix z <= upper, z = (u (K,), then node states); row i belongs to the limit names[i].

    radius: bound of the Euclidean norm of u from energy and rms, or inf.
    """

    matrix: csc_matrix
    lower: Floats
    upper: Floats
    names: tuple[str, ...]
    inputs: int
    radius: float


class _Rows:
    """Collects rows; columns of the node states of one scenario after another."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.terms: list[Terms] = []
        self.bounds: list[tuple[float, float]] = []
        self.names: list[str] = []

    def add(self, name: str, terms: Terms, lower: float, upper: float) -> None:
        if math.isfinite(lower) or math.isfinite(upper):
            self.terms.append(terms)
            self.bounds.append((lower, upper))
            self.names.append(name)

    def column(self, case: int, node: int, state: int) -> int:
        """Column of a state at a node >= 1 of a scenario."""
        K = self.problem.intervals
        return K + case * 2 * K + 2 * (node - 1) + state

    def state(self, case: int, node: int, state: int, factor: float = 1.0) -> tuple[Terms, float]:
        """A state as (terms, constant): the start is known."""
        if node == 0:
            return {}, factor * self.problem.start[state]
        return {self.column(case, node, state): factor}, 0.0

    def build(self) -> Polytope:
        size = self.problem.intervals * (1 + 2 * (1 + len(self.problem.scenarios)))
        rows = [i for i, terms in enumerate(self.terms) for _ in terms]
        columns = [column for terms in self.terms for column in terms]
        values = [value for terms in self.terms for value in terms.values()]
        matrix = csc_matrix((values, (rows, columns)), shape=(len(self.terms), size))
        lower, upper = np.array(self.bounds).T
        return Polytope(matrix, lower, upper, tuple(self.names), self.problem.intervals, _radius(self.problem))


def polytope(problem: Problem) -> Polytope:
    """All limits of a problem, in its nominal case and its scenarios."""
    rows = _Rows(problem)
    _input_rows(rows)
    cases = ({}, *problem.scenarios)
    for case, parameters in enumerate(cases):
        values = {**problem.nominal, **parameters}
        regimes = {d: drive_regime(problem.drive, values, (), d) for d in set(problem.sense)}
        steps = {d: discretise(regime, problem.dt) for d, regime in regimes.items()}
        _motion_rows(rows, case, [steps[d] for d in problem.sense])
        _state_rows(rows, case)
        _hold_rows(rows, values)
        if problem.limits.acceleration is not None:
            _acceleration_rows(rows, case, [regimes[d] for d in problem.sense])
        if problem.limits.jerk is not None:
            _jerk_rows(rows, case, problem.limits.jerk)
    return rows.build()


def _radius(problem: Problem) -> float:
    limits = problem.limits
    energy = min(limits.energy or math.inf, (limits.rms or math.inf) ** 2 * problem.horizon)
    return math.sqrt(energy / problem.dt)


def _input_rows(rows: _Rows) -> None:
    problem = rows.problem
    lower, upper = problem.limits.pair("input") or FREE
    rate = problem.limits.input_rate or math.inf
    for k in range(problem.intervals):
        rows.add("input", {k: 1.0}, lower, upper)
        change = {k: 1.0 / problem.dt} | ({k - 1: -1.0 / problem.dt} if k else {})
        rows.add("input_rate", change, -rate, rate)


def _hold_rows(rows: _Rows, values: dict[str, float]) -> None:
    """While the axis rests, the input stays within what friction holds."""
    gain, load = rows.problem.drive.equation.input_gain, values.get("offset", 0.0)
    friction = [v for name, v in values.items() if name.startswith("coulomb_friction")]
    for k, direction in enumerate(rows.problem.sense):
        if direction == 0:
            rows.add("hold", {k: gain}, load - HOLD * min(friction), load + HOLD * min(friction))


def _motion_rows(rows: _Rows, case: int, steps: list[StateStep]) -> None:
    for k, step in enumerate(steps):
        for i in range(2):
            terms: Terms = {rows.column(case, k + 1, i): 1.0}
            constant = float(step.g[i])
            for j in range(2):
                if step.A[i, j]:
                    more, known = rows.state(case, k, j, -float(step.A[i, j]))
                    terms |= more
                    constant -= known
            if step.b[i]:
                terms[k] = -float(step.b[i])
            rows.add("motion", terms, constant, constant)


def _state_rows(rows: _Rows, case: int) -> None:
    problem, limits = rows.problem, rows.problem.limits
    K, sense = problem.intervals, problem.sense
    implied = case == 0 and problem.end[0] is not None and problem.end_tolerance[0] == 0 and not {1, -1} <= set(sense)
    for k in range(1, K + 1):
        velocity = {rows.column(case, k, 1): 1.0}
        if not implied:
            rows.add("position", {rows.column(case, k, 0): 1.0}, *(limits.pair("position") or FREE))
        rows.add("velocity", velocity, *(limits.pair("velocity") or FREE))
        around = {sense[k - 1], sense[min(k, K - 1)]}
        if 0 in around:
            rows.add("rest", velocity, 0.0, 0.0)
        elif k < K or problem.end[1] is None:
            _speed_row(rows, velocity, sense[k - 1], limits.min_speed)
        else:
            _speed_row(rows, velocity, sense[k - 1], 0.0)
    for state, name in enumerate(("end position", "end velocity")):
        wanted, tolerance = problem.end[state], problem.end_tolerance[state]
        if wanted is not None and (case == 0 or tolerance > 0):
            rows.add(name, {rows.column(case, K, state): 1.0}, wanted - tolerance, wanted + tolerance)


def _speed_row(rows: _Rows, velocity: Terms, direction: int, speed: float) -> None:
    rows.add("min_speed", {column: float(direction) for column in velocity}, speed, math.inf)


def _acceleration_rows(rows: _Rows, case: int, regimes: list[Regime]) -> None:
    lower, upper = rows.problem.limits.pair("acceleration") or FREE
    for k, regime in enumerate(regimes):
        if not regime.b[VELOCITY]:
            continue  # at rest
        for node in (k, k + 1):
            terms, constant = rows.state(case, node, VELOCITY, float(regime.A[VELOCITY, VELOCITY]))
            terms = {**terms, k: float(regime.b[VELOCITY])}
            constant += float(regime.g[VELOCITY])
            rows.add("acceleration", terms, lower - constant, upper - constant)


def _jerk_rows(rows: _Rows, case: int, jerk: float) -> None:
    """Second differences of the velocity; before the start, and after an end at rest, the acceleration is 0."""
    K, dt2 = rows.problem.intervals, rows.problem.dt**2
    last = K if rows.problem.end[1] == 0.0 else K - 1
    for k in range(last + 1):
        terms: Terms = {}
        constant = 0.0
        for node, factor in ((max(k - 1, 0), 1.0), (k, -2.0), (min(k + 1, K), 1.0)):
            more, known = rows.state(case, node, VELOCITY, factor / dt2)
            for column, value in more.items():
                terms[column] = terms.get(column, 0.0) + value
            constant += known
        rows.add("jerk", terms, -jerk - constant, jerk - constant)


#: Bounds of a row that are closer than this make it an equation.
EQUAL = 1e-9
#: A row that is missed by less, relative to the largest shortfall, is met.
MET = 1e-9


@dataclass(frozen=True, eq=False)
class InputSet:
    """lower <= matrix u <= upper (r,) and |u| <= rows.radius: the inputs u (K,) that meet all limits.

    names (r,): the limit of each row. position (K, K), position_offset (K,): nominal positions at nodes 1 to K =
    position u + position_offset; velocity likewise.
    """

    rows: Polytope
    matrix: Floats
    lower: Floats
    upper: Floats
    names: tuple[str, ...]
    position: Floats
    position_offset: Floats
    velocity: Floats
    velocity_offset: Floats


def input_set(rows: Polytope) -> InputSet:
    """The polytope without its states, which the rows named "motion" give from the input."""
    K, motion = rows.inputs, np.array([name == "motion" for name in rows.names])
    here, there = rows.matrix[:, :K], rows.matrix[:, K:].tocsr()
    right = np.column_stack([-here[motion].toarray(), rows.lower[motion]])
    states = np.asarray(spsolve(there[motion].tocsc(), right)).reshape(there.shape[1], K + 1)
    offset = there[~motion] @ states[:, K]
    return InputSet(
        rows,
        here[~motion].toarray() + there[~motion] @ states[:, :K],
        rows.lower[~motion] - offset,
        rows.upper[~motion] - offset,
        tuple(name for name in rows.names if name != "motion"),
        *(part for i in range(2) for part in (states[i : 2 * K : 2, :K], states[i : 2 * K : 2, K])),
    )


def violation(inputs: InputSet, u: Floats) -> float:
    """By how much u (K,) leaves the limits, relative to the size of each row; 0 if it meets all."""
    value = inputs.matrix @ u
    size = np.abs(inputs.matrix).sum(axis=1) * max(1.0, float(np.abs(u).max()))
    excess = np.maximum(inputs.lower - value, value - inputs.upper) / np.maximum(size, 1e-300)
    return max(0.0, float(excess.max(initial=0.0)), float(np.linalg.norm(u)) / inputs.rows.radius - 1.0)


def nearest(inputs: InputSet, wish: Floats) -> Floats:
    """u (K,) that meets all limits and is nearest to the wish (K,) in the sum of squares.

    A least distance problem (Lawson and Hanson 1974, chapter 23). Where the nearest takes more energy than allowed: the
    first input that does not, on the way to the one of least energy.
    Raises InfeasibleError if no input meets the limits.
    """
    u = _nearest(inputs, wish)
    if np.linalg.norm(u) <= inputs.rows.radius:
        return u
    least = _nearest(inputs, np.zeros(len(wish)))
    step = u - least
    a, b, c = step @ step, least @ step, least @ least - inputs.rows.radius**2
    if c > 0:
        raise InfeasibleError("the energy that the limits need is more than they allow; raise energy or rms")
    return np.asarray(least + step * (-b + np.sqrt(b * b - a * c)) / a)


def _nearest(inputs: InputSet, wish: Floats) -> Floats:
    """The same without the limit of energy: least norm of d where u = wish + base + Z d, the equations met by base."""
    equal = inputs.upper - inputs.lower <= EQUAL
    E, f = inputs.matrix[equal], inputs.upper[equal] - inputs.matrix[equal] @ wish
    base, Z = (np.linalg.lstsq(E, f)[0], null_space(E)) if len(E) else (np.zeros(len(wish)), np.eye(len(wish)))
    up, down = np.isfinite(inputs.upper) & ~equal, np.isfinite(inputs.lower) & ~equal
    A = np.vstack([inputs.matrix[up], -inputs.matrix[down]])
    b = np.r_[inputs.upper[up], -inputs.lower[down]]
    size = np.linalg.norm(A @ Z, axis=1)
    free = size > EQUAL * np.linalg.norm(A, axis=1)  # the others are constant where the equations hold
    G, h = -(A @ Z)[free] / size[free, None], (A @ (wish + base) - b)[free] / size[free]
    return np.asarray(wish + base + Z @ _least_distance(G, h))


def _least_distance(G: Floats, h: Floats) -> Floats:
    """d of least norm with G d >= h, rows of G of unit length."""
    size = float(h.max(initial=0.0))
    if size <= 0.0:
        return np.zeros(G.shape[1])
    # in units of the largest shortfall: if no such d exists, the residual is 0 and not 1 / (1 + |d|^2)
    return size * _least_distance_of_one(G, h / size)


def _least_distance_of_one(G: Floats, h: Floats) -> Floats:
    """The same for a largest h of 1.

    If limits of position and velocity coincide next to a standstill, the active set of `nnls` may become singular. Its
    result is then no minimum. So the result is checked, and computed in another way if the check fails.
    """
    try:
        y, _ = nnls(np.vstack([G.T, h]), np.r_[np.zeros(G.shape[1]), 1.0])
    except RuntimeError:
        return least_norm(G, h)
    residual = np.r_[G.T @ y, h @ y - 1.0]
    if abs(residual[-1]) < EQUAL:
        raise InfeasibleError("no input meets all limits; relax one of them")
    d = np.asarray(-residual[:-1] / residual[-1])
    return d if (h - G @ d).max() <= MET else least_norm(G, h)

"""The inputs that meet all limits, as rows of a linear program over inputs and node states.

With the input held and the direction given, position and velocity are monotone inside an interval, so that limits at
the nodes are exact; the acceleration is monotone as well and is limited at both ends of each interval.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_matrix

from pmfid.design.problem.dynamics import VELOCITY, Regime, StateStep, discretise, drive_regime
from pmfid.design.problem.problem import Problem
from pmfid.types import Floats

__all__ = ["UNITS", "Polytope", "polytope"]

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

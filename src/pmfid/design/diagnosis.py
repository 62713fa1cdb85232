"""Why no input meets the limits: which one to relax and by how much, and the least time for the motion."""

from __future__ import annotations

from dataclasses import replace
from typing import NoReturn

import highspy
import numpy as np
from scipy.sparse import csc_matrix, hstack

from pmfid.design.nearest import input_set, nearest
from pmfid.design.oracle import Oracle, model
from pmfid.design.polytope import UNITS, Polytope, polytope
from pmfid.design.problem import InfeasibleError, Problem, Relaxation

__all__ = ["minimum_time", "raise_infeasible", "relaxations"]


def raise_infeasible(problem: Problem) -> NoReturn:
    """Raises InfeasibleError that says which single limit to relax, and by how much, or the minimum time."""
    ways = relaxations(problem)
    horizon = minimum_time(problem)
    if horizon is not None:
        ways = (Relaxation("horizon", problem.horizon, horizon, "s"), *ways)
    if not ways:
        raise InfeasibleError("no input meets all limits, and relaxing one alone does not help; check start and end")
    least = f"; the least time is {horizon:.4g} s" if horizon is not None else ""
    raise InfeasibleError(f"no input meets all limits{least}; relax one of: {'; '.join(map(str, ways))}", ways)


def relaxations(problem: Problem) -> tuple[Relaxation, ...]:
    """For each limit that alone, if relaxed, makes the problem feasible: its needed value; smallest change first."""
    shape = polytope(problem)
    found = []
    for name in UNITS:
        amount = _least_widening(shape, name)
        if amount is not None:
            found.append(_relaxed(problem, name, amount))
    found += _energy(problem, shape)
    return tuple(sorted(found, key=lambda way: abs(way.needed - way.value) / max(abs(way.value), 1e-9)))


def minimum_time(problem: Problem, longest: float = 64.0) -> float | None:
    """Shortest feasible horizon [s] with as many intervals, to 0.1 %; None where `longest` times it is not enough."""
    low, high = problem.horizon, problem.horizon
    while not _feasible(replace(problem, horizon=high)):
        low, high = high, 2.0 * high
        if high > longest * problem.horizon:
            return None
    if low == high:
        while _feasible(replace(problem, horizon=low)):
            low, high = low / 2.0, low
            if high < problem.horizon / longest:
                return high
    while high > 1.001 * low:
        middle = (low * high) ** 0.5
        low, high = (low, middle) if _feasible(replace(problem, horizon=middle)) else (middle, high)
    return high


def _feasible(problem: Problem) -> bool:
    return Oracle(polytope(problem)).feasible()


def _least_widening(shape: Polytope, name: str) -> float | None:
    """Least amount by which the bounds of one limit must move apart, or None where that does not help."""
    rows = np.array([row == name for row in shape.names])
    lower, upper = rows & np.isfinite(shape.lower), rows & np.isfinite(shape.upper)
    if not rows.any():
        return None
    # each bounded side of the limit gets its own row: a' z + r >= lower, a' z - r <= upper
    order = np.r_[np.flatnonzero(~rows), np.flatnonzero(lower), np.flatnonzero(upper)]
    matrix = csc_matrix(shape.matrix.tocsr()[order])
    slack = np.r_[np.zeros((~rows).sum()), np.ones(lower.sum()), -np.ones(upper.sum())]
    low = np.r_[shape.lower[~rows], shape.lower[lower], np.full(upper.sum(), -np.inf)]
    high = np.r_[shape.upper[~rows], np.full(lower.sum(), np.inf), shape.upper[upper]]
    columns = matrix.shape[1]
    highs = model(
        csc_matrix(hstack([matrix, slack[:, None]])),
        low,
        high,
        np.r_[np.full(columns, -np.inf), 0.0],
        np.full(columns + 1, np.inf),
    )
    highs.changeColCost(columns, 1.0)
    highs.setOptionValue("presolve", "on")
    highs.run()
    if highs.getModelStatus() != highspy.HighsModelStatus.kOptimal:
        return None
    return float(highs.getInfo().objective_function_value)


def _relaxed(problem: Problem, name: str, amount: float) -> Relaxation:
    if name.startswith("end "):
        state = name == "end velocity"
        # which way the end would have to move is not unique: its tolerance is
        value = problem.end_tolerance[state]
        return Relaxation(f"end_tolerance ({name[4:]})", value, value + amount, UNITS[name])
    if name == "min_speed":
        return Relaxation(name, problem.limits.min_speed, problem.limits.min_speed - amount, UNITS[name])
    pair = problem.limits.pair(name)
    value = pair[1] if pair else 0.0
    return Relaxation(name, value, value + amount, UNITS[name])


def _energy(problem: Problem, shape: Polytope) -> list[Relaxation]:
    """The energy that is needed, where the other limits can be met."""
    if not np.isfinite(shape.radius):
        return []
    try:
        u = nearest(input_set(replace(shape, radius=np.inf)), np.zeros(shape.inputs))
    except InfeasibleError:
        return []
    needed = float(u @ u) * problem.dt
    ways = (("energy", problem.limits.energy, needed), ("rms", problem.limits.rms, (needed / problem.horizon) ** 0.5))
    return [Relaxation(name, value, more, "") for name, value, more in ways if value is not None and more > value]

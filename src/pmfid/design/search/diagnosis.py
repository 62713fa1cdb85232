"""Why no input meets the limits: which one to relax and by how much, and the least time for the motion."""

from __future__ import annotations

from dataclasses import replace
from typing import NoReturn

import highspy
import numpy as np
from scipy.sparse import csc_matrix, hstack

from pmfid.design.problem.problem import InfeasibleError, Problem, Relaxation
from pmfid.design.search.highs import model
from pmfid.design.search.nearest import input_set, nearest
from pmfid.design.search.oracle import Oracle
from pmfid.design.search.polytope import UNITS, Polytope, polytope

__all__ = ["minimum_time", "raise_infeasible", "relaxations"]

#: A smaller change is none.
LEAST = 1e-9


def raise_infeasible(problem: Problem) -> NoReturn:
    """Raises InfeasibleError that says which limits to relax, and by how much, or the minimum time."""
    ways = relaxations(problem)
    horizon = minimum_time(problem)
    if horizon is not None:
        ways = (Relaxation("horizon", problem.horizon, horizon, "s"), *ways)
    if not ways:
        ways = _together(problem)
        several = "; ".join(map(str, ways)) or "nothing was found that helps: check start, end and directions"
        raise InfeasibleError(f"no input meets all limits; relax together: {several}", ways)
    least = f"; the least time is {horizon:.4g} s" if horizon is not None else ""
    raise InfeasibleError(f"no input meets all limits{least}; relax one of: {'; '.join(map(str, ways))}", ways)


def relaxations(problem: Problem) -> tuple[Relaxation, ...]:
    """For each limit that alone, if relaxed, makes the problem feasible: its needed value; smallest change first."""
    shape = polytope(problem)
    found = list(_energy(problem, shape))
    for name in UNITS:
        amounts = _least_widening(problem, shape, (name,))
        if amounts is not None and amounts[0] > LEAST:
            found.append(_make_relaxation(problem, name, amounts[0]))
    found = [way for way in found if way.needed >= 0]
    return tuple(sorted(found, key=lambda way: abs(way.needed - way.value) / max(abs(way.value), 1e-9)))


def _together(problem: Problem) -> tuple[Relaxation, ...]:
    """Limits that help if all of them are relaxed, the sum of their relative changes being the least."""
    names = tuple(UNITS)
    amounts = _least_widening(problem, polytope(problem), names)
    if amounts is None:
        return ()
    return tuple(
        _make_relaxation(problem, name, amount) for name, amount in zip(names, amounts, strict=True) if amount > LEAST
    )


def minimum_time(problem: Problem, longest: float = 64.0) -> float | None:
    """Shortest feasible horizon [s] with as many intervals, to 0.1 %; None if `longest` times it is not enough."""
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


def _least_widening(problem: Problem, shape: Polytope, names: tuple[str, ...]) -> list[float] | None:
    """Least amounts by which the bounds of some limits must move apart, or None if that does not help.

    a' z + r >= lower, a' z - r <= upper, with one r for each limit.
    """
    which = np.array([names.index(name) if name in names else -1 for name in shape.names])
    soft = which >= 0
    if not soft.any():
        return None
    lower, upper = soft & np.isfinite(shape.lower), soft & np.isfinite(shape.upper)
    order = np.r_[np.flatnonzero(~soft), np.flatnonzero(lower), np.flatnonzero(upper)]
    sign = np.r_[np.zeros((~soft).sum()), np.ones(lower.sum()), -np.ones(upper.sum())]
    slack = sign[:, None] * (which[order][:, None] == np.arange(len(names)))
    columns = shape.matrix.shape[1]
    highs = model(
        csc_matrix(hstack([shape.matrix.tocsr()[order], csc_matrix(slack)])),
        np.where(sign < 0, -np.inf, shape.lower[order]),
        np.where(sign > 0, np.inf, shape.upper[order]),
        np.r_[np.full(columns, -np.inf), np.zeros(len(names))],
        np.full(columns + len(names), np.inf),
    )
    for i, name in enumerate(names):
        highs.changeColCost(columns + i, 1.0 / max(abs(_make_relaxation(problem, name, 0.0).value), 1e-2))
    highs.setOptionValue("presolve", "on")
    highs.run()
    if highs.getModelStatus() != highspy.HighsModelStatus.kOptimal:
        return None
    return [float(r) for r in highs.getSolution().col_value[columns:]]


def _make_relaxation(problem: Problem, name: str, amount: float) -> Relaxation:
    if name.startswith("end "):
        state = name == "end velocity"
        # which way the end would have to move is not unique: its tolerance is
        value = problem.end_tolerance[state]
        return Relaxation(f"end_tolerance ({name[4:]})", value, value + amount, UNITS[name])
    if name == "min_speed":
        return Relaxation(name, problem.limits.min_speed, problem.limits.min_speed - amount, UNITS[name])
    pair = getattr(problem.limits, name)
    value = float(pair[1] if isinstance(pair, tuple) else pair or 0.0)
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

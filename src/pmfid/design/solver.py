"""The search for the best input, the evaluation of an input, and the reason if no input is feasible."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import Bounds, LinearConstraint, milp

from pmfid.design.ascent import Climber
from pmfid.design.bounds import upper_bound
from pmfid.design.fisher import Affine, Criterion, affine, check_identifiable, criterion_of, eliminate, motion
from pmfid.design.oracle import Oracle
from pmfid.design.polytope import EQUAL, UNITS, InputSet, input_set, nearest_of_any_energy, violations
from pmfid.design.problem import Design, InfeasibleError, Problem, Relaxation
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.types import Floats

#: Relative difference of the criterion within which a start counts as having reached the best.
SOLVER_REACHED = 1e-3

__all__ = ["Setting", "evaluate", "setting"]


@dataclass(frozen=True, eq=False)
class Setting:
    """A problem with the data of a search, which are the maps, the criterion and the limits' rows."""

    problem: Problem
    maps: Affine
    rule: Criterion
    inputs: InputSet

    def value(self, u: Floats) -> float:
        """Return the criterion of an input (K,)."""
        return self.rule.value(self.maps.information(u))

    def design(self, u: Floats) -> Design:
        """Return a design with the input, its motion, its information and its value."""
        x, v = motion(self.problem, u)
        broken = violations(self.inputs, u)
        warnings = [f"breaks {name} by {amount:.3g}" for name, amount in broken.items()]
        if not broken and _parks(self.problem, v):
            warnings.append("the motion parks at standstill, where no information is real; set min_speed above 0")
        nominal = self.maps
        fisher = eliminate(nominal.information(u) / np.outer(nominal.scale, nominal.scale), self.rule.size)[0]
        common = (self.problem, self.rule.name, self.problem.t, u, x, v, fisher, self.value(u))
        return Design(*common, feasible=not broken, warnings=tuple(warnings))


def setting(problem: Problem, criterion: str) -> Setting:
    """Prepare a problem for a search. Raises UsageError for an unknown criterion or a wrong combination."""
    rule = criterion_of(problem, criterion)
    return Setting(problem, affine(problem), rule, input_set(problem))


def evaluate(problem: Problem, u: ArrayLike, criterion: str = "D") -> Design:
    """Evaluate a given input.

    Parameters
    ----------
    problem
        Problem for which the input is evaluated.
    u
        (K,) input [V], one value per interval.
    criterion
        Name of the criterion: "trace", "D", "A", "E", "ME" or "c".

    Returns
    -------
    Design
        Motion and information; `feasible` and `warnings` say which limits the input breaks.

    Raises
    ------
    UsageError
        If an argument is wrong.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import Drive
    >>> from pmfid.design import Limits, Problem, evaluate
    >>> nominal = {"mass": 1.5, "viscous_friction": 6.0, "coulomb_friction": 0.6}
    >>> problem = Problem(Drive(2.0), nominal, ("mass",), 2.0, 10, Limits(input=3.0), resolution=1e-5)
    >>> evaluate(problem, np.full(10, 2.0)).feasible, evaluate(problem, np.full(10, 4.0)).feasible
    (True, False)
    """
    return setting(problem, criterion).design(np.asarray(u, float))


def _parks(problem: Problem, v: Floats) -> bool:
    """Return whether the axis stands at a node between two intervals of motion."""
    sense = np.array(problem.sense)
    inside = v[1:-1][(sense[:-1] != 0) & (sense[1:] != 0)]
    return bool(len(inside)) and bool(np.abs(inside).min() < 1e-6 * max(1e-300, np.abs(v).max()))


def raise_infeasible(problem: Problem) -> NoReturn:
    """Raise InfeasibleError with the limits to relax and their needed values, or with the minimum time."""
    ways = relaxations(problem)
    horizon = minimum_time(problem)
    if horizon is not None:
        ways = (Relaxation("horizon", problem.horizon, horizon, "s"), *ways)
    if not ways:
        ways = _together(problem)
        if not ways:
            raise InfeasibleError("no input meets all limits, however wide; check start, end and directions")
        several = "; ".join(map(str, ways))
        raise InfeasibleError(f"no input meets all limits; relax these limits together: {several}", ways)
    least = f"; the least time is {horizon:.4g} s" if horizon is not None else ""
    raise InfeasibleError(f"no input meets all limits{least}; relax one of: {'; '.join(map(str, ways))}", ways)


def relaxations(problem: Problem) -> tuple[Relaxation, ...]:
    """Return the changes of one limit that make the problem feasible, smallest change first.

    Each returned limit has its needed value.
    """
    inputs = input_set(problem)
    found = _energy(problem, inputs)
    for name in UNITS:
        amounts = _least_widening(problem, inputs, (name,))
        if amounts is not None and amounts[0] > EQUAL:
            found.append(_make_relaxation(problem, name, amounts[0]))
    found = [way for way in found if way.needed >= 0]
    return tuple(sorted(found, key=lambda way: abs(way.needed - way.value) / max(abs(way.value), 1e-9)))


def _together(problem: Problem) -> tuple[Relaxation, ...]:
    """Return the limits that help if all of them are relaxed, with the least sum of relative changes."""
    names = tuple(UNITS)
    amounts = _least_widening(problem, input_set(problem), names)
    if amounts is None:
        return ()
    return tuple(
        _make_relaxation(problem, name, amount) for name, amount in zip(names, amounts, strict=True) if amount > EQUAL
    )


def minimum_time(problem: Problem, longest: float = 64.0) -> float | None:
    """Return the shortest feasible horizon [s] to 0.1 %, for an unchanged number of intervals.

    The result is None if even `longest` times the horizon is not enough.
    """
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
    return Oracle(input_set(problem)).feasible()


def _least_widening(problem: Problem, inputs: InputSet, names: tuple[str, ...]) -> Floats | None:
    """Return the least amounts by which the bounds of some limits must move apart, or None if no amount helps.

    The rows are a' u + r >= lower and a' u - r <= upper, with one r for each limit.
    """
    slack = np.array(inputs.names)[:, None] == np.array(names)
    if not slack.any():
        return None
    cost = [1.0 / max(abs(_make_relaxation(problem, name, 0.0).value), 1e-2) for name in names]
    found = milp(
        np.r_[np.zeros(inputs.size), cost],
        constraints=[
            LinearConstraint(np.hstack([inputs.matrix, slack]), lb=inputs.lower),
            LinearConstraint(np.hstack([inputs.matrix, -1.0 * slack]), ub=inputs.upper),
        ],
        bounds=Bounds(np.r_[np.full(inputs.size, -np.inf), np.zeros(len(names))]),
    )
    return None if found.x is None else np.asarray(found.x[inputs.size :])


def _make_relaxation(problem: Problem, name: str, amount: float) -> Relaxation:
    if name.startswith("end "):
        state = name == "end velocity"
        # The end could move in two directions, so the relaxation concerns the tolerance of the end.
        value = problem.end_tolerance[state]
        return Relaxation(f"end_tolerance ({name[4:]})", value, value + amount, UNITS[name])
    if name == "min_speed":
        return Relaxation(name, problem.limits.min_speed, problem.limits.min_speed - amount, UNITS[name])
    pair = getattr(problem.limits, name)
    value = float(pair[1] if isinstance(pair, tuple) else pair or 0.0)
    return Relaxation(name, value, value + amount, UNITS[name])


def _energy(problem: Problem, inputs: InputSet) -> list[Relaxation]:
    """Return the energy that the motion needs, if the other limits can be met."""
    if not np.isfinite(inputs.radius):
        return []
    try:
        u = nearest_of_any_energy(inputs, np.zeros(inputs.size))
    except InfeasibleError:
        return []
    needed = float(u @ u) * problem.dt
    ways = (("energy", problem.limits.energy, needed), ("rms", problem.limits.rms, (needed / problem.horizon) ** 0.5))
    return [Relaxation(name, value, more, "") for name, value, more in ways if value is not None and more > value]


#: A progress function gets the starts or sweeps done, their number, and the best value so far.
Progress = Callable[[int, int, float], None]


def solve(
    problem: Problem,
    criterion: str = "D",
    *,
    starts: int = 20,
    seed: int = 0,
    progress: Progress | None = None,
    certify: float | None = None,
    gap: float = 0.01,
) -> Design:
    """Search for the best input, from random starts.

    Parameters
    ----------
    problem
        Equation, parameters and limits.
    criterion
        Name of the criterion: "trace", "D", "A", "E", "ME" or "c".
    starts
        Number of random starts, >= 1.
    seed
        Seed of the starts.
    progress
        Function that is called after every start of the search.
    certify
        Processor time for the proof of an upper bound [s]; None proves no bound.
    gap
        Relative gap of the bound at which the proof stops.

    Returns
    -------
    Design
        The best input that the starts find.

    Raises
    ------
    UsageError
        If an argument is wrong.
    NotIdentifiableError
        If no input identifies a parameter.
    InfeasibleError
        If no input meets the limits; the error lists the limits to relax.
    SolverError
        If the numerical solver fails.

    Examples
    --------
    >>> from pmfid import Drive
    >>> from pmfid.design import Limits, Problem, solve
    >>> nominal = {"mass": 1.5, "viscous_friction": 6.0, "coulomb_friction": 0.6}
    >>> problem = Problem(
    ...     Drive(2.0), nominal, ("mass",), 2.0, 10, Limits(input=3.0, min_speed=0.01), resolution=1e-5, end=(0.4, 0.0)
    ... )
    >>> design = solve(problem, starts=3, seed=0)
    >>> bool(abs(design.u).max() <= 3.0 + 1e-6), round(float(design.x[-1]), 3)
    (True, 0.4)
    """
    began = time.perf_counter()
    if not problem.linear:
        raise UsageError("this drive has no linear equation; use pmfid.design.rank")
    if starts < 1:
        raise UsageError(f"starts must be at least 1, got {starts}")
    ready = setting(problem, criterion)
    check_identifiable(problem, ready.maps)
    results = _all_starts(ready, np.random.SeedSequence(seed).spawn(starts), progress)
    best = max(results, key=lambda found: found[0])[1]
    design = ready.design(_climber(ready).ascend(best, tolerance=1e-8, steps=300)[1])
    if not design.value > 0:
        raise NotIdentifiableError(
            f"no input within the limits determines {', '.join(problem.names)} in one run; give the motion more time "
            'or intervals, remove a parameter from the list "unknown", or give prior information'
        )
    least = np.log(design.value) + np.log1p(-SOLVER_REACHED)
    reached = float(np.mean([np.log(ready.value(u)) >= least for _, u in results]))
    bound = None
    if certify is not None:
        bound = upper_bound(problem, ready.rule, design.u, gap=gap, seconds=certify)
    seconds = time.perf_counter() - began
    return replace(design, starts=starts, reached=reached, bound=bound, solve_seconds=seconds)


def _all_starts(
    ready: Setting, seeds: list[np.random.SeedSequence], progress: Progress | None
) -> list[tuple[float, Floats]]:
    """Return the log value and the input of each start."""
    climber, results = _climber(ready), list[tuple[float, Floats]]()
    for seed in seeds:
        results.append(climber.start(np.random.default_rng(seed)))
        if progress:
            progress(len(results), len(seeds), float(np.exp(max(value for value, _ in results))))
    return results


def _climber(ready: Setting) -> Climber:
    oracle = Oracle(ready.inputs)
    if not oracle.feasible():
        raise_infeasible(ready.problem)
    return Climber(ready.maps, ready.rule, oracle)

"""The most informative input: many starts, the best of them refined."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from pmfid.design.ascent import Climber
from pmfid.design.bounds import upper_bound
from pmfid.design.criteria import Criterion, criterion_of, eliminate
from pmfid.design.diagnosis import raise_infeasible
from pmfid.design.fisher import Affine, affine, check_identifiable, motion
from pmfid.design.nearest import input_set
from pmfid.design.oracle import Oracle
from pmfid.design.polytope import Polytope, polytope
from pmfid.design.problem import Float, Problem
from pmfid.design.result import Design
from pmfid.errors import UsageError

__all__ = ["evaluate", "solve", "violations"]

#: (starts done, starts in all, best value so far)
Progress = Callable[[int, int, float], None]

#: Relative difference of the criterion that counts as having reached the best.
REACHED = 1e-3
#: A limit may be missed by so much, relative to the terms that it compares.
PRECISION = 1e-7


def solve(
    problem: Problem,
    criterion: str = "D",
    *,
    combination: Mapping[str, float] | None = None,
    starts: int = 20,
    seed: int = 0,
    workers: int = 1,
    progress: Progress | None = None,
    certify: float | None = None,
) -> Design:
    """The best input that `starts` random starts find, each the same for the same seed.

    criterion: a key of `CRITERIA`; combination: {parameter: weight} for "c". workers: threads. progress: called after
    every start. certify: seconds to spend on a proved upper bound (`bounds.certify`), None for none.
    Raises UsageError, NotIdentifiableError (a parameter that no input tells), InfeasibleError (with what to relax),
    SolverError.
    """
    began = time.perf_counter()
    rule = criterion_of(problem, criterion, combination)
    if starts < 1 or workers < 1:
        raise UsageError(f"starts and workers must be at least 1, got {starts} and {workers}")
    maps = affine(problem)
    check_identifiable(problem, maps)
    shape = polytope(problem)
    results = _all_starts(problem, maps, rule, shape, starts, seed, workers, progress)
    values = np.array([value for value, _ in results])
    u = _refine(maps, rule, shape, results[int(np.argmax(values))][1])
    design = _design(problem, maps, rule, shape, u)
    reached = float(np.mean(values >= np.log(design.value) + np.log1p(-REACHED)))
    bound = None if certify is None else upper_bound(problem, rule, design.u, seconds=certify)
    seconds = time.perf_counter() - began
    return replace(design, starts=starts, reached=reached, bound=bound, solve_seconds=seconds)


def evaluate(
    problem: Problem, u: ArrayLike, criterion: str = "D", *, combination: Mapping[str, float] | None = None
) -> Design:
    """What a given input (K,) is worth; `feasible` and `warnings` say which limits it breaks. Raises UsageError."""
    rule = criterion_of(problem, criterion, combination)
    return _design(problem, affine(problem), rule, polytope(problem), np.asarray(u, float))


def _all_starts(
    problem: Problem,
    maps: Affine,
    rule: Criterion,
    shape: Polytope,
    starts: int,
    seed: int,
    workers: int,
    progress: Progress | None,
) -> list[tuple[float, Float]]:
    children = np.random.SeedSequence(seed).spawn(starts)
    results: list[tuple[float, Float]] = []

    def work(part: int) -> list[tuple[float, Float]]:
        oracle = Oracle(shape)
        if not oracle.feasible():
            raise_infeasible(problem)
        climber = Climber(maps, rule, oracle)
        mine = []
        for child in children[part::workers]:
            mine.append(climber.start(np.random.default_rng(child)))
            results.append(mine[-1])
            if progress:
                progress(len(results), starts, float(np.exp(max(value for value, _ in results))))
        return mine

    with ThreadPoolExecutor(workers) as pool:
        parts = list(pool.map(work, range(workers)))
    return [parts[i % workers][i // workers] for i in range(starts)]


def _refine(maps: Affine, rule: Criterion, shape: Polytope, u: Float) -> Float:
    oracle = Oracle(shape)
    oracle.feasible()
    return Climber(maps, rule, oracle).ascend(u, tolerance=1e-8, steps=300)[1]


def _design(problem: Problem, maps: Affine, rule: Criterion, shape: Polytope, u: Float) -> Design:
    x, v = motion(problem, u)
    F = maps.information(u)
    broken = violations(shape, u)
    warnings = [f"breaks {name} by {amount:.3g}" for name, amount in broken.items()]
    if not broken and _parks(problem, v):
        warnings.append("the motion parks at standstill, where the information is fiction; set min_speed above 0")
    S = F / np.outer(maps.scale, maps.scale)
    return Design(
        problem=problem,
        criterion=rule.name,
        t=problem.t,
        u=u,
        x=x,
        v=v,
        fisher=eliminate(S, rule.size)[0],
        value=rule.value(F),
        feasible=not broken,
        warnings=tuple(warnings),
    )


def violations(shape: Polytope, u: Float) -> dict[str, float]:
    """{limit: by how much the input breaks it, in its unit}, for those that it breaks."""
    inputs = input_set(shape)
    values = inputs.matrix @ u
    excess = np.maximum(inputs.lower - values, values - inputs.upper)
    size = np.abs(inputs.matrix).sum(axis=1) * max(1.0, float(np.abs(u).max()))
    broken: dict[str, float] = {}
    for i in np.flatnonzero(excess > PRECISION * size):
        broken[inputs.names[i]] = max(float(excess[i]), broken.get(inputs.names[i], 0.0))
    over = float(np.linalg.norm(u)) - shape.radius
    return broken | ({"energy": over} if over > PRECISION * shape.radius else {})


def _parks(problem: Problem, v: Float) -> bool:
    """Whether the axis stands at a node between two intervals of motion."""
    sense = np.array(problem.sense)
    inside = v[1:-1][(sense[:-1] != 0) & (sense[1:] != 0)]
    return bool(len(inside)) and bool(np.abs(inside).min() < 1e-6 * max(1e-300, np.abs(v).max()))

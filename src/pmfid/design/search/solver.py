"""The most informative input: many starts, the best of them refined."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from pmfid.design.problem.fisher import check_identifiable
from pmfid.design.problem.problem import Problem
from pmfid.design.problem.result import Design
from pmfid.design.search.ascent import Climber
from pmfid.design.search.bounds import upper_bound
from pmfid.design.search.diagnosis import raise_infeasible
from pmfid.design.search.evaluation import Setting, evaluate, setting
from pmfid.design.search.oracle import Oracle
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.types import Floats

__all__ = ["evaluate", "price_of_robustness", "solve"]

#: (starts done, starts in all, best value so far)
Progress = Callable[[int, int, float], None]

#: Relative difference of the criterion that counts as having reached the best.
REACHED = 1e-3


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
    gap: float = 0.01,
) -> Design:
    """The best input that `starts` random starts find; the same for the same seed and number of workers.

    criterion: a key of `CRITERIA`; combination: {parameter: weight} for "c". workers: threads. progress: called after
    every start. certify: seconds of the processor for a proved upper bound, None for none; gap: where to stop with it.
    Raises UsageError, NotIdentifiableError (a parameter that no input tells), InfeasibleError (with what to relax),
    SolverError.
    """
    began = time.perf_counter()
    if starts < 1 or workers < 1:
        raise UsageError(f"starts and workers must be at least 1, got {starts} and {workers}")
    ready = setting(problem, criterion, combination)
    check_identifiable(problem, ready.maps[0])
    results = _all_starts(ready, np.random.SeedSequence(seed).spawn(starts), workers, progress)
    design = ready.design(_refine(ready, max(results, key=lambda found: found[0])[1]))
    if not design.value > 0:
        raise NotIdentifiableError(
            f"no input within the limits tells {', '.join(problem.names)} in one run; give the motion more time or "
            "intervals, take a parameter out of unknown, or give prior information"
        )
    least = np.log(design.value) + np.log1p(-REACHED)
    reached = float(np.mean([np.log(ready.value(u)) >= least for _, u in results]))
    bound = None
    if certify is not None and problem.average != "mean":  # the nominal case bounds the worst one
        bound = upper_bound(problem, ready.rule, design.u, gap=gap, seconds=certify)
    seconds = time.perf_counter() - began
    return replace(design, starts=starts, reached=reached, bound=bound, solve_seconds=seconds)


def price_of_robustness(design: Design, combination: Mapping[str, float] | None = None, starts: int = 20) -> float:
    """Part of the nominal information that robustness costs: 1 - (nominal value of the design) / (the best)."""
    nominal = replace(design.problem, scenarios=(), average=None)
    best = solve(nominal, design.criterion, combination=combination, starts=starts)
    return 1.0 - evaluate(nominal, design.u, design.criterion, combination=combination).value / best.value


def _all_starts(
    ready: Setting, seeds: list[np.random.SeedSequence], workers: int, progress: Progress | None
) -> list[tuple[float, Floats]]:
    """(log value, input) of each start."""
    results: list[tuple[float, Floats]] = []

    def work(part: list[np.random.SeedSequence]) -> list[tuple[float, Floats]]:
        climber = _climber(ready)
        mine = []
        for seed in part:
            mine.append(climber.start(np.random.default_rng(seed)))
            results.append(mine[-1])
            if progress:
                progress(len(results), len(seeds), float(np.exp(max(value for value, _ in results))))
        return mine

    if workers == 1:
        return work(seeds)
    with ThreadPoolExecutor(workers) as pool:
        parts = list(pool.map(work, (seeds[i::workers] for i in range(workers))))
    return [parts[i % workers][i // workers] for i in range(len(seeds))]


def _climber(ready: Setting) -> Climber:
    oracle = Oracle(ready.shape)
    if not oracle.feasible():
        raise_infeasible(ready.problem)
    return Climber(ready.maps, ready.rule, oracle, ready.problem.average == "worst")


def _refine(ready: Setting, u: Floats) -> Floats:
    return _climber(ready).ascend(u, tolerance=1e-8, steps=300)[1]

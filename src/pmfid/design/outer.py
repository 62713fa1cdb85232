"""Searches around the solver: over the end time, and over where the axis rests and turns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np

from pmfid.design.problem import InfeasibleError, Problem
from pmfid.design.result import Design
from pmfid.design.solver import solve
from pmfid.errors import NotIdentifiableError, UsageError

__all__ = ["free_end_time", "search_directions"]


def free_end_time(
    problem: Problem,
    criterion: str = "D",
    *,
    shortest: float,
    longest: float,
    tries: int = 9,
    per_second: bool = True,
    combination: Mapping[str, float] | None = None,
    starts: int = 5,
    seed: int = 0,
) -> Design:
    """The best of `tries` horizons from `shortest` to `longest` [s], each with the problem's interval length.

    per_second: by value per second, as for motions that are repeated; else by value, which grows with the horizon.
    Raises as `solve`, InfeasibleError where no horizon is long enough; UsageError for an empty range.
    """
    if not (0 < shortest < longest and tries >= 2):
        raise UsageError(
            f"the end time needs 0 < shortest < longest and tries >= 2, got {shortest}, {longest}, {tries}"
        )
    if problem.directions:
        raise UsageError("a free end time and given directions do not go together; leave one of them out")
    counts = np.unique(np.rint(np.linspace(shortest, longest, tries) / problem.dt).astype(int))
    found: list[Design] = []
    for count in counts[counts > 0]:
        case = replace(problem, intervals=int(count), horizon=float(count) * problem.dt)
        try:
            found.append(solve(case, criterion, combination=combination, starts=starts, seed=seed))
        except InfeasibleError as error:
            last = error
    if not found:
        raise last
    return max(found, key=lambda d: d.value / (d.problem.horizon if per_second else 1.0))


def search_directions(
    problem: Problem,
    criterion: str = "D",
    *,
    reversals: int = 1,
    rest: int = 1,
    combination: Mapping[str, float] | None = None,
    starts: int = 3,
    seed: int = 0,
) -> Design:
    """The best places for `reversals` turns, each with `rest` intervals of standstill, by pattern search.

    The first stretch goes forward, or backward where the problem's first direction is. Raises UsageError where there
    are too few intervals, InfeasibleError where no place was found that meets the limits; else as `solve`.
    """
    size = problem.intervals
    if reversals < 1 or rest < 1 or size < (reversals + 1) * (rest + 1):
        raise UsageError(f"{reversals} reversals with {rest} intervals of rest do not fit into {size} intervals")
    first = problem.sense[0] or 1
    tried: dict[tuple[int, ...], Design | None] = {}

    def at(turns: tuple[int, ...]) -> Design | None:
        if turns not in tried:
            tried[turns] = _with_turns(problem, turns, first, rest, criterion, combination, starts, seed)
        return tried[turns]

    def value(turns: tuple[int, ...]) -> float:
        design = at(turns)
        return design.value if design is not None else -np.inf

    places = tuple(round(size * (i + 1) / (reversals + 1)) for i in range(reversals))
    step = max(1, size // 4)
    while True:
        moves = [(*places[:i], places[i] + s, *places[i + 1 :]) for i in range(reversals) for s in (-step, step)]
        best = max([places, *moves], key=value)
        if best == places and step == 1:
            break
        places, step = (best, step) if best != places else (places, step // 2)
    design = at(places)
    if design is None:
        raise InfeasibleError(
            "no place for the turns was found that meets all limits; give directions, or relax a limit"
        )
    return design


def _with_turns(
    problem: Problem,
    turns: tuple[int, ...],
    first: int,
    rest: int,
    criterion: str,
    combination: Mapping[str, float] | None,
    starts: int,
    seed: int,
) -> Design | None:
    """The design that turns at these intervals, or None where that is impossible."""
    edges = (-rest, *turns, problem.intervals)
    if any(b - a <= rest for a, b in pairwise(edges)):
        return None
    sense = np.zeros(problem.intervals, int)
    for i, (a, b) in enumerate(pairwise(edges)):
        sense[a + rest : b] = first * (-1) ** i
    try:
        case = replace(problem, directions=tuple(int(s) for s in sense))
        return solve(case, criterion, combination=combination, starts=starts, seed=seed)
    except (InfeasibleError, NotIdentifiableError):
        return None

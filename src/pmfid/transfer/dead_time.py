"""An unknown dead time: where to start from, for the sum of squares has a local minimum about each sample or so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pmfid.errors import NotIdentifiableError
from pmfid.transfer.experiment import RecordStretch
from pmfid.transfer.solve import ProcessProblem, Solution, first_guess, refine
from pmfid.types import Floats

#: Passes for each whole number of samples, and how many of the best are followed to the end.
PASSES, FOLLOWED = 2, 2
#: Samples beyond the largest of these that the dead time may still reach.
BEYOND = 2.0


def keep_outputs_after(stretches: tuple[RecordStretch, ...], time: float, least: int) -> tuple[RecordStretch, ...]:
    """Only outputs from `time` on after the first instant: before, the late input is not known. Stretches with fewer
    than `least` of them are left out."""
    found = []
    for stretch in stretches:
        known = stretch.grid.instants[stretch.rows] >= time * (1 - 1e-9)
        found.append(replace(stretch, rows=stretch.rows[known], samples=stretch.samples[known]))
    return tuple(stretch for stretch in found if stretch.rows.size >= least)


def solve_dead_time(
    problem: ProcessProblem, solver: Callable[[ProcessProblem], Solution]
) -> tuple[ProcessProblem, Solution]:
    """The best of the solutions from the most promising whole samples, and the problem that it solves: with as many
    outputs as can be compared."""
    structure, least = problem.structure, problem.structure.n + 2
    latest, step = structure.latest or 0.0, float(np.median(problem.stretches[0].grid.steps))
    places = np.arange(0.0, latest + 1e-6 * step, step)
    trimmed = replace(problem, stretches=keep_outputs_after(problem.stretches, latest, least))
    starts = _minima(places, np.array([_cost(trimmed, float(place)) for place in places]))
    bound = min(latest, float(np.max(starts)) + BEYOND * step)
    wide = replace(problem, stretches=keep_outputs_after(problem.stretches, bound, least))
    best: tuple[ProcessProblem, Solution] | None = None
    failure = NotIdentifiableError("no dead time lets the model follow the record; try another structure or cutoff")
    for start in starts:
        here = replace(wide, structure=replace(structure, dead_time=float(start), latest=bound))
        try:
            solution = solver(here)
        except NotIdentifiableError as error:
            failure = error
            continue
        if best is None or solution.point.cost < best[1].point.cost:
            best = here, solution
    if best is None:
        raise failure
    return best


def _cost(problem: ProcessProblem, dead_time: float) -> float:
    """What a few passes leave with this dead time."""
    fixed = replace(problem, structure=replace(problem.structure, dead_time=dead_time, latest=None))
    with np.errstate(all="ignore"):
        try:
            cost = refine(fixed, first_guess(fixed, 1.0), most=PASSES).point.cost
        except (np.linalg.LinAlgError, ValueError):
            return np.inf
    return cost if np.isfinite(cost) else np.inf


def _minima(places: Floats, costs: Floats) -> Floats:
    """The best local minima, best first; the first place where there is none."""
    around = np.r_[np.inf, costs, np.inf]
    low = np.flatnonzero((costs <= around[:-2]) & (costs <= around[2:]) & np.isfinite(costs))
    order = low[np.argsort(costs[low])][:FOLLOWED]
    return places[order] if order.size else places[:1]

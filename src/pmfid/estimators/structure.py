"""Search for the structure of a linear process: poles, zeros and dead time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.linear.assess import is_white
from pmfid.linear.experiment import Experiment
from pmfid.linear.sensitivity import Structure
from pmfid.linear.solve import REFINEMENTS, Problem, Solution, descend, first_guess, refine

#: A model is judged once a step would lower its sum of squares by less than this part.
SETTLED = 1e-6
PASSES = 10
#: So many of those that did not settle, but look best, are given more passes.
RETRIED = 8
#: A model counts as follows the record no closer than this part of the output: two such models are equally good.
EXACT = 1e-7
#: Delays in whole samples, and orders, that are searched where nothing else is said.
ORDERS = range(1, 6)
DELAYS = range(6)


@dataclass(frozen=True)
class Candidate:
    """A structure and how it does.

    n, m, delay [samples]; bic: Schwarz's criterion N log(error power) + p log(N), less is better; fit: percent of the
    output's standard deviation that the simulation explains; condition: of the scaled sensitivities, large where poles
    and zeros nearly cancel; settled: whether the iteration did; white: whether what is left is white noise; theta (p,).
    """

    n: int
    m: int
    delay: int
    bic: float
    fit: float
    condition: float
    settled: bool
    white: bool
    theta: NDArray[np.float64]


@dataclass(frozen=True)
class Search:
    """The candidates, best first, those that did not settle last; skipped: structures that cannot be better than the
    best, by models that contain them; samples: N, the same for all delays."""

    candidates: tuple[Candidate, ...]
    skipped: int
    samples: int

    @property
    def best(self) -> Candidate:
        return self.candidates[0]


def search_structure(
    experiments: Sequence[Experiment],
    cutoff: float,
    *,
    orders: Sequence[int] = ORDERS,
    delays: Sequence[int] = DELAYS,
    offset: bool = False,
    done: Callable[[float], None] | None = None,
) -> Search:
    """All n in orders, m < n and delays, fitted to the same samples by refined instrumental variables.

    cutoff: pole of the first filters [rad/s]. A structure is skipped where a model that contains it, with one zero less
    than poles and the same delay, leaves so much that its own sum of squares cannot win; done is called with the part
    that is finished. Raises UsageError without orders, delays or a usable record, and NotIdentifiableError where no
    structure follows the record.
    """
    if not orders or not delays or min(orders) < 1 or min(delays) < 0:
        raise UsageError("give orders from 1 on and delays from 0 on")
    trimmed = [_without_start(experiment, max(delays)) for experiment in experiments]
    places = [(n, n - 1, delay) for delay in delays for n in sorted(set(orders), reverse=True)]
    found, bounds = [], {}
    for count, place in enumerate(places):
        if (candidate := _try(trimmed, *place, cutoff, offset)) is not None:
            found.append(candidate)
            bounds[place[0], place[2]] = candidate.bic
        _report(done, 0.0, count, len(places))
    if not found:
        raise NotIdentifiableError("no structure follows the record: excite it more, or try another cutoff")
    samples = _samples(trimmed, max(delays))

    def least(place: tuple[int, int, int]) -> float:
        n, m, delay = place
        return bounds.get((n, delay), -math.inf) - (n - 1 - m) * math.log(samples)

    rest = sorted(((n, m, delay) for n, _, delay in places for m in range(n - 1)), key=least)
    # the most promising first: the better the best, the more can be skipped
    for count, place in enumerate(rest):
        best = min(candidate.bic for candidate in found)
        if least(place) <= best and (candidate := _try(trimmed, *place, cutoff, offset)) is not None:
            found.append(candidate)
        _report(done, 0.5, count, len(rest))
    found = _finish(found, lambda n, m, delay: _try(trimmed, n, m, delay, cutoff, offset, thorough=True))
    ranked = sorted(found, key=lambda candidate: (not candidate.settled, candidate.bic))
    return Search(tuple(ranked), len(places) + len(rest) - len(found), samples)


def _finish(found: list[Candidate], again: Callable[[int, int, int], Candidate | None]) -> list[Candidate]:
    """Those that did not settle and may win once more, with all the patience that an estimate has."""
    best = min((candidate.bic for candidate in found if candidate.settled), default=math.inf)
    contenders = sorted((c for c in found if not c.settled and c.bic < best), key=lambda c: c.bic)[:RETRIED]
    better = {id(c): again(c.n, c.m, c.delay) or c for c in contenders}
    return [better.get(id(candidate), candidate) for candidate in found]


def _report(done: Callable[[float], None] | None, start: float, count: int, total: int) -> None:
    if done is not None:
        done(start + (count + 1) / (2 * total))


def _without_start(experiment: Experiment, longest: int) -> Experiment:
    """The first samples are not counted for any delay: those of the longest one have no input yet."""
    y = experiment.y.copy()
    y[:longest] = np.nan
    return replace(experiment, y=y)


def _samples(experiments: Sequence[Experiment], delay: int) -> int:
    return sum(stretch.rows.size for experiment in experiments for stretch in experiment.stretches(delay))


def _try(
    experiments: Sequence[Experiment],
    n: int,
    m: int,
    delay: int,
    cutoff: float,
    offset: bool,
    thorough: bool = False,
) -> Candidate | None:
    structure = Structure(n, m, offset)
    stretches = [stretch for experiment in experiments for stretch in experiment.stretches(delay)]
    usable = tuple(stretch.scaled(cutoff) for stretch in stretches if stretch.rows.size > 2 * structure.size)
    if not usable:
        raise UsageError("no record has a stretch with enough samples of input and output; record longer")
    problem = Problem(structure, usable, cutoff)
    with np.errstate(all="ignore"):
        try:
            solution = refine(problem, first_guess(problem, 1.0), SETTLED, REFINEMENTS if thorough else PASSES)
            if thorough and not solution.settled and not problem.referenced:
                solution = descend(problem, solution.point, SETTLED)
        except (np.linalg.LinAlgError, ValueError):
            return None
    return _judged(problem, solution, delay) if np.isfinite(solution.point.cost) else None


def _judged(problem: Problem, solution: Solution, delay: int) -> Candidate:
    structure, point = problem.structure, solution.point
    count = point.error.size
    left = max(point.cost / count, EXACT**2 * point.power / count, 1e-300)
    size = np.linalg.norm(point.zeta, axis=0)
    values = np.linalg.svd(point.zeta / np.where(size > 0, size, 1.0), compute_uv=False)
    spread = sum(float(np.var(stretch.y[stretch.rows]) * stretch.rows.size) for stretch in problem.stretches)
    return Candidate(
        structure.n,
        structure.m,
        delay,
        count * math.log(left) + structure.size * math.log(count),
        100 * (1 - math.sqrt(point.cost / max(spread, 1e-300))),
        float(values[0] / max(values[-1], 1e-300)),
        solution.settled,
        is_white(point.error),
        point.theta * structure.scale(problem.rate),
    )

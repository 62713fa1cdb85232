"""Search for the structure of a linear process: poles, zeros and dead time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.linear.experiment import Experiment
from pmfid.linear.residuals import Noise, is_white, prewhiten_problem, residual_noise
from pmfid.linear.responses import Structure
from pmfid.linear.solve import ProcessProblem, Solution, first_guess, refine, settle, visit
from pmfid.linear.tuning import TUNING

#: Number of structures that are tried before the search recommends none, and reason for the refusal of an estimate.
TRIED, UNSTABLE = 8, "the estimate is unstable"
#: Default orders and delays of the search, with delays in whole samples.
ORDERS = range(1, 6)
DELAYS = range(6)


@dataclass(frozen=True)
class OrderCandidate:
    """A structure and its fit.

    The structure has the numbers n, m and delay [samples]. `bic` is Schwarz's criterion N log(error power) + p log(N)
    after the whitening filter of the noise, and less is better. `fit` is the part of the output's standard deviation
    that the simulation explains [%]. `condition` is the condition number of the scaled sensitivities, which is large if
    poles and zeros nearly cancel. `settled` says whether the iteration converged. `white` says whether the filtered
    residual is white noise. The parameters theta have shape (p,), and N is the number of samples. `refused` is the
    reason against an estimate of this structure, if it was tried.
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
    samples: int
    refused: str = ""


@dataclass(frozen=True)
class Search:
    """The candidates, best first. Candidates whose fit did not converge come last.

    `skipped` is the number of structures that are worse than the best structure for certain, because a larger model is
    already worse. `samples` is the number N of samples, equal for all delays.
    """

    candidates: tuple[OrderCandidate, ...]
    skipped: int
    samples: int

    @property
    def best(self) -> OrderCandidate:
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
    """Fit all structures to the same samples by refined instrumental variables.

    The structures have n poles for each n in `orders`, m < n zeros, and each delay. Any criterion would take noise that
    is not white for dynamics. Therefore the search first estimates the colour from the residuals of the largest and a
    middle order. Then the search compares all structures after the whitening filter (`residuals.py`). `cutoff` is the
    pole of the first filters [rad/s]. The search skips a structure if a model that contains it has too large a
    residual. The containing model has the same delay, and one zero less than poles. `done` is called with the completed
    part. Raises UsageError without orders, delays or a usable record, and NotIdentifiableError if no structure follows
    the record.
    """
    if not orders or not delays or min(orders) < 1 or min(delays) < 0:
        raise UsageError("orders must be at least 1 and delays at least 0; give one or more of each")
    longest = max(delays)  # which has no input at the first outputs
    trimmed = [replace(one, y=np.append(np.full(one.y[:longest].size, np.nan), one.y[longest:])) for one in experiments]
    colour = _colour(trimmed, orders, delays, cutoff, offset)
    places = [(n, n - 1, delay) for delay in delays for n in sorted(set(orders), reverse=True)]
    found, bounds = [], {}
    for count, place in enumerate(places):
        if (candidate := _try(trimmed, *place, cutoff, offset, colour)) is not None:
            found.append(candidate)
            bounds[place[0], place[2]] = candidate.bic
        if done is not None:
            done(0.5 * (count + 1) / len(places))
    if not found:
        raise NotIdentifiableError(
            "no transfer function of these orders and delays follows the record: excite the process more, or try "
            "another cutoff"
        )
    samples = found[0].samples

    def least(place: tuple[int, int, int]) -> float:
        n, m, delay = place
        return bounds.get((n, delay), -math.inf) - (n - 1 - m) * math.log(samples)

    rest = sorted(((n, m, delay) for n, _, delay in places for m in range(n - 1)), key=least)
    # The most promising structures come first, because a better first result lets the search skip more structures.
    for count, place in enumerate(rest):
        best = min(candidate.bic for candidate in found)
        if least(place) <= best and (candidate := _try(trimmed, *place, cutoff, offset, colour)) is not None:
            found.append(candidate)
        if done is not None:
            done(0.5 + 0.5 * (count + 1) / len(rest))
    found = _finish(found, lambda n, m, delay: _try(trimmed, n, m, delay, cutoff, offset, colour, thorough=True))
    ranked = sorted(found, key=lambda candidate: (not candidate.settled, candidate.bic))
    return Search(tuple(ranked), len(places) + len(rest) - len(found), samples)


def accepted_first(search: Search, refusal: Callable[[OrderCandidate], str]) -> Search:
    """Return the search after a move of the first acceptable structure to the front.

    `refusal` returns the reason against an estimate of a structure, UNSTABLE, or an empty text. Each refused structure
    stores the reason.
    """
    refused: list[OrderCandidate] = []
    rest = list(search.candidates)
    while rest and len(refused) < TRIED:
        reason = refusal(rest[0])
        if not reason:
            return replace(search, candidates=(rest[0], *refused, *rest[1:]))
        refused.append(replace(rest.pop(0), refused=reason))
    # an unstable estimate is better than none
    refused.sort(key=lambda candidate: candidate.refused != UNSTABLE)
    return replace(search, candidates=(*refused, *rest))


def _finish(
    found: list[OrderCandidate], again: Callable[[int, int, int], OrderCandidate | None]
) -> list[OrderCandidate]:
    """Repeat those fits that did not converge but may be the best, with as many passes as an estimate has."""
    best = min((candidate.bic for candidate in found if candidate.settled), default=math.inf)
    contenders = sorted((c for c in found if not c.settled and c.bic < best), key=lambda c: c.bic)
    better = {id(c): again(c.n, c.m, c.delay) or c for c in contenders[: TUNING.order_retried]}
    return [better.get(id(candidate), candidate) for candidate in found]


def _colour(
    experiments: Sequence[Experiment], orders: Sequence[int], delays: Sequence[int], cutoff: float, offset: bool
) -> Noise | None:
    """Return the noise that the best models of a middle and of the largest order leave.

    The result is None if no such model follows the record.
    """
    best, noise = math.inf, None
    for n in sorted({max(orders), min(max(orders), TUNING.order_middle)}):
        for delay in delays:
            problem = _problem(experiments, Structure(n, n - 1, offset), delay, cutoff)
            point = _refine_structure(problem)
            criterion = math.inf if point is None else _bic(problem, point.point.cost, point.point.error.size)
            if point is not None and criterion < best:
                best, noise = criterion, residual_noise(problem, point.point)
    return noise


def _try(
    experiments: Sequence[Experiment],
    n: int,
    m: int,
    delay: int,
    cutoff: float,
    offset: bool,
    colour: Noise | None,
    thorough: bool = False,
) -> OrderCandidate | None:
    problem = _problem(experiments, Structure(n, m, offset), delay, cutoff)
    white = problem if colour is None else prewhiten_problem(problem, colour)
    solution = _refine_structure(white, thorough)
    return None if solution is None else _make_candidate(problem, white, colour, solution, delay)


def _problem(experiments: Sequence[Experiment], structure: Structure, delay: int, cutoff: float) -> ProcessProblem:
    stretches = [stretch for experiment in experiments for stretch in experiment.stretches(delay)]
    usable = tuple(stretch.scale_time(cutoff) for stretch in stretches if stretch.rows.size > 2 * structure.size)
    if not usable:
        raise UsageError("no record has a stretch with enough samples of input and output; record longer")
    return ProcessProblem(structure, usable, cutoff)


def _refine_structure(problem: ProcessProblem, thorough: bool = False) -> Solution | None:
    with np.errstate(all="ignore"):
        try:
            if thorough:
                solution = settle(problem, settled=TUNING.order_settled)
            else:
                solution = refine(problem, first_guess(problem, 1.0), TUNING.order_settled, TUNING.order_passes)
        except (np.linalg.LinAlgError, ValueError):
            return None
    return solution if np.isfinite(solution.point.cost) else None


def _bic(problem: ProcessProblem, cost: float, samples: int, effective: float | None = None) -> float:
    """Return Schwarz's criterion. `effective` is the effective number of samples if the noise is not white."""
    power = sum(float(np.sum(stretch.y[stretch.rows] ** 2)) for stretch in problem.stretches)
    left, count = max(cost, TUNING.order_exact**2 * power, 1e-300) / samples, effective or samples
    return count * math.log(left) + problem.structure.size * math.log(count)


def _make_candidate(
    problem: ProcessProblem, white: ProcessProblem, colour: Noise | None, solution: Solution, delay: int
) -> OrderCandidate:
    """Return the candidate for a solution, where `white` is the whitened problem of the solution."""
    structure, point = problem.structure, solution.point
    coloured = colour is not None and white is problem
    theta = point.theta.copy()
    if structure.offset and white is not problem and colour is not None:
        theta[-1] /= np.sum(colour.whitener)
    left = point if white is problem else visit(problem, theta, np.zeros((len(problem.stretches), structure.n)))
    size = np.linalg.norm(point.zeta, axis=0)
    values = np.linalg.svd(point.zeta / np.where(size > 0, size, 1.0), compute_uv=False)
    spread = sum(float(np.var(stretch.y[stretch.rows]) * stretch.rows.size) for stretch in problem.stretches)
    effective = colour.effective(point.error.size) if coloured and colour is not None else None
    return OrderCandidate(
        structure.n,
        structure.m,
        delay,
        _bic(white, point.cost, point.error.size, effective),
        100 * (1 - math.sqrt(left.cost / max(spread, 1e-300))),
        float(values[0] / max(values[-1], 1e-300)),
        solution.settled,
        is_white(point.error),
        theta * structure.scale(problem.rate),
        point.error.size,
    )

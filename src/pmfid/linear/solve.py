"""Refined instrumental variables and output error of a transfer function."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmfid.errors import NotIdentifiableError
from pmfid.fit.likelihood import ROUNDING
from pmfid.fit.problem import ResidualBlock
from pmfid.fit.solve import solve as minimise
from pmfid.linear.experiment import RecordStretch
from pmfid.linear.responses import Structure, linearise, stable
from pmfid.linear.tuning import TUNING
from pmfid.types import Flags, Floats


@dataclass(frozen=True)
class ProcessProblem:
    """A structure and the stretches of all records, with time in units of the inverse of `rate` [1/s]."""

    structure: Structure
    stretches: tuple[RecordStretch, ...]
    rate: float

    @property
    def duration(self) -> float:
        return max(stretch.grid.duration for stretch in self.stretches)

    @property
    def referenced(self) -> bool:
        return any(stretch.inputs.shape[0] > 1 for stretch in self.stretches)

    @property
    def without_reference(self) -> ProcessProblem:
        """The problem with the measured inputs in place of the parts that the reference explains."""
        return replace(self, stretches=tuple(replace(stretch, inputs=stretch.inputs[:1]) for stretch in self.stretches))


@dataclass(frozen=True)
class ProcessPoint:
    """Parameters theta (p,) and initial conditions (stretches, n) with the linearisation at this point.

    The initial conditions are projected out of error (N,), phi (N, p) and zeta (N, p). `cost` is the sum of squares of
    the error, and `power` is the sum of squares of the output. `projected` holds the rows of each stretch and the
    orthonormal columns (r, n) of its initial conditions.
    """

    theta: Floats
    initial: Floats
    error: Floats
    phi: Floats
    zeta: Floats
    cost: float
    power: float
    projected: tuple[tuple[slice, Floats], ...]


@dataclass(frozen=True)
class Solution:
    """The final point of an iteration, whether the iteration converged, and its number of passes."""

    point: ProcessPoint
    settled: bool
    passes: int


@np.errstate(over="ignore", invalid="ignore")  # a very poor process has no finite loss
def visit(problem: ProcessProblem, theta: Floats, initial: Floats) -> ProcessPoint:
    """Linearise at theta (p,), where the initial conditions (stretches, n) move to their best fit."""
    from scipy.linalg import qr, solve_triangular  # slow to import

    errors, phis, zetas, found, projected, first = [], [], [], [], [], 0
    for stretch, start in zip(problem.stretches, initial, strict=True):
        here = linearise(problem.structure, theta, start, stretch)
        Q, R = qr(here.free, mode="economic", check_finite=False)
        inside = Q.T @ here.error
        found.append(start + solve_triangular(_regular(R), inside, check_finite=False))
        projected.append((slice(first, first + Q.shape[0]), Q))
        first += Q.shape[0]
        errors.append(here.error - Q @ inside)
        phis.append(here.phi - Q @ (Q.T @ here.phi))
        zetas.append(here.zeta - Q @ (Q.T @ here.zeta))
    error = np.concatenate(errors)
    power = sum(float(np.sum(stretch.y[stretch.rows] ** 2)) for stretch in problem.stretches)
    return ProcessPoint(
        theta,
        np.array(found),
        error,
        np.vstack(phis),
        np.vstack(zetas),
        float(error @ error),
        power,
        tuple(projected),
    )


def _regular(R: Floats) -> Floats:
    """Return R with infinite values in place of small pivots, in case too few samples determine the initial
    conditions.
    """
    pivots = np.abs(np.diagonal(R))
    dead = pivots < 1e-12 * max(float(np.max(pivots)), 1e-300)
    if not np.any(dead):
        return R
    R = R.copy()
    R[np.diag_indices_from(R)] = np.where(dead, 1e300, np.diagonal(R))
    return R


def step_from(point: ProcessPoint, phi: Floats) -> Floats:
    """Return the step (zeta^T phi)^-1 zeta^T error, computed from columns of equal size."""
    size = np.linalg.norm(point.zeta, axis=0)
    size = np.where(size > 0, size, 1.0)
    normal = (point.zeta / size).T @ (phi / size)
    try:
        return np.asarray(np.linalg.solve(normal, (point.zeta / size).T @ point.error) / size)
    except np.linalg.LinAlgError:
        return np.full(size.size, np.nan)


def _possible_step(problem: ProcessProblem, point: ProcessPoint) -> Floats:
    """Return the step from a point. A dead time at its bound moves no further."""
    step, latest = step_from(point, point.phi), problem.structure.latest
    if latest is None or 0.0 < point.theta[-1] + step[-1] < latest or 0.0 < point.theta[-1] < latest:
        return step
    return np.append(step_from(replace(point, zeta=point.zeta[:, :-1]), point.phi[:, :-1]), 0.0)


def filter_problem(problem: ProcessProblem, pole: float) -> ProcessPoint:
    """Filter all signals by 1/(s + pole)^n, with the pole in units of the problem (state variable filters)."""
    structure = problem.structure
    a = np.atleast_1d(np.poly(np.full(structure.free, -pole)))[:0:-1]
    late = [structure.dead_time] * (structure.latest is not None)
    theta = np.r_[a, np.zeros(structure.linear - structure.free), late]
    return visit(problem, theta, np.zeros((len(problem.stretches), structure.n)))


def first_guess(problem: ProcessProblem, pole: float) -> ProcessPoint:
    """Return the least-squares solution with the filter 1/(s + pole)^n."""
    point = filter_problem(problem, pole)
    theta = point.theta
    size = np.linalg.norm(point.phi, axis=0)
    size = np.where(size > 0, size, 1.0)
    found = theta + np.linalg.lstsq(point.phi / size, point.error, rcond=None)[0] / size
    return _visit_possible(problem, found, point.initial)


def _visit_possible(problem: ProcessProblem, theta: Floats, initial: Floats) -> ProcessPoint:
    return visit(problem, possible(problem, theta), initial)


def possible(problem: ProcessProblem, theta: Floats) -> Floats:
    """Return theta with stable poles, unless the structure allows others, and with a dead time within its bounds.

    The response of an unstable intermediate model would exceed the record by far.
    """
    structure, theta = problem.structure, theta.copy()
    if not structure.unstable:
        theta[: structure.free] = stable(theta[: structure.free], problem.duration)
    if structure.latest is not None:
        theta[-1] = min(max(theta[-1], 0.0), structure.latest)
    return theta


def refine(
    problem: ProcessProblem,
    start: ProcessPoint,
    settled: float = TUNING.solve_settled,
    most: int = TUNING.solve_refinements,
) -> Solution:
    """Return the solution of an iteration in which instruments and filter follow the estimate.

    If the iteration does not converge, the function returns its best point.
    """
    point = best = start
    for passes in range(1, most + 1):
        step = _possible_step(problem, point)
        if small(point, step, settled):
            return Solution(replace(point, theta=point.theta + step), True, passes)
        if not np.all(np.isfinite(step)):
            break
        point = _visit_possible(problem, point.theta + step, point.initial)
        if not np.isfinite(point.cost):
            break
        if point.cost < best.cost or problem.referenced:
            best = point
    return Solution(best, False, most)


@dataclass(frozen=True, eq=False)
class CountedStretch:
    """The rows of a stretch in the form of the fit: which of them are counts, and their variances [counts^2]."""

    counted: Flags
    variance: Floats


@dataclass(frozen=True, eq=False)
class ProcessSimulator:
    """A process in the form of the fit of a machine. Its residuals have the unit `scale`, such as a count.

    The parameters are those of the process. The start states (stretches, s) are changes of the initial conditions from
    those of a point. A state of 1 moves the output by a root mean square of one unit: `basis` (stretches, n, n) holds
    the initial conditions of such states. If `shifted`, the zero of the output has an unknown place within a count of
    its place, as between devices that round and that truncate. The place is a further start state of each stretch, and
    its bound is a row of its own.
    """

    problem: ProcessProblem
    initial: Floats
    basis: Floats
    scale: float
    shifted: bool

    @classmethod
    def make_at(
        cls, problem: ProcessProblem, point: ProcessPoint, scale: float, shifted: bool = False
    ) -> ProcessSimulator:
        """Return a simulator whose start states are changes from those of a point."""
        pairs = zip(problem.stretches, point.initial, strict=True)
        free = [linearise(problem.structure, point.theta, initial, stretch).free for stretch, initial in pairs]
        basis = np.array([np.linalg.pinv(np.linalg.qr(K / np.sqrt(len(K)), mode="r")) for K in free])
        return cls(problem, point.initial, scale * basis, scale, shifted)

    @property
    def stretches(self) -> tuple[CountedStretch, ...]:
        sizes = [stretch.rows.size + self.shifted for stretch in self.problem.stretches]
        return tuple(CountedStretch(np.ones(size, bool), np.full(size, ROUNDING)) for size in sizes)

    @property
    def first_starts(self) -> Floats:
        """The start states (stretches, s) of the point."""
        return np.zeros((len(self.problem.stretches), self.problem.structure.n + self.shifted))

    def clip_to_bounds(self, q: Floats) -> Floats:
        """Return possible parameters (p,)."""
        return possible(self.problem, q)

    def initial_at(self, starts: Floats) -> Floats:
        """Return the initial conditions (stretches, n) for start states (stretches, s)."""
        return np.asarray(self.initial + np.einsum("mij,mj->mi", self.basis, starts[:, : self.initial.shape[1]]))

    @np.errstate(over="ignore", invalid="ignore")  # a step may lead to a response beyond the range of numbers
    def linearise(self, q: Floats, starts: Floats) -> list[ResidualBlock]:
        """Return residuals and their derivatives at parameters (p,) and start states (stretches, s)."""
        pairs, blocks = zip(self.problem.stretches, self.initial_at(starts), strict=True), []
        for (stretch, initial), basis, start in zip(pairs, self.basis, starts, strict=True):
            here = linearise(self.problem.structure, q, initial, stretch)
            e, J, K = (rows / self.scale for rows in (-here.error, here.zeta, here.free @ basis))
            if self.shifted:
                e, J = np.append(e + start[-1], start[-1] / 2), np.vstack([J, np.zeros(q.size)])
                K = np.column_stack([np.vstack([K, np.zeros(K.shape[1])]), np.append(np.ones(e.size - 1), 0.5)])
            blocks.append(ResidualBlock(np.nan_to_num(e, nan=np.inf), J, K))
        return blocks

    def visit(self, q: Floats, starts: Floats) -> ProcessPoint:
        """Return the point with parameters (p,), from start states (stretches, s)."""
        return visit(self.problem, q, self.initial_at(starts))


def descend(problem: ProcessProblem, start: ProcessPoint) -> Solution:
    """Minimise the sum of squares of the output error by the solver of the fit.

    The unit of the errors is their root mean square, which the first turn brings down.
    """
    point, settled = start, False
    for _ in range(2):
        scale = np.sqrt((point.cost + TUNING.solve_rounding * point.power) / max(point.error.size, 1))
        if not 0 < scale < np.inf:
            break
        simulator = ProcessSimulator.make_at(problem, point, float(scale))
        prior = np.zeros(point.theta.size)
        end = minimise(simulator, sum_squares, point.theta, simulator.first_starts, prior, TUNING.solve_descents)
        point, settled = simulator.visit(end.q, end.starts), end.settled
    poles = np.roots(np.r_[1.0, point.theta[: problem.structure.n][::-1]])  # those at their bound have not settled
    return Solution(point, settled and not np.any(poles.real * problem.duration > TUNING.solve_edge), 0)


def sum_squares(blocks: Sequence[ResidualBlock]) -> tuple[float, list[ResidualBlock]]:
    """Return minus the log likelihood of white errors of one unit, and the blocks."""
    return 0.5 * sum(float(block.e @ block.e) for block in blocks), list(blocks)


def small(point: ProcessPoint, step: Floats, settled: float = TUNING.solve_settled) -> bool:
    """Return whether a step would hardly lower the sum of squares."""
    if not np.all(np.isfinite(step)):
        return False
    predicted = float(np.sum((point.zeta @ step) ** 2))
    return predicted <= max(settled * point.cost, TUNING.solve_rounding * point.power)


def settle(problem: ProcessProblem, pole: float = 1.0, settled: float = TUNING.solve_settled) -> Solution:
    """Return the refined solution from the filter 1/(s + pole)^n. If the refinement does not converge, it descends."""
    solution = refine(problem, first_guess(problem, pole), settled)
    return solution if solution.settled or problem.referenced else descend(problem, solution.point)


def solve(problem: ProcessProblem) -> Solution:
    """Refine the solution of least squares.

    If the refinement does not converge, the function descends and tries other filters. With solve_several poles or
    more, a filter may miss a resonance. From this number of poles on, the function tries all filters and returns the
    best solution.
    """
    best: Solution | None = None
    every = problem.structure.free >= TUNING.solve_several and not problem.referenced
    for pole in TUNING.solve_starts:
        solution = settle(problem, pole)
        if best is None or (not solution.settled, solution.point.cost) < (not best.settled, best.point.cost):
            best = solution
        if solution.settled and not every:
            break
    if problem.referenced and (best is None or not best.settled):
        # The start comes from the measured input. The measured input contains noise from the feedback, but the start is
        # near the solution.
        near = descend(problem.without_reference, first_guess(problem.without_reference, 1.0)).point
        best = refine(problem, _visit_possible(problem, near.theta, near.initial))
    if best is None or not best.settled:
        raise NotIdentifiableError(f"the iteration does not converge: {_reason(problem)}")
    return best


def _reason(problem: ProcessProblem) -> str:
    """Return the reason why the iteration does not converge, as far as least squares show it."""
    raw = filter_problem(problem, 1.0)
    theta = raw.theta + step_from(replace(raw, zeta=raw.phi), raw.phi)
    free = theta[: problem.structure.free][::-1]
    poles = np.roots(np.r_[1.0, free]) if np.all(np.isfinite(theta)) else np.zeros(0)
    if np.any(poles.real * problem.duration > 1.0) and not problem.structure.unstable:
        return (
            f"least squares finds a pole at {np.max(poles.real) * problem.rate:+.3g} rad/s, in the right half-plane: "
            "if a controller stabilises the process, set [model] unstable = true; otherwise use ls or bcls, or another "
            "structure"
        )
    offset = "" if problem.structure.offset else "[model] offset = true if the output has a constant part, "
    return f"the model does not follow the record; try {offset}another structure, dead time or cutoff"


def keep_outputs_after(stretches: tuple[RecordStretch, ...], time: float, least: int) -> tuple[RecordStretch, ...]:
    """Return the stretches without outputs earlier than `time` after the first instant, because the late input is
    unknown there.

    Stretches with fewer than `least` outputs are left out.
    """
    found = []
    for stretch in stretches:
        known = stretch.grid.instants[stretch.rows] >= time * (1 - 1e-9)
        found.append(replace(stretch, rows=stretch.rows[known], samples=stretch.samples[known]))
    return tuple(stretch for stretch in found if stretch.rows.size >= least)


def fix_dead_time(problem: ProcessProblem, theta: Floats) -> tuple[ProcessProblem, Floats]:
    """Return the problem with the dead time in theta (p,) as a known number, and the other parameters."""
    structure = problem.structure
    if structure.latest is None:
        return problem, theta
    late = structure.lateness(theta)
    stretches = keep_outputs_after(problem.stretches, late, structure.n + 2)
    return replace(problem, structure=replace(structure, dead_time=late, latest=None), stretches=stretches), theta[:-1]


def solve_dead_time(problem: ProcessProblem) -> tuple[ProcessProblem, Solution]:
    """Return the best solution of several start values for the dead time, and the problem that it solves.

    The start values are the most promising whole samples. For a comparison, all solutions use the same outputs.
    """
    structure, least = problem.structure, problem.structure.n + 2
    latest, step = structure.latest or 0.0, float(np.median(problem.stretches[0].grid.steps))
    places = np.arange(0.0, latest + 1e-6 * step, step)
    trimmed = replace(problem, stretches=keep_outputs_after(problem.stretches, latest, least))
    starts = _minima(places, np.array([cost_at(trimmed, float(place)) for place in places]))
    bound = min(latest, float(np.max(starts)) + TUNING.solve_beyond * step)
    wide = replace(problem, stretches=keep_outputs_after(problem.stretches, bound, least))
    best: tuple[ProcessProblem, Solution] | None = None
    failure = NotIdentifiableError(
        "the model does not follow the record with any dead time; try another structure or cutoff"
    )
    for start in starts:
        here = replace(wide, structure=replace(structure, dead_time=float(start), latest=bound))
        try:
            solution = solve(here)
        except NotIdentifiableError as error:
            failure = error
            continue
        if best is None or solution.point.cost < best[1].point.cost:
            best = here, solution
    if best is None:
        raise failure
    return best


def cost_at(problem: ProcessProblem, dead_time: float) -> float:
    """Return the remaining cost after a few passes with a given dead time."""
    fixed = replace(problem, structure=replace(problem.structure, dead_time=dead_time, latest=None))
    with np.errstate(all="ignore"):
        try:
            cost = refine(fixed, first_guess(fixed, 1.0), most=TUNING.solve_passes).point.cost
        except (np.linalg.LinAlgError, ValueError):
            return np.inf
    return cost if np.isfinite(cost) else np.inf


def _minima(places: Floats, costs: Floats) -> Floats:
    """Return the best local minima, best first, or the first place if no minimum exists."""
    around = np.r_[np.inf, costs, np.inf]
    low = np.flatnonzero((costs <= around[:-2]) & (costs <= around[2:]) & np.isfinite(costs))
    order = low[np.argsort(costs[low])][: TUNING.solve_followed]
    return places[order] if order.size else places[:1]

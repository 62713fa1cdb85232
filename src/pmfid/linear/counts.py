"""The responses of a transfer function that stay within every count of a rounded output."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from pmfid.errors import NotIdentifiableError
from pmfid.fit.fit import BLOCKS
from pmfid.fit.posterior import allowed_region
from pmfid.fit.problem import ResidualBlock
from pmfid.fit.search import EXPLAINED
from pmfid.fit.solve import root_of_rows
from pmfid.fit.solve import solve as minimise
from pmfid.fit.within import find_depth, information_rows, reach_counts, stack, usual_depth
from pmfid.linear.solve import ProcessPoint, ProcessProblem, ProcessSimulator, solve, sum_squares
from pmfid.linear.tuning import TUNING
from pmfid.types import Floats


def explain_counts(
    problem: ProcessProblem, start: ProcessPoint, resolution: float
) -> tuple[ProcessPoint, Floats] | None:
    """Return the mean of all parameters whose response stays within every count, and their covariance (p, p).

    The result is None if the output is no count of this `resolution`, if no response near the start explains every
    count, or if the response bends too much within the region for its linearisation.
    """
    problem = problem.without_reference
    shifted = not (problem.structure.offset or problem.structure.integrators)
    parameters = problem.structure.size + len(problem.stretches) * (problem.structure.n + shifted)
    counts = [(stretch.y[stretch.rows] - stretch.y[stretch.rows[0]]) / resolution for stretch in problem.stretches]
    off = max(float(np.max(np.abs(y - np.rint(y)))) for y in counts)  # largest distance of an output from its count
    if parameters > BLOCKS or not off < EXPLAINED:
        return None
    # A response within every count leaves at most half a count, and least squares leaves no more.
    if start.cost > start.error.size * (resolution * (1.5 if shifted else 0.5)) ** 2:
        return None
    process = ProcessSimulator.make_at(problem, start, resolution, shifted)
    q = _start_with_offset(problem) if shifted else start.theta
    return None if q is None else _explain(process, q, off)


def _start_with_offset(problem: ProcessProblem) -> Floats | None:
    """Return the parameters (p,) of the best response with a constant output, which is the place of a count's zero."""
    structure = problem.structure
    with suppress(NotIdentifiableError):
        shifted = replace(problem, structure=replace(structure, offset=True))
        return np.delete(solve(shifted).point.theta, structure.linear)
    return None


def _explain(process: ProcessSimulator, q: Floats, off: float) -> tuple[ProcessPoint, Floats] | None:
    """Return the mean of the parameters whose response stays within every count, and their covariance (p, p).

    The digits of a log move an output by up to `off` [counts].
    """
    p = q.size
    least = minimise(process, sum_squares, q, process.first_starts, np.zeros(p))
    if 2 * least.cost > 0.5**2 * least.normal.rows:
        return None
    flat = np.zeros(p + least.starts.size)
    at, size = reach_counts(process, least.q, least.starts, flat, EXPLAINED), np.full(p, np.inf)
    for _ in range(TUNING.counts_rounds):
        if at is None or not _is_within(blocks := process.linearise(*at)):
            return None
        if (region := _find_region(blocks, off)) is None:
            return None
        mean, covariance = region
        before, size = size, np.sqrt(np.diag(covariance)[:p])
        at = at[0] + mean[:p], at[1] + mean[p:].reshape(least.starts.shape)
        settled = np.abs(mean[:p]) <= TUNING.counts_settled * size
        if np.all(settled & (size <= (1 + TUNING.counts_settled) * before)) and _is_within(process.linearise(*at)):
            return process.visit(*at), covariance[:p, :p]
    return None


def _is_within(blocks: list[ResidualBlock]) -> bool:
    return all(bool(np.max(np.abs(block.e)) <= 0.5 + EXPLAINED) for block in blocks)


def _find_region(blocks: list[ResidualBlock], off: float) -> tuple[Floats, Floats] | None:
    """Return mean and covariance of the steps of all parameters and start states that every count allows.

    The result is None for a region that is shallower than rounding alone leaves by chance. A region that is shallower
    than the mean is widened to it.
    """
    from scipy.special import gammainc  # slow to import

    e, J = stack(blocks)
    flat = np.zeros(J.shape[1])
    root = root_of_rows(information_rows(J, flat))
    depth = find_depth(e, J @ root)
    if gammainc(flat.size, 2 * e.size * max(depth + off, 0.0)) < TUNING.counts_chance:
        return None
    bound = np.full(e.size, 0.5 + off + max(0.0, usual_depth(J) - depth))
    return allowed_region(e, J, bound, root, np.random.default_rng(1), (flat, flat))

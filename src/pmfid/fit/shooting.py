"""Multiple shooting: fits of parts of a record with start states of their own, which become longer (Bock 1983).

Stops, contacts and forces of the position make the likelihood of a whole record rough. Parts stay near the record.
"""

from __future__ import annotations

import numpy as np

from pmfid.fit.problem import FitProblem, ResidualBlock
from pmfid.fit.solve import START, Likelihood, Optimum, normal_of, solve
from pmfid.fit.starts import soften
from pmfid.fit.tuning import TUNING
from pmfid.types import Floats


def rejoin(plain: FitProblem, q: Floats, prior: Floats, parts: float) -> Optimum:
    """Return the fit of the whole record from a number of parts of it, which become longer."""
    length = sum(float(one.times[-1]) for one in plain.stretches) / parts
    problem = plain.cut(count_parts(plain, length))
    return join(plain, problem, settle(problem, q, problem.first_starts(), prior, 20), length, prior)


def join(plain: FitProblem, problem: FitProblem, end: Optimum, length: float, prior: Floats) -> Optimum:
    """Return the fit of the whole record from that of its parts of a length [s], which become longer."""
    while len(problem.stretches) > len(plain.stretches):
        ends = dict(zip((one.first for one in problem.stretches), end.starts, strict=True))
        length *= TUNING.joined
        problem = plain.cut(count_parts(plain, length))
        pairs = zip(problem.stretches, problem.first_starts(), strict=True)
        starts = np.array([ends.get(one.first, start) for one, start in pairs])
        end = settle(problem, end.q, starts, prior, 20)
    return end


def settle(problem: FitProblem, q: Floats, starts: Floats, prior: Floats, steps: int) -> Optimum:
    """Return the fit in the softened likelihood from parameters (p,), with the start states (m, s) of least cost."""
    like = soften(problem.stretches)
    return solve(problem, like, q, settle_starts(problem, like, q, starts), prior, steps, 0.1)


def settle_starts(problem: FitProblem, likelihood: Likelihood, q: Floats, starts: Floats) -> Floats:
    """Return the start states (m, s) of least cost at parameters q (p,)."""
    damping, still = 1e-3, np.zeros(q.size)

    def cost_at(states: Floats) -> tuple[float, list[ResidualBlock]]:
        cost, blocks = likelihood(problem.linearise(q, states))
        return cost + 0.5 * float(np.sum(START[: states.shape[1]] * states**2)), blocks

    cost, blocks = cost_at(starts)
    for _ in range(8):
        moved = starts + normal_of(blocks, starts, damping).starts(still)
        tried, there = cost_at(moved)
        if not tried < cost:
            damping *= 10
            continue
        gain, starts, cost, blocks, damping = cost - tried, moved, tried, there, damping / 10
        if gain < max(0.1, 0.01 * cost):
            break
    return starts


def count_parts(problem: FitProblem, length: float) -> int:
    """Return the number of parts of about a length [s]."""
    return max(1, int(sum(float(one.times[-1]) for one in problem.stretches) / length))

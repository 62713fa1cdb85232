"""Instrumental variables for a linear process with filters that stay the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pmfid.errors import NotIdentifiableError
from pmfid.transfer.experiment import RecordStretch
from pmfid.transfer.sensitivity import simulate
from pmfid.transfer.solve import (
    REFINEMENTS,
    ProcessPoint,
    ProcessProblem,
    Solution,
    filter_problem,
    first_guess,
    possible,
    small,
    step_from,
    visit,
)
from pmfid.types import Floats


def with_fixed_filter(problem: ProcessProblem, pole: float) -> Solution:
    """Instrumental variables with the filter 1/(s + pole)^n throughout, instruments from the simulated output.

    What the output does between the samples matters here: a straight line, which costs an error of order dt^2; but for
    what goes straight through (m = n), which jumps with the input."""
    data, point = filter_problem(problem, pole), first_guess(problem, pole)
    theta, missed = point.theta, _missed_by_lines(problem, pole, data)
    for passes in range(1, REFINEMENTS + 1):
        simulated = [
            simulate(problem.structure, theta, initial, stretch)
            for initial, stretch in zip(point.initial, problem.stretches, strict=True)
        ]
        ideal = tuple(replace(stretch, y=y) for stretch, y in zip(problem.stretches, simulated, strict=True))
        through = _get_feedthrough(problem, theta) * missed
        here = replace(data, zeta=filter_problem(replace(problem, stretches=ideal), pole).phi + through)
        phi = data.phi + through
        step = step_from(here, phi)
        if not np.all(np.isfinite(step)):
            break
        before, theta = theta, data.theta + step
        moved = replace(here, theta=theta, error=data.error - phi @ step)
        if small(moved, theta - before):
            return Solution(replace(moved, cost=float(moved.error @ moved.error)), True, passes)
        theta = possible(problem, theta)
        point = visit(problem, theta, point.initial)
    raise NotIdentifiableError("the instruments do not settle: use srivc, or another structure or cutoff")


def _get_feedthrough(problem: ProcessProblem, theta: Floats) -> float:
    """The coefficient of what goes straight through, 0 where there is none."""
    structure = problem.structure
    return float(theta[structure.free + structure.n]) if structure.m == structure.n else 0.0


def _missed_by_lines(problem: ProcessProblem, pole: float, data: ProcessPoint) -> Floats:
    """(N, p) error of the regressors of an output that equals the input, if straight lines replace the input between
    its samples; zero without direct feedthrough.

    data: the filtered problem, whose regressors hold the exact input."""
    structure, missed = problem.structure, np.zeros(data.phi.shape)
    if structure.m < structure.n:
        return missed
    free, first = structure.free, structure.free + structure.integrators
    itself = data.theta.copy()
    itself[free : free + structure.n + 1] = np.r_[structure.denominator(data.theta), 1.0]
    inputs = tuple(
        _replace_output(stretch, simulate(structure, itself, np.zeros(structure.n), stretch, source=0))
        for stretch in problem.stretches
    )
    lines = filter_problem(replace(problem, stretches=inputs), pole).phi[:, :free]
    missed[:, :free] = -data.phi[:, first : first + free] - lines
    return missed


def _replace_output(stretch: RecordStretch, signal: Floats) -> RecordStretch:
    """The stretch with a signal (M,) for output: between measured instants a straight line, as of every output."""
    times = stretch.grid.instants
    return replace(stretch, y=np.interp(times, times[stretch.rows], signal[stretch.rows]))

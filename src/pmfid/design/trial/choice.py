"""The choice of the input to run: the input with the least expected deviations, no worse than the usual profile.

The criteria of a design assume white noise. The error of an encoder is not white. So a design that creeps by whole
counts per sample may have less information than a trapezoid.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from pmfid.design.problem.criteria import Criterion, criterion_of
from pmfid.design.problem.problem import InfeasibleError, Problem
from pmfid.design.problem.result import Design
from pmfid.design.search.evaluation import evaluate
from pmfid.design.search.solver import solve
from pmfid.design.search.standard import standard_inputs
from pmfid.design.trial.encoder_error import expected_covariance
from pmfid.types import Floats

__all__ = ["USUAL", "Choice", "best_input", "choose", "stds"]

#: The profile that engineers use: no parameter may come out worse than with it.
USUAL = "trapezoid"
#: Standard motions that a design is compared with: machines are made for them.
PROFILES = (USUAL, "s_curve", "minimum_time")
#: The expected deviations are themselves known to a few percent.
SURELY = 0.95
#: Least speeds over the one of the limits: the first two leave whole counts per sample, the others keep a machine
#: moving that is heavier, or has more friction, than its data sheet says.
FASTER = (1.23, 1.57, 2.5, 4.0, 6.0)


@dataclass(frozen=True, eq=False)
class Choice:
    """The chosen input. name: "design", "design, least speed x 1.23", or the name of a standard input; design: the
    motion to run; std: {unknown parameter: deviation expected after one run}, in its unit; usual: the same for the
    trapezoid, if it exists."""

    name: str
    design: Design
    std: Mapping[str, float]
    usual: Mapping[str, float]


def choose(design: Design, combination: Mapping[str, float] | None = None, *, starts: int = 5, seed: int = 0) -> Choice:
    """The best input for the problem of a design: that design, others with a larger least speed, or a standard input.

    combination: for criterion "c"; starts, seed: of the search for the others. Where the noise is not that of an
    encoder it is taken for white, the start for unknown.
    """
    problem = design.problem
    inputs = {"design": design.u} | dict(_others(design, combination, starts, seed))
    covariances = {name: expected_covariance(problem, u) for name, u in inputs.items()}
    name = best_input(problem, criterion_of(problem, design.criterion, combination), covariances)
    chosen = design if name == "design" else evaluate(problem, inputs[name], design.criterion, combination=combination)
    return Choice(name, chosen, stds(problem, covariances[name]), stds(problem, covariances.get(USUAL)))


def best_input(problem: Problem, rule: Criterion, covariances: Mapping[str, Floats | None]) -> str:
    """Name of the best of some inputs by their covariances (p, p), in the units of the parameters; None: no estimate.

    Of those that leave every unknown parameter surely better known than the trapezoid does, the first with surely no
    less than the largest value; the trapezoid where there is none. Without a trapezoid, all count.
    """
    usual = stds(problem, covariances.get(USUAL))
    scale = np.outer(problem.scale, problem.scale)

    def value(name: str) -> float:
        covariance = covariances[name]
        return 0.0 if covariance is None else rule.value(np.asarray(np.linalg.inv(covariance / scale), float))

    def better(name: str) -> bool:
        own = stds(problem, covariances[name])
        return all(own[each] <= SURELY * usual[each] for each in problem.unknown)

    fit = [name for name in covariances if name == USUAL or better(name)] or list(covariances)
    values = [value(name) for name in fit]
    return next(name for name, own in zip(fit, values, strict=True) if own >= SURELY**2 * max(values))


def stds(problem: Problem, covariance: Floats | None) -> dict[str, float]:
    """{unknown parameter: standard deviation}, inf if there is no covariance."""
    if covariance is None:
        return dict.fromkeys(problem.unknown, math.inf)
    return {name: math.sqrt(value) for name, value in zip(problem.unknown, covariance.diagonal(), strict=False)}


def _others(
    design: Design, combination: Mapping[str, float] | None, starts: int, seed: int
) -> Iterator[tuple[str, Floats]]:
    """Names and inputs (K,) within the same limits."""
    problem = design.problem
    for factor in FASTER if problem.limits.min_speed > 0 else ():
        limits = replace(problem.limits, min_speed=factor * problem.limits.min_speed)
        try:
            faster = solve(
                replace(problem, limits=limits), design.criterion, combination=combination, starts=starts, seed=seed
            )
        except InfeasibleError:
            continue
        yield f"design, least speed x {factor}", faster.u
    for name in PROFILES:
        try:
            yield name, standard_inputs(problem, seed, (name,))[name].u
        except InfeasibleError:  # the limits leave less room than this profile needs
            continue

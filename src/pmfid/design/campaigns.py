"""Several different motions, repeated in the best proportions: more information per run than the best single one."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from pmfid.design.ascent import Climber, best_mixture, proportions
from pmfid.design.fisher import Affine, Criterion, affine, check_identifiable, criterion_of, eliminate
from pmfid.design.oracle import Oracle
from pmfid.design.polytope import input_set
from pmfid.design.problem import Design, Problem
from pmfid.design.solver import evaluate, solve
from pmfid.errors import UsageError
from pmfid.types import Floats

__all__ = ["Campaign", "campaign"]


@dataclass(frozen=True, eq=False)
class Campaign:
    """Motions and the weights (k,) with which they are repeated; they sum to 1.

    single: the best single motion. fisher: (p, p) information of an average run on the unknown parameters, in their own
    units; value: of the criterion for it; gain: over repeating `single`. ideal: value that any number of motions reach,
    as far as the search finds it.
    """

    motions: tuple[Design, ...]
    weights: Floats
    single: Design
    fisher: Floats
    value: float
    ideal: float
    solve_seconds: float = 0.0

    @property
    def gain(self) -> float:
        return self.value / self.single.value

    def runs(self, total: int) -> tuple[int, ...]:
        """How often to run each motion, `total` in all, by largest remainders (Hamilton)."""
        wanted = self.weights * total
        whole = np.floor(wanted).astype(int)
        whole[np.argsort(whole - wanted)[: total - whole.sum()]] += 1
        return tuple(int(n) for n in whole)


def campaign(
    problem: Problem,
    criterion: str = "D",
    *,
    motions: int = 3,
    combination: Mapping[str, float] | None = None,
    starts: int = 20,
    seed: int = 0,
) -> Campaign:
    """Search for at most `motions` motions that together give the most information per run.

    Prior information counts once per run.

    Parameters
    ----------
    problem
        Equation, parameters and limits.
    criterion
        Name of a concave criterion: not "ME".
    motions
        Largest number of different motions, >= 1.
    combination
        {parameter: weight} for the criterion "c".
    starts, seed
        As of `solve`.

    Returns
    -------
    Campaign
        The `motions`, their `weights`, the best `single` motion and the `gain` over repeating it.

    Raises
    ------
    UsageError
        If the criterion is "ME", which is not concave, or motions < 1; further errors as `solve`.

    Examples
    --------
    >>> from pmfid import Drive
    >>> from pmfid.design import Limits, Problem, campaign
    >>> nominal = {"mass": 1.5, "viscous_friction": 6.0, "coulomb_friction": 0.6}
    >>> limits = Limits(input=3.0, min_speed=0.01)
    >>> problem = Problem(
    ...     Drive(2.0), nominal, ("mass", "viscous_friction"), 2.0, 10, limits, resolution=1e-5, end=(0.4, 0.0)
    ... )
    >>> found = campaign(problem, motions=2, starts=3)
    >>> sum(found.runs(10)), round(float(found.weights.sum()), 6)
    (10, 1.0)
    """
    began = time.perf_counter()
    rule = criterion_of(problem, criterion, combination)
    if not rule.concave or motions < 1:
        raise UsageError(f"a campaign needs a concave criterion (not ME) and motions >= 1, got {criterion}, {motions}")
    single = solve(problem, criterion, combination=combination, starts=starts, seed=seed)
    maps = affine(problem)
    check_identifiable(problem, maps)
    oracle = Oracle(input_set(problem))
    oracle.feasible()
    ideal, inputs = best_mixture(maps, rule, oracle, [single.u], seed)
    chosen, weights = _joint(maps, rule, oracle, _fewest(maps, rule, inputs, motions))
    mean = _mean(maps, chosen, weights)
    return Campaign(
        tuple(evaluate(problem, u, criterion, combination=combination) for u in chosen),
        weights,
        single,
        eliminate(mean / np.outer(maps.scale, maps.scale), rule.size)[0],
        rule.value(mean),
        rule.value(ideal),
        time.perf_counter() - began,
    )


def _fewest(maps: Affine, rule: Criterion, inputs: list[Floats], motions: int) -> list[Floats]:
    """The heaviest inputs of a mixture."""
    while len(inputs) > motions:
        weights = proportions(rule, np.array([maps.information(u) for u in inputs]))
        inputs = [inputs[i] for i in np.sort(np.argsort(-weights)[: max(motions, len(inputs) - 1)])]
    return inputs


def _joint(maps: Affine, rule: Criterion, oracle: Oracle, inputs: list[Floats]) -> tuple[list[Floats], Floats]:
    """Improves the motions in turn, each with the information of all others, until the value is constant.

    Returns the motions and their weights.
    """
    inputs, last = list(inputs), -np.inf
    while True:
        weights = proportions(rule, np.array([maps.information(u) for u in inputs]))
        inputs = [u for u, weight in zip(inputs, weights, strict=True) if weight > 0]
        weights = weights[weights > 0]
        value = float(rule.log_value(_mean(maps, inputs, weights)))
        if value < last + 1e-6:
            return inputs, weights
        last = value
        for i in range(len(inputs)):
            rest = _mean(maps, inputs, weights) - weights[i] * maps.information(inputs[i])
            completed = replace(maps, prior=maps.prior + rest / weights[i])
            inputs[i] = Climber((completed,), rule, oracle).ascend(inputs[i], tolerance=1e-7, steps=100)[1]


def _mean(maps: Affine, inputs: list[Floats], weights: Floats) -> Floats:
    return np.asarray(sum(w * maps.information(u) for w, u in zip(weights, inputs, strict=True)))

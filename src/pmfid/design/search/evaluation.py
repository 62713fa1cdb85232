"""What a given input is worth, and whether it keeps the limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pmfid.design.problem.criteria import Criterion, criterion_of, eliminate
from pmfid.design.problem.fisher import Affine, affine, motion
from pmfid.design.problem.problem import Problem
from pmfid.design.problem.result import Design
from pmfid.design.search.nearest import input_set
from pmfid.design.search.polytope import Polytope, polytope
from pmfid.types import Floats

__all__ = ["Setting", "evaluate", "setting", "violations"]

#: A limit may be missed by so much, relative to the terms that it compares.
PRECISION = 1e-7


@dataclass(frozen=True, eq=False)
class Setting:
    """A problem made ready: the maps of its cases, the criterion, the rows of its limits."""

    problem: Problem
    maps: tuple[Affine, ...]
    rule: Criterion
    shape: Polytope

    def value(self, u: Floats) -> float:
        """Criterion of an input (K,): nominal, or the geometric mean or the worst of the cases."""
        values = [float(self.rule.log_value(maps.information(u))) for maps in self.maps]
        return float(np.exp(min(values) if self.problem.average == "worst" else np.mean(values)))

    def design(self, u: Floats) -> Design:
        """The input with its motion, information and value."""
        x, v = motion(self.problem, u)
        broken = violations(self.shape, u)
        warnings = [f"breaks {name} by {amount:.3g}" for name, amount in broken.items()]
        if not broken and _parks(self.problem, v):
            warnings.append("the motion parks at standstill, where the information is fiction; set min_speed above 0")
        nominal = self.maps[0]
        fisher = eliminate(nominal.information(u) / np.outer(nominal.scale, nominal.scale), self.rule.size)[0]
        common = (self.problem, self.rule.name, self.problem.t, u, x, v, fisher, self.value(u))
        return Design(*common, feasible=not broken, warnings=tuple(warnings))


def setting(problem: Problem, criterion: str, combination: Mapping[str, float] | None = None) -> Setting:
    """Raises UsageError for an unknown criterion or a wrong combination."""
    rule = criterion_of(problem, criterion, combination)
    return Setting(problem, tuple(affine(problem, case) for case in problem.cases), rule, polytope(problem))


def evaluate(
    problem: Problem, u: ArrayLike, criterion: str = "D", *, combination: Mapping[str, float] | None = None
) -> Design:
    """What a given input (K,) is worth; `feasible` and `warnings` say which limits it breaks. Raises UsageError."""
    return setting(problem, criterion, combination).design(np.asarray(u, float))


def violations(shape: Polytope, u: Floats) -> dict[str, float]:
    """{limit: by how much the input breaks it, in its unit}, for those that it breaks."""
    inputs = input_set(shape)
    values = inputs.matrix @ u
    excess = np.maximum(inputs.lower - values, values - inputs.upper)
    size = np.abs(inputs.matrix).sum(axis=1) * max(1.0, float(np.abs(u).max()))
    broken: dict[str, float] = {}
    for i in np.flatnonzero(excess > PRECISION * size):
        broken[inputs.names[i]] = max(float(excess[i]), broken.get(inputs.names[i], 0.0))
    over = float(np.linalg.norm(u)) - shape.radius
    return broken | ({"energy": over} if over > PRECISION * shape.radius else {})


def _parks(problem: Problem, v: Floats) -> bool:
    """Whether the axis stands at a node between two intervals of motion."""
    sense = np.array(problem.sense)
    inside = v[1:-1][(sense[:-1] != 0) & (sense[1:] != 0)]
    return bool(len(inside)) and bool(np.abs(inside).min() < 1e-6 * max(1e-300, np.abs(v).max()))

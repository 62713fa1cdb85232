"""What an input is worth: beside the standard inputs, over time, and with true stiction."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pmfid.design.criteria import Criterion, eliminate
from pmfid.design.fisher import affine
from pmfid.design.problem import Float, Problem
from pmfid.design.result import Design
from pmfid.design.simulated import simulated_information
from pmfid.design.standard import StandardInput, standard_inputs

__all__ = ["Appraisal", "Worth", "appraise", "gathered", "worth_of"]

#: Below this part of the claimed information the design is not what it says.
SURVIVES = 0.95


@dataclass(frozen=True, eq=False)
class Worth:
    """What one run of an input tells.

    fisher: (p, p) on the unknown parameters, in their own units, prior included; value: of the criterion.
    surviving: part of the claimed information that is there with true stiction, the least for parameters that are a
    little larger, smaller or both; None where that cannot be simulated.
    predicted_std: of each unknown parameter after one run; inf where the run and the prior leave it open.
    """

    fisher: Float
    value: float
    surviving: float | None
    predicted_std: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Appraisal:
    """A design beside the standard inputs; worths: by name, that of the design itself as "design"."""

    design: Design
    standard: Mapping[str, StandardInput]
    worths: Mapping[str, Worth]
    warnings: tuple[str, ...]

    @property
    def gain(self) -> dict[str, float]:
        """Value of the design over that of each standard input; inf where that is 0."""
        own = self.worths["design"].value
        values = {name: self.worths[name].value for name in self.standard}
        return {name: own / value if value > 0 else math.inf for name, value in values.items()}

    def to_json(self) -> dict[str, Any]:
        """The object that `--json` prints; null in place of what is infinite or not proved."""
        design, worth = self.design, self.worths["design"]
        return {
            "criterion": design.criterion,
            "value": worth.value,
            "bound": design.bound,
            "gap": design.gap,
            "standard": {name: self.worths[name].value for name in self.standard},
            "gain": {name: _finite(gain) for name, gain in self.gain.items()},
            "surviving": worth.surviving,
            "predicted_std": {name: _finite(std) for name, std in worth.predicted_std.items()},
            "solve_seconds": design.solve_seconds,
            "starts": design.starts,
            "feasible": design.feasible,
            "warnings": list(self.warnings),
        }


def appraise(design: Design, criterion: Criterion, seed: int = 0) -> Appraisal:
    """The design beside the standard inputs; seed: of the PRBS among them."""
    standard = standard_inputs(design.problem, seed)
    inputs = {"design": design.u} | {name: found.u for name, found in standard.items()}
    worths = {name: worth_of(design.problem, criterion, u) for name, u in inputs.items()}
    return Appraisal(design, standard, worths, (*design.warnings, *_warnings(design, worths["design"])))


def worth_of(problem: Problem, criterion: Criterion, u: ArrayLike) -> Worth:
    """What one run of the input u (n,) tells by a criterion."""
    maps = affine(problem)
    F = maps.information(u)
    scale = maps.scale[: criterion.size]
    fisher = eliminate(F, criterion.size)[0] / np.outer(scale, scale)
    return Worth(fisher, criterion.value(F), _surviving(problem, criterion, u, F - maps.prior), _stds(problem, fisher))


def gathered(problem: Problem, criterion: Criterion, u: ArrayLike) -> tuple[Float, Float]:
    """Sample instants (N,) [s] and the value of the criterion for the samples up to each (N,), prior included."""
    maps = affine(problem)
    s = maps.weighted(u)
    F = maps.prior + np.cumsum(np.einsum("in,jn->nij", s, s), axis=0)
    t = np.arange(1, s.shape[1] + 1) * (problem.horizon / s.shape[1])
    values = [criterion.value(each) if np.linalg.matrix_rank(each) == len(each) else 0.0 for each in F]
    return t, np.array(values)


def _surviving(problem: Problem, criterion: Criterion, u: ArrayLike, claimed: Float) -> float | None:
    """Of the run's own information by the same criterion, or by the trace where that gives the run alone no size."""
    if problem.drive.friction != "symmetric":
        return None
    judge = replace(criterion, name="trace") if criterion.name == "ME" else criterion
    if not judge.value(claimed) > 1e-9 * np.trace(claimed):
        judge = Criterion("trace", len(claimed))
    scale = np.outer(problem.scale, problem.scale)
    true = [judge.value(simulated_information(problem, u, side=side) * scale) for side in (-1, 0, 1)]
    whole = judge.value(claimed)
    return min(true) / whole if whole > 0 else None


def _stds(problem: Problem, fisher: Float) -> dict[str, float]:
    scale = problem.scale[: len(problem.unknown)]
    values, vectors = np.linalg.eigh(fisher * np.outer(scale, scale))
    with np.errstate(divide="ignore"):
        variance = (vectors**2 / np.where(values > 1e-12 * values[-1], values, 0.0)).sum(axis=1)
    return {name: float(std) for name, std in zip(problem.unknown, scale * np.sqrt(variance), strict=True)}


def _warnings(design: Design, worth: Worth) -> list[str]:
    if worth.surviving is None:
        return ["the design was not checked with stiction, which the simulation has for symmetric friction only"]
    careful = design.problem.limits.min_speed > 0
    if worth.surviving >= SURVIVES and careful:
        return []
    part = f"{100 * worth.surviving:.0f} % of the claimed information survives a simulation with stiction"
    return [f"{part}; raise min_speed" if careful else f"{part}; min_speed is 0: set it above"]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None

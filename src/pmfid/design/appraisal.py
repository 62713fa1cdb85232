"""Value of an input on machines around the nominal one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from pmfid.design.body import simulated_information
from pmfid.design.expected import expected_covariance
from pmfid.design.fisher import Criterion
from pmfid.design.problem import Design, Problem
from pmfid.design.solver import Setting, evaluate, setting
from pmfid.design.standard import StandardInput, standard_inputs
from pmfid.presentation import Presentable, Summary, plain_dict
from pmfid.types import Floats

#: Factor for "better", and part of the claimed information that must survive stiction. The expected deviations
#: themselves are known to 10 % at best (`EXPECTED_MACHINES`).
APPRAISAL_SURELY = 0.95
#: Parts of the nominal values for which information must survive. An axis may just stop, or just fail to stop.
APPRAISAL_NEAR = (0.9999, 1.0, 1.0001)

__all__ = ["USUAL", "Choice", "best_input", "choose", "stds"]

#: Engineers usually run the trapezoid, so no parameter may come out worse than with this profile.
USUAL = "trapezoid"


@dataclass(frozen=True, eq=False)
class Choice:
    """The chosen input: its name, the motion to run, and the expected deviations `std` of the unknown parameters."""

    name: str
    design: Design
    std: Mapping[str, float]


def choose(design: Design, seed: int = 0) -> Choice:
    """Choose the best input among a design and the standard inputs. `seed` is that of `appraise`.

    Without a linear equation, the design itself is the best of the standard inputs, improved.
    """
    problem = design.problem
    if not problem.linear:
        return Choice("design", design, stds(problem, expected_covariance(problem, design.u)))
    appraisal = appraise(design, seed)
    name = appraisal.recommended
    chosen = design if name == "design" else evaluate(problem, appraisal.standard[name].u, design.criterion)
    return Choice(name, chosen, appraisal.expect_std(name))


def best_input(problem: Problem, rule: Criterion, covariances: Mapping[str, Floats | None]) -> str:
    """Return the name of the best input. The covariances (p, p) by input are in units of the parameters.

    None stands for an input without an estimate. Only inputs count that surely estimate every unknown parameter better
    than the trapezoid. The first of these inputs whose value is surely no less than the largest value wins. If no input
    qualifies, the trapezoid wins. Without a trapezoid, all inputs are candidates.
    """
    usual = stds(problem, covariances.get(USUAL))
    scale = np.outer(problem.scale, problem.scale)

    def value(name: str) -> float:
        covariance = covariances[name]
        return 0.0 if covariance is None else rule.value(np.asarray(np.linalg.inv(covariance / scale), float))

    def better(name: str) -> bool:
        own = stds(problem, covariances[name])
        return all(own[each] <= APPRAISAL_SURELY * usual[each] for each in problem.unknown)

    fit = [name for name in covariances if name == USUAL or better(name)] or list(covariances)
    values = [value(name) for name in fit]
    return next(name for name, own in zip(fit, values, strict=True) if own >= APPRAISAL_SURELY**2 * max(values))


def stds(problem: Problem, covariance: Floats | None) -> dict[str, float]:
    """Return the standard deviation of each unknown parameter, or infinity without a covariance."""
    if covariance is None:
        return dict.fromkeys(problem.unknown, math.inf)
    return {name: math.sqrt(value) for name, value in zip(problem.unknown, covariance.diagonal(), strict=False)}


@dataclass(frozen=True, eq=False)
class Worth:
    """The information of one run of an input.

    `value` is the value of the criterion. `surviving` is the part of the claimed information that remains with true
    stiction. It is the least value over nominal, slightly larger and slightly smaller parameters. `predicted_std` is
    the standard deviation of each unknown parameter after one run. A standard deviation is infinite if run and prior do
    not determine the parameter. `covariance` (p, p) belongs to the estimate of unknown and nuisance parameters by
    `pmfid design SPEC RECORD`, in their units (`expected_covariance`). `covariance` decides on the choice of an input,
    and is None if a parameter is undetermined.
    """

    value: float
    surviving: float
    predicted_std: Mapping[str, float]
    covariance: Floats | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Appraisal(Presentable):
    """A design compared with the standard inputs.

    `worths` has the worth of each input by its name, "design" for the design itself.
    """

    design: Design
    rule: Criterion
    standard: Mapping[str, StandardInput]
    worths: Mapping[str, Worth]
    warnings: tuple[str, ...]

    @property
    def gain(self) -> dict[str, float]:
        """Value of the design over the value of each standard input, infinite where a standard input has the value
        0."""
        own = self.worths["design"].value
        values = {name: self.worths[name].value for name in self.standard}
        return {name: own / value if value > 0 else math.inf for name, value in values.items()}

    @property
    def recommended(self) -> str:
        """Name of the input with the best estimate, which leaves no unknown parameter worse than the trapezoid does."""
        covariances = {name: worth.covariance for name, worth in self.worths.items()}
        return best_input(self.design.problem, self.rule, covariances)

    @property
    def ranking(self) -> tuple[str, ...]:
        """The names of all inputs, the recommended input first."""
        return (self.recommended, *(name for name in self.worths if name != self.recommended))

    def expect_std(self, name: str) -> dict[str, float]:
        """Return the standard deviation of each unknown parameter that decides on the recommendation."""
        return stds(self.design.problem, self.worths[name].covariance)

    def summary(self) -> Summary:
        """Return the predicted standard deviations of each input, with lines for the design and the recommended
        input."""
        unknown = self.design.problem.unknown
        predicted = {name: self.worths[name].predicted_std for name in self.ranking}
        rows = [(name, *(f"{std[own]:.2g}" for own in unknown)) for name, std in predicted.items()]
        title = f"{self.design.criterion}, standard deviations after one run; to be run: {self.recommended}"
        own = [row for row in rows if row[0] in ("design", self.recommended)]
        lines = [
            f"{row[0]}: {', '.join(f'{n} ± {std}' for n, std in zip(unknown, row[1:], strict=True))}" for row in own
        ]
        return Summary(title, ("input", *unknown), rows, lines, self.warnings)

    def columns(self) -> dict[str, object]:
        """Return a table with a row for each input."""
        stds = [worth.predicted_std for worth in self.worths.values()]
        values = {"input": list(self.worths), "value": [worth.value for worth in self.worths.values()]}
        return values | {f"{name}_std": [std[name] for std in stds] for name in self.design.problem.unknown}

    def to_dict(self) -> dict[str, object]:
        """Return the object that `--json` prints."""
        design, worth = self.design, self.worths["design"]
        return plain_dict(
            {
                "criterion": design.criterion,
                "value": worth.value,
                "bound": design.bound,
                "gap": design.gap,
                "standard": {name: self.worths[name].value for name in self.standard},
                "gain": self.gain,
                "surviving": worth.surviving,
                "predicted_std": worth.predicted_std,
                "predicted_std_encoder": self.expect_std("design"),
                "recommended": self.recommended,
                "solve_seconds": design.solve_seconds,
                "starts": design.starts,
                "feasible": design.feasible,
                "warnings": self.warnings,
            }
        )


def appraise(design: Design, seed: int = 0) -> Appraisal:
    """Compare a design with the standard inputs.

    Parameters
    ----------
    design
        Result of `solve` or `evaluate`.
    seed
        Seed of the PRBS.

    Returns
    -------
    Appraisal
        Value and predicted standard deviations of each input, `gain` over each standard input, and the `recommended`
        input.

    Raises
    ------
    UsageError, InfeasibleError
        The same errors as `solve`.

    Examples
    --------
    >>> from pmfid import Drive
    >>> from pmfid.design import Limits, Problem, appraise, solve
    >>> nominal = {"mass": 1.5, "viscous_friction": 6.0, "coulomb_friction": 0.6}
    >>> problem = Problem(
    ...     Drive(2.0), nominal, ("mass",), 2.0, 10, Limits(input=3.0, min_speed=0.01), resolution=1e-5, end=(0.4, 0.0)
    ... )
    >>> found = appraise(solve(problem, starts=3))
    >>> found.gain["trapezoid"] > 1.0, "design" in found.worths
    (True, True)
    """
    problem = design.problem
    ready = setting(problem, design.criterion)
    standard = standard_inputs(problem, seed)
    inputs = {"design": design.u} | {name: found.u for name, found in standard.items()}
    worths = {name: worth_of(ready, u) for name, u in inputs.items()}
    warnings = *design.warnings, *_stiction_warnings(design, worths["design"])
    return Appraisal(design, ready.rule, standard, worths, warnings)


def worth_of(ready: Setting, u: Floats) -> Worth:
    """Return the information from one run of the input u (n,)."""
    problem, maps = ready.problem, ready.maps
    covariance = expected_covariance(problem, u)
    F = maps.information(u)
    return Worth(
        ready.value(u),
        _surviving(problem, ready.rule, u, F - maps.prior),
        ready.design(u).predicted_std,
        covariance,
    )


def _surviving(problem: Problem, criterion: Criterion, u: ArrayLike, claimed: Floats) -> float:
    """Return the part of the run's information that survives stiction, by the criterion of the design.

    If the criterion has no value for the run without a prior, the trace decides.
    """
    judge = replace(criterion, name="trace") if criterion.name == "ME" else criterion
    if not judge.value(claimed) > 1e-9 * np.trace(claimed):
        judge = Criterion("trace", len(claimed))
    scale, whole = np.outer(problem.scale, problem.scale), judge.value(claimed)
    near = [{name: part * value for name, value in problem.nominal.items()} for part in APPRAISAL_NEAR]
    true = [judge.value(simulated_information(problem, u, each) * scale) for each in near]
    return min(true) / whole if whole > 0 else 0.0


def _stiction_warnings(design: Design, worth: Worth) -> list[str]:
    careful = design.problem.limits.min_speed > 0
    if worth.surviving >= APPRAISAL_SURELY and careful:
        return []
    part = f"{100 * worth.surviving:.0f} % of the claimed information survives a simulation with stiction"
    return [f"{part}; raise min_speed" if careful else f"{part}; set min_speed above 0"]

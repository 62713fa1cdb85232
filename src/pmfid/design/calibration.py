"""Parameters from designed runs: the fit of `pmfid.fit` with what is known before.

A designed run starts at a known velocity, and some parameters are known. The fit begins at the nominal values. Its
coordinates are the distances from them, so that prior information is about zero and independent. Forces are per nominal
mass, of which the fit searches the logarithm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmfid.design.body import body_of, excite, prior_of, separate
from pmfid.design.problem import Problem, parameters_of
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.findings import NEGLIGIBLE, Finding
from pmfid.fit.compare import NORMAL_95
from pmfid.fit.findings import findings_of
from pmfid.fit.fit import Fitted, fit
from pmfid.fit.likelihood import ROUNDING
from pmfid.fit.machine import COULOMB, MASS, OFFSET, VISCOUS, BodyModel
from pmfid.fit.problem import FitProblem, ObservedStretch
from pmfid.fit.search import FitSearch
from pmfid.fit.solve import Optimum, solve
from pmfid.fit.starts import make_first_body, soften
from pmfid.fit.within import stack
from pmfid.types import Floats

__all__ = ["DesignedRun", "RunsEstimate", "calibrate"]

#: Findings against the model of a fit.
AGAINST_MODEL = ("unmodelled", "dead_time", "implausible")


@dataclass(frozen=True, eq=False)
class DesignedRun:
    """An experiment with a designed input.

    Only changes of y count. The zero of y is free, because the start phase on the encoder's lattice is unknown.

    Parameters
    ----------
    u
        (n,) input [V], held from sample k to k+1.
    y
        (n,) measured position at sample k [m].
    dt
        Sample period [s].

    Raises
    ------
    UsageError
        If the arrays do not fit each other or are not finite.

    Examples
    --------
    >>> from pmfid.design import DesignedRun
    >>> run = DesignedRun([2.0, 2.0, 0.0], [0.0, 0.01, 0.03], dt=0.1)
    >>> run.dt
    0.1
    """

    u: Floats
    y: Floats
    dt: float

    def __post_init__(self) -> None:
        u, y = np.asarray(self.u, float), np.asarray(self.y, float)
        if u.ndim != 1 or u.shape != y.shape or not (np.isfinite(u).all() and np.isfinite(y).all()):
            raise UsageError(f"a run needs finite u and y of the same length, got shapes {u.shape} and {y.shape}")

    def observe(self, problem: Problem) -> ObservedStretch:
        """Return the observations, with forces per nominal mass. Without an encoder, a count is a standard deviation of
        the noise."""
        y, counted = np.asarray(self.y, float), np.full(len(self.y), problem.counted)
        variance = np.where(counted, ROUNDING, 1.0)
        drive = excite(problem, np.asarray(self.u, float)[:-1], self.dt)
        drive = replace(drive, u=drive.u / problem.nominal[problem.lead])
        return ObservedStretch(drive, y - y[0], variance, counted, np.zeros(y.size, bool), speed=problem.start[1])


@dataclass(frozen=True, eq=False)
class RunsEstimate:
    """The estimate from all runs.

    `parameters` maps each name to its value, known parameters included. `information` (p, p) of unknown and nuisance
    parameters, in their units, includes the prior. The inverse of the information is the covariance of the parameters.
    `interval` maps each of these names to the lowest and highest value of an interval that holds 95 %, over the model
    and the models next to it. `misfit` is the root mean square of the residual over that of rounding, or of the noise.
    `findings` name the unmodelled effects.
    """

    parameters: dict[str, float]
    information: Floats
    interval: dict[str, tuple[float, float]]
    misfit: float
    findings: tuple[Finding, ...]

    @property
    def unmodelled(self) -> bool:
        """Whether an unmodelled effect matters."""
        return any(one.code in AGAINST_MODEL and one.severity != "note" for one in self.findings)

    def std(self, names: tuple[str, ...]) -> dict[str, float]:
        """Return the standard deviation of each parameter in `names`, which follows the order of the information."""
        variance = np.linalg.inv(self.information).diagonal()
        return {name: float(np.sqrt(value)) for name, value in zip(names, variance, strict=True)}

    def update(self, problem: Problem) -> Problem:
        """Return the problem with the estimates as nominal values and the information as the prior.

        The scenarios move with the nominal values.
        """
        moved = {name: self.parameters[name] / (value or 1.0) for name, value in problem.nominal.items()}
        scenarios = tuple({name: value * moved[name] for name, value in case.items()} for case in problem.scenarios)
        return replace(problem, nominal=dict(self.parameters), prior=self.information, scenarios=scenarios)


def calibrate(problem: Problem, runs: Sequence[DesignedRun]) -> RunsEstimate:
    """Estimate unknown and nuisance parameters of a problem from its runs.

    The prior is centred on the nominal values.

    Parameters
    ----------
    problem
        Equation, nominal parameters, encoder and prior.
    runs
        At least one run.

    Returns
    -------
    RunsEstimate
        All `parameters`, their `information` (p, p), and a 95 % `interval` for each estimate.

    Raises
    ------
    UsageError
        If there is no run.
    NotIdentifiableError
        If the runs leave a parameter open, or the simulated position does not follow.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import Drive
    >>> from pmfid.design import Limits, Problem, calibrate, evaluate, simulated_experiment
    >>> nominal = {"mass": 1.5, "viscous_friction": 6.0, "coulomb_friction": 0.6}
    >>> problem = Problem(Drive(2.0), nominal, ("mass",), 2.0, 10, Limits(input=3.0), resolution=1e-5)
    >>> experiment = simulated_experiment(problem, {"mass": 1.8}, np.random.default_rng(0))
    >>> estimate = calibrate(problem, [experiment(evaluate(problem, np.full(10, 2.0)))])
    >>> round(estimate.parameters["mass"], 2)
    1.8
    """
    if not runs:
        raise UsageError("the list of runs is empty; give at least one run")
    body, size = DesignedBody.make(problem), float(np.sqrt(problem.variance * (12 if problem.counted else 1)))
    fitted = fit(FitProblem(body.model, tuple(run.observe(problem) for run in runs), size), NominalSearch)
    body.check_determined(fitted)
    return body.estimate(body.to_units(fitted))


@dataclass(frozen=True, eq=False)
class DesignedBody:
    """The body of a problem in the coordinates of the fit.

    The p parameters `names` of the fit are those of the problem, the mass as the last one. `mixing` (p, p) is the
    matrix with unit diagonal that makes their prior independent. `units` (p,) is the nominal mass for a coefficient of
    the equation of forces, and 1 for a time or a speed. A known mass is a coordinate without effect.
    """

    problem: Problem
    names: tuple[str, ...]
    units: Floats
    mixing: Floats
    model: BodyModel

    @classmethod
    def make(cls, problem: Problem) -> DesignedBody:
        """Return the body of a problem."""
        whole = body_of(problem)
        if whole.elastic:
            raise UsageError(
                "designed runs of two masses have no estimate here; run pmfid identify with body = 'two-mass' in "
                "[model], and put its values into [drive]"
            )
        names = (*(name for name in problem.names if name != problem.lead), problem.lead)
        free = [whole.names.index(name) for name in names]
        units = np.where(np.isin(whole.names, problem.drive.equation.names), problem.nominal[problem.lead], 1.0)
        nominal = np.array([problem.nominal[name] for name in whole.names]) / units
        mixing, precision = separate(prior_of(problem, names) * np.outer(units[free], units[free]))
        lift, rest = whole.lift[:, free] @ mixing, whole.rest + whole.lift @ nominal
        if problem.lead in problem.names:
            rest -= lift[:, -1]
        else:
            lift[:, -1], precision[-1] = 0.0, 1.0
        alone = np.count_nonzero(mixing, axis=1) == 1
        lowest = np.where(alone, whole.lowest[free] - nominal[free], -np.inf)
        lowest[-1] = -np.inf
        model = BodyModel(names, whole.forces, rest, lift, len(names) - 1, lowest, precision=precision)
        return cls(problem, names, units[free], mixing, model)

    def check_determined(self, fitted: Fitted) -> None:
        """Raise NotIdentifiableError if runs and prior leave a parameter of the problem open."""
        J = stack(fitted.problem.linearise(fitted.solution.q, fitted.solution.starts))[1][:, : len(self.names)]
        known = np.any(J, axis=0) | np.asarray(self.model.precision, bool)
        open_ = [name for name, shown in zip(self.names, known, strict=True) if not shown]
        if open_:
            raise NotIdentifiableError(
                f"the runs do not determine {', '.join(open_)}; make another run, or remove a parameter from the list "
                '"unknown"'
            )

    def to_units(self, fitted: Fitted) -> Fitted:
        """Return a fit with the parameters of the problem, in their units and order."""
        lift = (self.units[:, None] * self.mixing)[[self.names.index(name) for name in self.problem.names]]
        middle = np.eye(len(self.names))[-1]
        nominal = np.array([self.problem.nominal[name] for name in self.problem.names])
        return replace(
            fitted,
            theta=nominal + lift @ (fitted.theta - middle),
            covariance=lift @ fitted.covariance @ lift.T,
            half=np.abs(lift) @ fitted.half,
            reach=np.abs(lift) @ fitted.reach,
            plain=nominal + lift @ (fitted.plain - middle),
        )

    def estimate(self, fitted: Fitted) -> RunsEstimate:
        """Return the estimate of a fit in units of the problem."""
        names, std = self.problem.names, np.sqrt(np.diag(fitted.covariance))
        size = np.maximum(np.abs(fitted.theta), np.abs([self.problem.nominal[name] for name in names]))
        positive = np.array([parameters_of(self.problem.drive)[name] for name in names])
        half = np.maximum(fitted.half, NORMAL_95 * std)
        findings = tuple(findings_of(fitted, names, positive, size, NEGLIGIBLE))
        variance = np.concatenate([one.variance for one in fitted.problem.stretches])
        residual = np.concatenate(fitted.residuals) / np.sqrt(variance)
        low = np.where(positive, np.maximum(fitted.theta - half, 0.0), fitted.theta - half)
        intervals = zip(low.tolist(), (fitted.theta + half).tolist(), strict=True)
        return RunsEstimate(
            {**self.problem.nominal, **dict(zip(names, fitted.theta.tolist(), strict=True))},
            np.asarray(np.linalg.inv(fitted.covariance), float),
            dict(zip(names, intervals, strict=True)),
            float(np.sqrt(np.mean(residual**2))),
            findings,
        )


class NominalSearch(FitSearch):
    """A search from the nominal values, where all coordinates but the mass are zero."""

    def find_start(self, problem: FitProblem) -> tuple[FitProblem, Optimum]:
        """Return the first fit from the nominal values, to the liveliest run."""
        stretch = max(problem.stretches, key=lambda one: float(np.sum(np.abs(np.diff(one.y)))))
        force = float(np.sqrt(np.mean(stretch.drive.u**2)))
        if not (np.ptp(stretch.y) > 0 and force > 0):
            raise NotIdentifiableError("the axis does not move in these runs; check the input and the encoder")
        first = make_first_body(0.0)
        travel = max(float(np.ptp(stretch.y)) / 2, problem.resolution)
        prior = np.array([0.0, 0.0, 0.0, (0.5 * force) ** -2, (travel / (0.5 * force)) ** 2])
        start = FitProblem(first, (stretch,), problem.resolution)
        body = problem.machine.body(np.eye(len(problem.machine.names))[problem.machine.lead])
        theta = np.append(body[[MASS, VISCOUS, COULOMB, OFFSET]], 0.0)
        return start, solve(start, soften((stretch,)), start.start(theta), start.first_starts(), prior, 25, 0.1)

    def first_theta(self, share: float) -> Floats:
        """Return the nominal values."""
        return np.asarray(np.eye(self.count)[self.plain.machine.lead])

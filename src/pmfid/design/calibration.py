"""Parameters from designed runs, by simulation of the position, with prior information.

The general estimators find all parameters from one long record. A designed run is short, starts as designed, and some
parameters are known. The others follow from a small nonlinear problem around a good guess. If the position has normal
noise, the solution is least squares. For counts, the solution is the set of parameters that fit all counts (`counted`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from pmfid.design.encoder_error import is_counted, what_is_open
from pmfid.design.problem import Problem
from pmfid.design.simulated import drive_of
from pmfid.design.tuning import TUNING
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.simulation.drive import simulate_drive
from pmfid.types import Floats

__all__ = ["DesignedRun", "RunsEstimate", "calibrate"]

#: Least value of a parameter over its nominal value. Parameters that are not listed stay at 0 or above.
LEAST = {"mass": 1e-3, "offset": -np.inf}


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


@dataclass(frozen=True, eq=False)
class RunsEstimate:
    """The estimate from all runs.

    `parameters` maps each name to its value, known parameters included. `information` (p, p) of unknown and nuisance
    parameters, in their units, includes the prior. The inverse of the information is the covariance of the parameters.
    `interval` maps each of these names to the lowest and highest value of an interval that holds 95 %. For normal
    noise, `inflation` is the ratio of residual to noise variance, times the number of correlated samples. An inflation
    above 1 divides the information of the runs. For counts the inflation is 1. `unexplained` is the largest distance of
    the best motion from a count, in counts. A distance above 0 is an error of the model, and all counts were widened by
    twice this distance.
    """

    parameters: Mapping[str, float]
    information: Floats
    interval: Mapping[str, tuple[float, float]]
    inflation: float = 1.0
    unexplained: float = 0.0

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
    objective = _Objective(problem, runs)
    found = least_squares(
        objective,
        objective.start,
        objective.jacobian,
        bounds=(objective.lower, np.inf),
        max_nfev=TUNING.max_evaluations,
    )
    J = objective.jacobian(found.x)
    _check(problem, objective, found.x, J)
    by = _estimate_by_counts if is_counted(problem) else _estimate_by_squares
    return by(problem, objective, found.x, J)


def _estimate_by_squares(problem: Problem, objective: _Objective, q: Floats, J: Floats) -> RunsEstimate:
    inflation = objective.inflation(q)
    information = (J.T @ J - objective.prior) / max(1.0, inflation) + objective.prior
    apart = TUNING.calibration_normal * np.sqrt(np.linalg.inv(information).diagonal())
    interval = np.column_stack([q - apart, q + apart]) * objective.scale[:, None]
    scale = np.outer(objective.scale, objective.scale)
    return RunsEstimate(objective.parameters(q), information / scale, _name_intervals(problem, interval), inflation)


def _estimate_by_counts(problem: Problem, objective: _Objective, q: Floats, J: Floats) -> RunsEstimate:
    found = what_is_open(
        objective.counts, q, np.asarray(np.linalg.inv(J.T @ J), float), objective.lower, objective.root
    )
    information = np.linalg.inv(found.covariance * np.outer(objective.scale, objective.scale))
    interval = found.interval * objective.scale[:, None]
    parameters = objective.parameters(found.mean)
    return RunsEstimate(parameters, information, _name_intervals(problem, interval), unexplained=found.unexplained)


def _name_intervals(problem: Problem, interval: Floats) -> dict[str, tuple[float, float]]:
    return {name: (float(low), float(high)) for name, (low, high) in zip(problem.names, interval, strict=True)}


class _Objective:
    """Residuals of all runs over the encoder's deviation, then the residuals of the prior.

    The residuals of each run have zero mean. The variables are q = theta / scale.
    """

    def __init__(self, problem: Problem, runs: Sequence[DesignedRun]) -> None:
        self.problem, self.runs = problem, runs
        nominal = np.array([problem.nominal[name] for name in problem.names])
        self.scale = np.where(nominal != 0, np.abs(nominal), 1.0)
        self.start = nominal / self.scale
        self.lower = np.array([LEAST.get(name, 0.0) for name in problem.names])
        prior = np.zeros((nominal.size, nominal.size)) if problem.prior is None else np.asarray(problem.prior)
        self.prior = prior * np.outer(self.scale, self.scale)
        values, vectors = np.linalg.eigh(self.prior)
        self.root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T

    def parameters(self, q: Floats) -> dict[str, float]:
        found = dict(zip(self.problem.names, (q * self.scale).tolist(), strict=True))
        return {name: found.get(name, value) for name, value in self.problem.nominal.items()}

    def positions(self, parameters: Mapping[str, float]) -> list[Floats]:
        drive = drive_of(self.problem, parameters)
        return [centre(simulate_drive(drive, run.u, run.dt, 0.0, self.problem.start[1]).x) for run in self.runs]

    def data(self, q: Floats) -> Floats:
        pairs = zip(self.positions(self.parameters(q)), self.runs, strict=True)
        return np.asarray(np.concatenate([x - centre(run.y) for x, run in pairs]) / np.sqrt(self.problem.variance))

    def counts(self, q: Floats) -> list[Floats]:
        """Return the simulated position minus the measured position of each run, in counts."""
        size = float(self.problem.resolution or 1.0)
        pairs = zip(self.positions(self.parameters(q)), self.runs, strict=True)
        return [(x - centre(run.y)) / size for x, run in pairs]

    def __call__(self, q: Floats) -> Floats:
        return np.asarray(np.r_[self.data(q), self.root @ (q - self.start)])

    def jacobian(self, q: Floats) -> Floats:
        columns = []
        for i in range(q.size):
            low, high = (np.array(q, float) for _ in range(2))
            # The step is relative to the nominal value, because an estimate may be 0, at its bound.
            low[i], high[i] = max(q[i] - TUNING.simulated_step, self.lower[i]), q[i] + TUNING.simulated_step
            columns.append((self.data(high) - self.data(low)) / (high[i] - low[i]))
        return np.vstack([np.column_stack(columns), self.root])

    def inflation(self, q: Floats) -> float:
        residual = self.data(q)
        free = max(1, residual.size - len(self.runs) - q.size)
        ends = np.cumsum([run.y.size for run in self.runs])[:-1]
        return float(residual @ residual) / free * correlation_time(np.split(residual, ends))


def correlation_time(residuals: Sequence[Floats]) -> float:
    """Return 1 + 2 sum of the autocorrelations of the residuals, up to the first that white noise explains."""
    power = sum(float(e @ e) for e in residuals)
    total = 1.0
    for lag in range(1, max(e.size for e in residuals)):
        rho = sum(float(e[lag:] @ e[:-lag]) for e in residuals if e.size > lag) / max(power, 1e-300)
        if rho <= 2 / np.sqrt(sum(e.size for e in residuals)):  # white noise explains this correlation
            break
        total += 2 * rho
    return total


def centre(y: Floats) -> Floats:
    """Return y (n,) minus its mean."""
    return np.asarray(y - np.mean(y))


def _check(problem: Problem, objective: _Objective, q: Floats, J: Floats) -> None:
    motion = float(
        np.linalg.norm(np.concatenate([centre(run.y) for run in objective.runs]) / np.sqrt(problem.variance))
    )
    left = float(np.linalg.norm(objective.data(q)))
    if left > TUNING.worst_fit * motion:
        raise NotIdentifiableError(
            f"the simulated position has an error of {left / max(motion, 1e-300):.0%} of the motion; check that "
            "input_gain has the right sign and size, that the run starts at rest, and that the model has every load"
        )
    size = np.linalg.norm(J, axis=0)
    open_ = [name for name, s in zip(problem.names, size, strict=True) if not s > 1e-9 * size.max()]
    if open_ or np.linalg.cond(J / size) > 1e6:
        raise NotIdentifiableError(
            f"the runs do not determine {', '.join(open_ or problem.names)}; make another run, or remove a parameter "
            'from the list "unknown"'
        )

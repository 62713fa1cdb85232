"""Refined instrumental variables for transfer functions, off-line and recursive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.encoder import Encoder
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.base import Estimator
from pmfid.estimators.batch import TARGET_APART, BatchEstimator
from pmfid.estimators.configuration import check_arrays, check_size, hold_last_input
from pmfid.estimators.cutoff import STRETCH
from pmfid.estimators.least_squares import parts_of_their_own
from pmfid.estimators.results import Fit
from pmfid.linear.counts import explain_counts
from pmfid.linear.experiment import Experiment
from pmfid.linear.process import Process
from pmfid.linear.residuals import covariance
from pmfid.linear.responses import Structure
from pmfid.linear.solve import (
    ProcessPoint,
    ProcessProblem,
    Solution,
    cost_at,
    keep_outputs_after,
    solve,
    solve_dead_time,
)
from pmfid.models.drive import Model
from pmfid.models.equation import ESTIMATE, Equation
from pmfid.models.transfer_function import MAX_DELAY, TransferFunction

#: Largest relative difference of two sample periods that count as equal.
SAME_PERIOD = 0.05


@dataclass(frozen=True)
class ProcessFit(Fit):
    """A `Fit` of a transfer function. `process` is the transfer function itself, with poles, zeros and responses.
    `passes` counts the iterations. `explained` says whether the response stays within every count of the output."""

    process: Process
    passes: int
    explained: bool


@dataclass(frozen=True)
class SRIVC(BatchEstimator):
    """Simplified refined instrumental variables for continuous time (Young and Jakeman 1980; Young 2011, chapter 8).

    Parameters
    ----------
    model : TransferFunction
    encoder : Encoder, optional
    dt : float
        Sample period [s].
    cutoff : float
        Pole of the filters of the first estimate [rad/s].

    Raises
    ------
    UsageError
        The model is no `TransferFunction`.

    Notes
    -----
    The method solves sum zeta (z - phi^T theta) = 0. The filter 1/A(s) of the estimate applies to all signals. The
    instruments zeta come from the output that the estimate simulates from the input. The iteration starts from least
    squares with filters of the pole `cutoff`. Unstable intermediate models are reflected. If the iteration does not
    converge, the method minimises the output error (Levenberg and Marquardt) and tries further filters.

    If the output is rounded, and a response stays within every count, the estimate is the mean of all parameters with
    such a response, and theta_cov is their covariance. Rounding then is no noise (`linear/counts.py`).

    The method has no discretisation error. Initial conditions are always unknown and part of the fit. The method is
    efficient for white output noise, and consistent for any noise without correlation to the input. theta_cov holds for
    noise of any colour. `fit` takes u and counts. `fit_experiments` takes records with gaps, missing samples, other
    holds and a reference.

    Examples
    --------
    A first-order lag, 2 / (s + 2), from `Experiment`:

    >>> import numpy as np
    >>> from pmfid import Encoder, Experiment, SRIVC, TransferFunction
    >>> rng, a = np.random.default_rng(1), np.exp(-0.02)
    >>> u, y = np.repeat(rng.choice([-1.0, 1.0], 50), 20), np.zeros(1000)
    >>> for k in range(999):
    ...     y[k + 1] = a * y[k] + (1 - a) * u[k]
    >>> srivc = SRIVC(TransferFunction(1, 0), Encoder(1e-6), 0.01, 2.0)
    >>> fit = srivc.fit_experiments([Experiment(u, y + 0.01 * rng.standard_normal(1000), dt=0.01)])
    >>> fit.theta.round(1)
    array([2., 2.])
    """

    method: ClassVar[str] = "srivc"

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.model, TransferFunction):  # initial conditions are no parameters of the model
            object.__setattr__(self, "model", replace(self.model, initial_conditions=False))

    @classmethod
    def refuses(cls, equation: Equation) -> str:
        return "" if equation.process else "srivc works on a transfer function; for a machine use fit or iv"

    def fit(self, u: ArrayLike, counts: ArrayLike) -> ProcessFit:
        """Return the estimate from u and counts (n,). Raises UsageError for arrays that do not fit each other, and
        NotIdentifiableError if the record cannot identify every parameter."""
        return self.fit_experiments([make_experiment(self, u, counts)])

    def fit_experiments(self, experiments: Sequence[Experiment]) -> ProcessFit:
        """Return the estimate from several records at once.

        `delay` of the model counts in periods of the estimator's `dt`. Raises UsageError without a usable record, and
        NotIdentifiableError as `fit`.
        """
        check_experiments(self, experiments)
        problem = make_problem(self, experiments)
        check_signals(problem, self.names)
        with np.errstate(all="ignore"):  # an intermediate model may be far off, and non-finite values are rejected
            if problem.structure.latest is None:
                solution = solve(problem)
            else:
                problem, solution = solve_dead_time(problem)
        return result(self, problem, solution)


def make_experiment(estimator: Estimator, u: ArrayLike, counts: ArrayLike) -> Experiment:
    """Return the record as an `Experiment` with the position of the counts. Held values replace non-finite inputs."""
    u, counts = check_arrays(u, counts)
    check_size(u)
    if u.size < 2:
        raise NotIdentifiableError("the record has fewer than two samples; record longer")
    return Experiment(hold_last_input(u), estimator.encoder.position(counts), dt=estimator.dt)


def check_experiments(estimator: Estimator, experiments: Sequence[Experiment]) -> None:
    """Raise UsageError for missing experiments, or for experiments with another sample period than the estimator's."""
    listed = isinstance(experiments, Sequence) and all(isinstance(part, Experiment) for part in experiments)
    if not listed or not experiments:
        raise UsageError("experiments must be a list of Experiments; write [experiment] for a single one")
    for part in experiments:
        mean = float(part.times[-1] - part.times[0]) / (part.times.size - 1)  # jitter moves the median, gaps the mean
        if min(abs(step / estimator.dt - 1) for step in (part.period, mean)) > SAME_PERIOD:
            raise UsageError(
                f"dt of the estimator is {estimator.dt:.9g} s, but {part.name} has a sample every "
                f"{part.period:.9g} s; give the estimator the dt of the data, because it counts the delay in "
                "samples"
            )


def make_problem(estimator: Estimator, experiments: Sequence[Experiment]) -> ProcessProblem:
    """Return the stretches of all records in filter time constants. Raises UsageError if none is usable."""
    model = estimator.model
    if not isinstance(model, TransferFunction):
        raise UsageError(f"{estimator.method} on experiments needs a transfer function, not a {model.kind}")
    parts = [experiment.stretches(model.delay) for experiment in experiments]
    stretches = [replace(stretch, record=i) for i, some in enumerate(parts) for stretch in some]
    structure = make_structure(model, estimator.dt, estimator.cutoff)
    scaled = tuple(stretch.scale_time(estimator.cutoff) for stretch in stretches)
    # a stretch must have more outputs than the initial conditions absorb
    usable = keep_outputs_after(scaled, structure.dead_time, model.n + 2)
    for name, signals in (("output", [part.y for part in experiments]), ("input", [part.u for part in experiments])):
        if not any(np.any(np.isfinite(signal)) for signal in signals):
            raise UsageError(f"the {name} is empty: every sample is missing (NaN); check the column or the array")
    if not usable:
        raise UsageError("no record has a stretch with enough samples of input and output; record longer")
    return ProcessProblem(structure, usable, estimator.cutoff)


def choose_start_pole(model: Model, experiments: Sequence[Experiment]) -> float:
    """Return the pole [rad/s] of the filters from which the refinement comes nearest to the records in a few passes.

    The poles are octaves apart, from four time constants in the longest record to half the inverse of the sample
    period. Raises UsageError without a usable record.
    """
    dt, most = experiments[0].period, STRETCH
    poles = 0.5 / dt * 0.5 ** np.arange(max(1, round(np.log2(max(part.u.size for part in experiments))) - 2))
    parts = [part.cut(most) for part in experiments]
    problems = (make_problem(SRIVC(model, Encoder(1.0), dt, pole), parts) for pole in poles.tolist())
    return float(poles[np.argmin([cost_at(problem, problem.structure.dead_time) for problem in problems])])


def make_structure(model: TransferFunction, dt: float, rate: float) -> Structure:
    """Return the model's structure with the time in units of 1/rate, for the sample period dt [s]."""
    fixed = 0.0 if isinstance(model.dead_time, str) else model.dead_time * rate
    latest = MAX_DELAY * dt * rate if model.dead_time == ESTIMATE else None
    return Structure(model.n, model.m, model.offset, model.integrators, model.unstable, fixed, latest)


def check_signals(problem: ProcessProblem, names: tuple[str, ...]) -> None:
    """Raise NotIdentifiableError if the input or the output contains no information for any method."""
    samples = sum(stretch.rows.size for stretch in problem.stretches)
    if samples <= 2 * len(names):
        raise NotIdentifiableError(
            f"the records have only {samples} samples for {len(names)} parameters: record longer"
        )
    if not any(np.ptp(stretch.y[stretch.rows]) > 0 for stretch in problem.stretches):
        raise NotIdentifiableError(
            "the output does not move in this record, so nothing can be identified; excite the process more"
        )
    if not any(np.ptp(stretch.inputs[0]) > 0 or np.any(stretch.inputs[0]) for stretch in problem.stretches):
        raise NotIdentifiableError("the input is always zero: record the input that drives the process")


def result(estimator: Estimator, problem: ProcessProblem, solution: Solution) -> ProcessFit:
    """Return the `ProcessFit` in seconds. Raises NotIdentifiableError if a sensitivity depends on the others."""
    check_apart(solution.point, estimator.names)
    scale = problem.structure.scale(problem.rate)
    within = explain_counts(problem, solution.point, estimator.encoder.resolution)
    point, cov = within or (solution.point, covariance(solution.point, problem))
    cov = cov * np.outer(scale, scale)
    theta = point.theta * scale
    residual = point.error
    relative = float(np.sqrt(point.cost / max(spread(problem), 1e-300)))
    process = process_of(estimator, theta, cov)
    return ProcessFit(
        estimator.names,
        estimator.units,
        theta,
        cov,
        residual.size,
        residual,
        relative,
        0,
        process,
        solution.passes,
        within is not None,
    )


def process_of(estimator: Estimator, theta: NDArray[np.float64], cov: NDArray[np.float64]) -> Process:
    """Return the transfer function at theta (p,) with covariance (p, p), in seconds."""
    model = estimator.model
    if not isinstance(model, TransferFunction):
        raise UsageError(f"{estimator.method} on experiments needs a transfer function, not a {model.kind}")
    structure = make_structure(model, estimator.dt, 1.0)
    return Process.from_theta(structure, theta, cov, model.delay * estimator.dt + structure.lateness(theta))


def check_apart(point: ProcessPoint, names: tuple[str, ...]) -> None:
    """Raise NotIdentifiableError with the parameter's name if a sensitivity is zero or depends on the others."""
    with np.errstate(over="ignore"):  # an overflow is checked below
        countable = np.all(np.isfinite(np.linalg.norm(point.zeta, axis=0)))
    parts = parts_of_their_own(point.zeta, rcond=1e-13)[0] if countable else np.zeros(len(names))
    worst = int(np.argmin(parts))
    if not parts[worst] > TARGET_APART:
        raise NotIdentifiableError(
            f"{names[worst]} has too little effect of its own on the output, because the excitation is "
            "poor or the order of the model is too high; use fewer poles or zeros, or a more varied input"
        )


def spread(problem: ProcessProblem) -> float:
    """Return the sum of squares of the output about the mean of each stretch."""
    return sum(
        float(np.sum((y := stretch.y[stretch.rows]) ** 2) - y.size * np.mean(y) ** 2) for stretch in problem.stretches
    )

"""Compare predicted standard deviations to those of experiments, for the design and a trapezoid."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from pmfid.design.calibration import DesignedRun, calibrate
from pmfid.design.encoder_error import centred_sensitivities, encoder_covariance, start_free
from pmfid.design.fisher import affine
from pmfid.design.problem import Problem
from pmfid.design.simulated import simulate
from pmfid.design.solver import solve
from pmfid.design.standard import standard_inputs
from pmfid.encoder import Encoder, quantize
from pmfid.errors import NotIdentifiableError
from pmfid.estimators.motion_fit import MotionFit
from pmfid.simulation.scenarios import resolution_of
from pmfid.types import Floats
from studies.design_case import STARTS, case, known

#: u (n,), x (n,), problem, generator -> theta (p,)
Method = Callable[[Floats, Floats, Problem, np.random.Generator], Floats]

INCREMENTS = 1024
#: Number of start phases of the encoder, evenly spread.
PHASES = 128


@dataclass(frozen=True, eq=False)
class Trial:
    """Experiments with one input.

    `predicted` and `unknown_start` are standard deviations (p,) [%] for white noise, with a known and an unknown start
    position. `encoder` are those of `squares_covariance`, or for `commission` those of `encoder_covariance`. `errors`
    are (runs, p) [%], and `failures` counts the runs without an estimate.
    """

    predicted: Floats
    unknown_start: Floats
    encoder: Floats
    errors: Floats
    failures: int

    @property
    def std(self) -> Floats:
        return np.asarray(self.errors.std(axis=0))

    @property
    def size(self) -> float:
        """Size of the observed scatter for criterion D, (determinant of the covariance)^(1/p)."""
        return float(np.linalg.det(np.cov(self.errors.T)) ** (1 / self.errors.shape[1]))


def counted(u: Floats, x: Floats, problem: Problem, rng: np.random.Generator) -> DesignedRun:
    """Return a run through the encoder from a random start phase."""
    resolution = problem.resolution or 1.0
    counts = quantize(x + rng.uniform(0, resolution), resolution)
    return DesignedRun(u, np.asarray(counts * resolution, float), problem.dt / problem.samples_per_interval)


def commission(u: Floats, x: Floats, problem: Problem, rng: np.random.Generator) -> Floats:
    """Return the estimate of `pmfid design SPEC RECORD`, by the parameters that the counts allow."""
    return _theta(problem, counted(u, x, problem, rng))


def least_squares(u: Floats, x: Floats, problem: Problem, rng: np.random.Generator) -> Floats:
    """Return the least-squares estimate from the counts, as if their error were white noise."""
    return _theta(as_noise(problem), counted(u, x, problem, rng))


def as_noise(problem: Problem) -> Problem:
    """Return the problem with white noise of the encoder's variance."""
    return replace(problem, noise_variance=problem.variance)


def white(u: Floats, x: Floats, problem: Problem, rng: np.random.Generator) -> Floats:
    """Return the least-squares estimate from a position with white noise of the encoder's variance in place of the
    encoder.
    """
    y = x + rng.normal(0.0, np.sqrt(problem.variance), x.size)
    return _theta(as_noise(problem), DesignedRun(u, y, problem.dt / problem.samples_per_interval))


def interval(u: Floats, x: Floats, problem: Problem, rng: np.random.Generator) -> Floats:
    """Return the estimate of the interval likelihood, which takes no parameter and no start as known."""
    run = counted(u, x, problem, rng)
    resolution = problem.resolution or 1.0
    method = MotionFit(problem.drive, Encoder(resolution), run.dt, 1 / (3 * run.dt))
    return method.fit(u, np.round(run.y / resolution).astype(np.int64)).theta


def squares_covariance(problem: Problem, u: Floats) -> Floats:
    """Return the mean square error (p, p) of least squares on the counts, linearised at the nominal values.

    The error of the counts along the simulated motion (paper eq. 3) passes through the estimate. All start phases have
    the same weight.
    """
    maps = affine(problem)
    s = centred_sensitivities(maps.weigh_sensitivities(u))
    F = s @ s.T + maps.prior
    x = simulate(problem, u).x / float(problem.resolution or 1.0)
    phases = (np.arange(PHASES)[:, None] + 0.5) / PHASES
    error = np.sqrt(12.0) * (np.floor(x + phases) - x - phases)  # over its deviation
    score = error @ s.T
    middle = score.T @ score / PHASES + maps.prior
    return np.asarray(np.linalg.solve(F, np.linalg.solve(F, middle).T) * np.outer(problem.scale, problem.scale))


METHODS: dict[str, Method] = {
    "white noise": white,
    "least squares": least_squares,
    "commission": commission,
    "interval": interval,
}


def _theta(problem: Problem, run: DesignedRun) -> Floats:
    parameters = calibrate(problem, [run]).parameters
    return np.array([parameters[name] for name in problem.names])


def trial(problem: Problem, u: Floats, method: str, runs: int) -> Trial:
    """Run experiments on the nominal drive with stiction under the input u (intervals,); run k has seed k."""
    nominal = np.array([problem.nominal[name] for name in problem.names])
    s = affine(problem).weigh_sensitivities(u)
    predicted, unknown_start = (100 * np.sqrt(np.linalg.inv(F).diagonal()) for F in (s @ s.T, start_free(s)))
    covariance = encoder_covariance(known(problem), u) if method == "commission" else squares_covariance(problem, u)
    encoder = np.full(nominal.size, np.nan) if covariance is None else 100 * np.sqrt(covariance.diagonal()) / nominal
    motion = simulate(problem, u)
    errors, failures = [], 0
    for seed in range(runs):
        try:
            theta = METHODS[method](motion.u, motion.x, problem, np.random.default_rng(seed))
        except NotIdentifiableError:
            failures += 1
        else:
            errors.append(100 * (theta / nominal - 1))
    return Trial(predicted, unknown_start, encoder, np.array(errors), failures)


def experiments(runs: int) -> Iterator[list[str]]:
    """Yield rows for the D-optimal input and the trapezoid, by sampling and method, with observed and predicted
    gain.
    """
    for samples in (1, 5):
        problem = case("m, d, F_c", resolution=resolution_of(INCREMENTS), samples_per_interval=samples)
        inputs = {
            "design": solve(problem, "D", starts=STARTS).u,
            "trapezoid": standard_inputs(problem, names=("trapezoid",))["trapezoid"].u,
        }
        for method in METHODS:
            if samples == 1 and method == "interval":
                continue  # the estimator's start needs filters, and the filters need more samples
            found = {name: trial(problem, u, method, runs) for name, u in inputs.items()}
            gain = found["trapezoid"].size / found["design"].size
            for name, each in found.items():
                expected = (each.predicted, each.unknown_start, each.encoder)
                ratios = [_cell(each.std, 4), *(_cell(each.std / std, 2) for std in expected)]
                gains = [f"{gain:.2f}", f"{predicted_gain(problem, inputs):.2f}"] if name == "design" else ["", ""]
                yield [f"{1e3 * problem.dt / samples:g} ms", method, name, *ratios, str(each.failures), *gains]


def predicted_gain(problem: Problem, inputs: dict[str, Floats]) -> float:
    """Return D of the design over D of the trapezoid."""
    maps = affine(problem)
    sizes = [np.linalg.det(maps.information(u)) ** (1 / len(problem.names)) for u in inputs.values()]
    return float(sizes[0] / sizes[1])


def _cell(values: Floats, digits: int) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values)

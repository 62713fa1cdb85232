"""The body of a problem: its motion with stiction, and the derivatives of the motion (csrc/fit/body.h).

The sensitivities of `fisher` belong to a linear equation with a known sign of the friction. If the axis comes to rest,
the linear sensitivities continue, although the axis rests. The derivatives of the body end at a stop.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pmfid.design.problem import Problem
from pmfid.errors import UsageError
from pmfid.fit import machine
from pmfid.fit.machine import BodyModel, Excitation, machine_of
from pmfid.fit.problem import PARTS
from pmfid.fit.tuning import MOTION
from pmfid.types import Floats


def body_of(problem: Problem) -> BodyModel:
    """Return the body of the equation of a problem."""
    return machine_of(problem.drive.equation)


def excite(problem: Problem, u: Floats, step: float) -> Excitation:
    """Return the forces of an input u (n,), held for `step` [s] each, with n + 1 observations."""
    force = np.ascontiguousarray(u * problem.drive.equation.input_gain)
    row = np.arange(u.size + 1, dtype=np.int32)
    return Excitation(np.full(u.size, step), force, row, np.zeros((0, u.size)))


@dataclass(frozen=True, eq=False)
class BodyMotion:
    """Time t [s], input u, position x [m] and velocity v [m/s] at the n samples, the first one at time 0.

    The last input is 0. `slopes` (n, p) are the derivatives of the position by the unknown and nuisance parameters."""

    t: Floats
    u: Floats
    x: Floats
    v: Floats
    slopes: Floats


def simulate(problem: Problem, u: ArrayLike, parameters: Mapping[str, float] | None = None) -> BodyMotion:
    """Simulate the motion from `problem.start` under the input u (K,) with stiction, at the position samples.

    `parameters` has true values. Missing values are nominal. Raises UsageError for a wrong length of u.
    """
    u = np.asarray(u, float)
    if u.shape != (problem.intervals,):
        raise UsageError(f"u must have shape ({problem.intervals},), one value per interval, got {u.shape}")
    model, values = body_of(problem), {**problem.nominal, **(parameters or {})}
    body = model.body(np.array([values[name] for name in model.names]))
    body[list(model.starts[:2])] = problem.start
    held, dt = np.repeat(u, problem.samples_per_interval), problem.dt / problem.samples_per_interval
    lift = model.lift[:, [model.names.index(name) for name in problem.names]]
    drive, parts = excite(problem, held, dt), MOTION.parts if model.forces or problem.drive.lag else PARTS
    x, v, slopes = machine.simulate(drive, model.forces, body, parts, lift, model.elastic, model.load)
    t = np.asarray(dt * np.arange(x.size), np.float64)
    return BodyMotion(t, np.append(held, 0.0), x, v, slopes)


def simulated_information(problem: Problem, u: ArrayLike, parameters: Mapping[str, float] | None = None) -> Floats:
    """Return the Fisher information (p, p) of one run on unknown and nuisance parameters, without the prior.

    The parameters have their own units, and true values as in `simulate`. `u` is (K,). Raises the errors of `simulate`.
    """
    slopes = simulate(problem, u, parameters).slopes
    return np.asarray(slopes.T @ slopes / problem.variance)


def prior_of(problem: Problem, names: tuple[str, ...]) -> Floats:
    """Return the prior information on parameters `names`, zero where there is none."""
    prior = np.zeros((len(names), len(names)))
    if problem.prior is not None:
        places = [names.index(name) for name in problem.names]
        prior[np.ix_(places, places)] = problem.prior
    return prior


def separate(prior: Floats) -> tuple[Floats, Floats]:
    """Return the matrix (p, p) with unit diagonal from independent coordinates to those of a prior (p, p), and the
    precisions (p,) of the coordinates. The last coordinate of both is the same."""
    if not np.any(prior - np.diag(np.diag(prior))):
        return np.eye(len(prior)), np.diag(prior).copy()
    size = np.sqrt(np.maximum(np.diag(prior), 1e-300))
    root = np.linalg.cholesky(prior / np.outer(size, size) + 1e-12 * np.eye(len(prior))) * size[:, None]
    return np.asarray(np.linalg.inv((root / np.diag(root)).T), float), np.diag(root) ** 2

"""Exact sensitivities of the measured position, and the Fisher information of an input (paper eq. 4 and 5).

For given directions of motion the drive is linear in its state and input. So motion and sensitivities are affine in the
input, and the information is a quadratic of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pmfid.design.problem.dynamics import Regime, StateStep, discretise, drive_regime
from pmfid.design.problem.problem import Problem
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.types import Floats

__all__ = ["Affine", "affine", "check_identifiable", "information", "motion", "sensitivities"]


@dataclass(frozen=True, eq=False)
class Affine:
    """What is affine in the input u (K,) of a problem with p parameters, N samples and K intervals.

    state_matrix (K+1, n, K), state_offset (K+1, n): state at the nodes = state_matrix u + state_offset.
    matrix (p N, K), offset (p N,): sensitivities in units of the noise's deviation, per scaled parameter; parameter by
    parameter. prior (p, p): prior information on the scaled parameters. scale (p,): what they are scaled with.
    """

    state_matrix: Floats
    state_offset: Floats
    matrix: Floats
    offset: Floats
    prior: Floats
    scale: Floats

    def weigh_sensitivities(self, u: ArrayLike) -> Floats:
        """Sensitivities over deviation, (p, N)."""
        return np.asarray(self.matrix @ np.asarray(u) + self.offset).reshape(len(self.scale), -1)

    def information(self, u: ArrayLike) -> Floats:
        """Information on the scaled parameters, (p, p), prior included."""
        s = self.weigh_sensitivities(u)
        return np.asarray(s @ s.T + self.prior)


def affine(problem: Problem, parameters: Mapping[str, float] | None = None) -> Affine:
    """The affine maps of a problem; parameters: {name: value} of another case than the nominal one, scaled as that."""
    steps = _steps(problem, {**problem.nominal, **(parameters or {})}, problem.names, problem.samples_per_interval)
    n, p, K = 2, len(problem.names), problem.intervals
    X = np.zeros((n * (p + 1), K + 1))  # columns: input of each interval, then 1
    X[:n, K] = problem.start
    nodes, samples = [X[:n].copy()], []
    for k, (regime, step) in enumerate(steps):
        for i in range(1, p + 1):
            X[n * i : n * (i + 1)] = regime.entry @ X[n * i : n * (i + 1)]
        for _ in range(problem.samples_per_interval):
            X = step.A @ X
            X[:, k] += step.b
            X[:, K] += step.g
            samples.append(regime.c @ X[n:].reshape(p, n, K + 1))
        nodes.append(X[:n].copy())
    weight = problem.scale / np.sqrt(problem.variance)
    S = (np.array(samples).swapaxes(0, 1) * weight[:, None, None]).reshape(-1, K + 1)
    state = np.array(nodes)
    prior = (
        np.zeros((p, p))
        if problem.prior is None
        else np.asarray(problem.prior) * np.outer(problem.scale, problem.scale)
    )
    return Affine(state[:, :, :K], state[:, :, K], np.ascontiguousarray(S[:, :K]), S[:, K].copy(), prior, problem.scale)


def _steps(
    problem: Problem, parameters: Mapping[str, float], names: tuple[str, ...], parts: int
) -> list[tuple[Regime, StateStep]]:
    """Regime of each interval, and its step over a part of the interval."""
    regimes = {d: drive_regime(problem.drive, parameters, names, d) for d in set(problem.sense)}
    known = {d: (regime, discretise(regime, problem.dt / parts)) for d, regime in regimes.items()}
    return [known[d] for d in problem.sense]


def motion(problem: Problem, u: ArrayLike, parameters: Mapping[str, float] | None = None) -> tuple[Floats, Floats]:
    """Position [m] and velocity [m/s] at the nodes, each (intervals + 1,), if the directions are as the problem says.

    parameters: other values than the nominal ones, {name: value}. Raises UsageError if u has another length.
    """
    values = _check_input(problem, u)
    state = [np.array(problem.start, float)]
    for (_, step), value in zip(_steps(problem, {**problem.nominal, **(parameters or {})}, (), 1), values, strict=True):
        state.append(step.A @ state[-1] + step.b * value + step.g)
    x, v = np.array(state).T
    return x, v


def sensitivities(problem: Problem, u: ArrayLike) -> Floats:
    """d position / d parameter at the samples, (intervals * samples_per_interval, p), parameters in their own units."""
    maps = affine(problem)
    return np.asarray(
        (maps.weigh_sensitivities(_check_input(problem, u)) / problem.scale[:, None]).T * np.sqrt(problem.variance)
    )


def information(problem: Problem, u: ArrayLike) -> Floats:
    """Fisher information on unknown and nuisance parameters in their own units, prior included: (p, p), paper eq. 4."""
    maps = affine(problem)
    return maps.information(_check_input(problem, u)) / np.outer(maps.scale, maps.scale)


def _check_input(problem: Problem, u: ArrayLike) -> Floats:
    values = np.asarray(u, float)
    if values.shape != (problem.intervals,) or not np.isfinite(values).all():
        raise UsageError(f"u must hold {problem.intervals} finite values, one per interval, got shape {values.shape}")
    return values


def check_identifiable(problem: Problem, maps: Affine) -> None:
    """Raises NotIdentifiableError that names the parameters which no input tells, or tells apart, or no single run."""
    p = len(problem.names)
    every = np.hstack([maps.matrix, maps.offset[:, None]]).reshape(p, -1)
    gram = every @ every.T + maps.prior
    size = np.sqrt(gram.diagonal())
    dead = [name for name, s in zip(problem.names, size, strict=True) if s <= 1e-12 * max(size.max(), 1e-300)]
    if dead:
        raise NotIdentifiableError(f"the position does not depend on {', '.join(dead)} in this motion; {_REMEDY}")
    values, vectors = np.linalg.eigh(gram / np.outer(size, size))
    if values[0] < 1e-10:
        alike = [name for name, part in zip(problem.names, vectors[:, 0], strict=True) if abs(part) > 1e-3]
        raise NotIdentifiableError(f"no input tells {' from '.join(alike)} in this motion; {_REMEDY}")
    rank = _rank_of_a_run(maps)
    if rank < p:
        raise NotIdentifiableError(
            f"one run of this motion has {maps.matrix.shape[0] // p} samples and tells {rank} numbers, too few for "
            f"{', '.join(problem.names)}; take more intervals or samples_per_interval, take {p - rank} of them out of "
            "unknown, or give prior information"
        )


def _rank_of_a_run(maps: Affine) -> int:
    """Number of parameter combinations that one run determines with the prior; several inputs may determine more."""
    run = maps.weigh_sensitivities(np.random.default_rng(0).standard_normal(maps.matrix.shape[1]))
    both = np.hstack([run / max(float(np.abs(run).max()), 1e-300), maps.prior / max(np.abs(maps.prior).max(), 1e-300)])
    size = np.linalg.norm(both, axis=1)
    return int(np.linalg.matrix_rank(both / np.where(size > 0, size, 1.0)[:, None], tol=1e-10))


_REMEDY = "take it out of unknown, give prior information, or allow motion in both directions"

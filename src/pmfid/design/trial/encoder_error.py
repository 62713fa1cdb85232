"""Standard deviations with the error that an encoder really makes: it repeats with the motion, and is not white."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from pmfid.design.problem.fisher import affine
from pmfid.design.problem.problem import Problem
from pmfid.design.trial.simulated import both_ways, simulate
from pmfid.design.trial.walkers import inside, walk
from pmfid.types import Floats

__all__ = ["encoder_covariance", "expected_covariance", "is_counted", "log_of_room", "squares_covariance", "start_free"]

#: Start phases on the lattice of the encoder, evenly spread, for least squares.
PHASES = 128
#: Number of machines drawn around the nominal one, the standard deviation of their parameters as a part of the nominal
#: values, and the deviation that bounds the parameters of a machine at rest.
MACHINES, WRONG, FAR = 32, 0.06, 1.0
#: Deviations by which a parameter is wrong at most; machines with all of them that wrong are looked at as well.
FURTHEST = 2.0
#: Condition of an information from which on it leaves a parameter open.
WORST = 1e12
#: Walkers for each of these, steps until they have spread, and steps that count.
WALKERS, SPREAD, STEPS = 12, 80, 120


def encoder_covariance(problem: Problem, u: ArrayLike) -> Floats | None:
    """Mean square error (p, p) of unknown + nuisance, in their own units, of `calibrate` after one run of u (n,).

    The mean over machines that differ from the nominal values by as much as is not known, at most WRONG, each from
    another start phase: what their counts leave open is as in `counted`, with sensitivities of the simulated motion. A
    motion that is the best for the nominal values may come to rest on another machine, and tell a hundredth: so the
    corners of what is not known are among the machines.
    None if the noise is not that of an encoder, or if the run and the prior leave a parameter open.
    """
    ready = _ready(problem, u)
    if ready is None:
        return None
    prior, size = ready[1], len(problem.names)
    known, machines = _bound_prior(prior), _machines(problem, prior)
    errors, moves, roots = [], [], []
    for number, parameters in enumerate(machines):
        x, s = _motion_in_counts(problem, u, parameters)
        phase = (number + 0.5) / len(machines)
        errors.append(np.floor(x + phase) - x - phase)
        roots.append(np.linalg.inv(np.linalg.cholesky(12.0 * s @ s.T + known)).T)  # z: the scatter of white noise
        moves.append(roots[-1].T @ s)
    error, move, root = np.array(errors)[:, None], np.array(moves), np.array(roots)
    held = root.swapaxes(1, 2) @ known @ root

    def density(z: Floats) -> Floats:
        return np.asarray(log_of_room(z @ move - error, 0.5) - 0.5 * np.sum((z @ held) * z, axis=-1))

    rng = np.random.default_rng(0)
    start = inside(density, np.zeros(size), 0.1 * rng.standard_normal((len(machines), WALKERS, size)))
    path = walk(density, start, SPREAD + STEPS, rng)[SPREAD:] @ root.swapaxes(1, 2)
    apart = (path - path.mean(axis=(0, 2), keepdims=True)).reshape(-1, size)
    return np.asarray(apart.T @ apart / len(apart) * np.outer(problem.scale, problem.scale))


def _bound_prior(prior: Floats) -> Floats:
    """The prior (p, p) of the scaled parameters, plus a weak bound for a machine that rests."""
    return np.asarray(prior + np.eye(len(prior)) / FAR**2)


def _machines(problem: Problem, prior: Floats) -> list[dict[str, float]]:
    """Parameters around the nominal ones, with what the prior (p, p) knows of the scaled ones: normal, and corners."""
    nominal = np.array([problem.nominal[name] for name in problem.names])
    least = (WRONG * np.abs(nominal) / problem.scale) ** -2.0 if np.all(nominal) else np.full(len(nominal), WRONG**-2.0)
    spread = np.linalg.cholesky(np.linalg.inv(prior + np.diag(least)))
    draws = np.random.default_rng(0).standard_normal((MACHINES // 2, len(nominal))).clip(-FURTHEST, FURTHEST)
    corners = np.array(list(product((-FURTHEST, FURTHEST), repeat=len(nominal))))
    values = nominal + np.vstack([draws, -draws, corners]) @ spread.T * problem.scale
    lower = np.where([name == "offset" for name in problem.names], -np.inf, 0.1 * np.abs(nominal))
    return [dict(zip(problem.names, np.maximum(each, lower).tolist(), strict=True)) for each in values]


def _motion_in_counts(problem: Problem, u: ArrayLike, parameters: dict[str, float]) -> tuple[Floats, Floats]:
    """Positions (N + 1,) and centred sensitivities to the scaled parameters (p, N + 1), in counts, with stiction."""
    resolution = float(problem.resolution or 1.0)
    columns = []
    for name, scale in zip(problem.names, problem.scale, strict=True):
        low, high = both_ways(name, parameters[name])
        ends = [simulate(problem, u, {**parameters, name: value}).x for value in (high, low)]
        columns.append((ends[0] - ends[1]) * scale / (high - low) / resolution)
    s = np.array(columns)
    return simulate(problem, u, parameters).x / resolution, s - s.mean(axis=1, keepdims=True)


def expected_covariance(problem: Problem, u: ArrayLike) -> Floats | None:
    """The covariance (p, p) that `calibrate` will have: `encoder_covariance`, or of white noise, the start unknown.

    The latter is the mean over the same machines; of the nominal one alone, without stiction, if friction is
    directional. None if the run and the prior leave a parameter open.
    """
    if is_counted(problem):
        return encoder_covariance(problem, u)
    maps = affine(problem)
    F, scale = start_free(maps.weigh_sensitivities(u)) + maps.prior, np.outer(problem.scale, problem.scale)
    if np.linalg.cond(F) > WORST:
        return None
    if problem.drive.friction == "symmetric":
        return np.asarray(_white_covariance(problem, u, maps.prior) * scale)
    return np.asarray(np.linalg.inv(F) * scale)


def _white_covariance(problem: Problem, u: ArrayLike, prior: Floats) -> Floats:
    """(p, p) of the scaled parameters, for white noise on simulated machines; prior (p, p)."""
    weight = float(problem.resolution or 1.0) ** 2 / problem.variance
    slopes = (_motion_in_counts(problem, u, each)[1] for each in _machines(problem, prior))
    return np.asarray(np.mean([np.linalg.inv(weight * s @ s.T + _bound_prior(prior)) for s in slopes], axis=0))


def log_of_room(distance: Floats, half: float) -> Floats:
    """Logarithm of how far a motion may be moved with each sample within its count, -inf if it may not be there.

    distance (..., N): of the motion from the middles of the counts, in counts; half: width of a count over 2. The
    likelihood of a motion whose start on the lattice is not known.
    """
    room = 2.0 * half - (distance.max(axis=-1) - distance.min(axis=-1))
    return np.asarray(np.log(room, out=np.full(room.shape, -np.inf), where=room > 0))


def squares_covariance(problem: Problem, u: ArrayLike) -> Floats | None:
    """The same (p, p) for least squares on the counts, linearised at the nominal values.

    The error of the counts along the simulated motion (paper eq. 3), from all start phases alike, sent through the
    estimate.
    """
    ready = _ready(problem, u)
    if ready is None:
        return None
    s, prior, F = ready
    x = simulate(problem, u).x / float(problem.resolution or 1.0)
    phases = (np.arange(PHASES)[:, None] + 0.5) / PHASES
    error = np.sqrt(12.0) * (np.floor(x + phases) - x - phases)  # over its deviation
    score = error @ s.T
    middle = score.T @ score / PHASES + prior
    scale = np.outer(problem.scale, problem.scale)
    return np.asarray(np.linalg.solve(F, np.linalg.solve(F, middle).T) * scale)


def _ready(problem: Problem, u: ArrayLike) -> tuple[Floats, Floats, Floats] | None:
    """Centred sensitivities (p, N + 1), prior and information (p, p), scaled; None if there is no answer."""
    if not is_counted(problem):
        return None
    maps = affine(problem)
    s = centred_sensitivities(maps.weigh_sensitivities(u))
    F = s @ s.T + maps.prior
    return None if np.linalg.cond(F) > WORST else (s, maps.prior, F)


def is_counted(problem: Problem) -> bool:
    """Whether the noise is that of an encoder, on an axis that can be simulated."""
    return problem.resolution is not None and problem.noise_variance is None and problem.drive.friction == "symmetric"


def start_free(sensitivity: Floats) -> Floats:
    """Information (p, p) of sensitivities (p, N) where the start position is unknown, but measured as well."""
    s = centred_sensitivities(sensitivity)
    return np.asarray(s @ s.T)


def centred_sensitivities(sensitivity: Floats) -> Floats:
    """(p, N + 1) from (p, N): with the sample at the start, and without what a shift of the position can do as well."""
    s = np.column_stack([np.zeros(len(sensitivity)), sensitivity])
    return np.asarray(s - s.mean(axis=1, keepdims=True))

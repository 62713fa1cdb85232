"""Standard deviations with the error that an encoder really makes: it repeats with the motion, and is not white."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pmfid.design.fisher import affine
from pmfid.design.problem import Float, Problem
from pmfid.design.simulated import simulate
from pmfid.design.walkers import inside, walk

__all__ = ["encoder_covariance", "expected_covariance", "is_counted", "log_of_room", "squares_covariance", "start_free"]

#: Start phases on the lattice of the encoder, evenly spread: for squares, and for the counts themselves.
PHASES, FEW_PHASES = 128, 12
#: Condition of an information from which on it leaves a parameter open.
WORST = 1e12
#: Walkers for each of those, steps until they have spread, and steps that count.
WALKERS, SPREAD, STEPS = 20, 80, 120


def encoder_covariance(problem: Problem, u: ArrayLike) -> Float | None:
    """Mean square error (p, p) of unknown + nuisance, in their own units, of `calibrate` after one run of u (n,).

    The counts of the simulated motion at the nominal values, from all start phases alike; what they leave open is as in
    `counted`, with linear sensitivities. What was known before is taken as right.
    None where the noise is not that of an encoder, or where the run and the prior leave a parameter open.
    """
    ready = _ready(problem, u)
    if ready is None:
        return None
    s, prior, F = ready
    x = simulate(problem, u).x / float(problem.resolution or 1.0)
    phases = (np.arange(FEW_PHASES)[:, None, None] + 0.5) / FEW_PHASES
    error = np.floor(x + phases) - x - phases  # of the counts, (phases, 1, N + 1)
    root = np.linalg.inv(np.linalg.cholesky(F)).T  # z: parameters in the scatter of white noise
    moves, known = (s.T @ root).T / np.sqrt(12.0), root.T @ prior @ root

    def density(z: Float) -> Float:
        return np.asarray(log_of_room(z @ moves - error, 0.5) - 0.5 * np.einsum("...i,ij,...j->...", z, known, z))

    rng = np.random.default_rng(0)
    start = inside(density, np.zeros(len(s)), 0.1 * rng.standard_normal((FEW_PHASES, WALKERS, len(s))))
    path = walk(density, start, SPREAD + STEPS, rng)[SPREAD:]
    apart = (path - path.mean(axis=(0, 2), keepdims=True)).reshape(-1, len(s))
    covariance = apart.T @ apart / len(apart)
    return np.asarray(root @ covariance @ root.T * np.outer(problem.scale, problem.scale))


def expected_covariance(problem: Problem, u: ArrayLike) -> Float | None:
    """The covariance (p, p) that `calibrate` will have: `encoder_covariance`, or of white noise, the start unknown.

    None where the run and the prior leave a parameter open.
    """
    if is_counted(problem):
        return encoder_covariance(problem, u)
    maps = affine(problem)
    F = start_free(maps.weighted(u)) + maps.prior
    scale = np.outer(problem.scale, problem.scale)
    return None if np.linalg.cond(F) > WORST else np.asarray(np.linalg.inv(F) * scale)


def log_of_room(distance: Float, half: float) -> Float:
    """Logarithm of how far a motion may be moved with each sample within its count, -inf where it may not be there.

    distance (..., N): of the motion from the middles of the counts, in counts; half: width of a count over 2. The
    likelihood of a motion whose start on the lattice is not known.
    """
    room = 2.0 * half - (distance.max(axis=-1) - distance.min(axis=-1))
    return np.asarray(np.log(room, out=np.full(room.shape, -np.inf), where=room > 0))


def squares_covariance(problem: Problem, u: ArrayLike) -> Float | None:
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


def _ready(problem: Problem, u: ArrayLike) -> tuple[Float, Float, Float] | None:
    """Centred sensitivities (p, N + 1), prior and information (p, p), scaled; None where there is no answer."""
    if not is_counted(problem):
        return None
    maps = affine(problem)
    s = centred_sensitivities(maps.weighted(u))
    F = s @ s.T + maps.prior
    return None if np.linalg.cond(F) > WORST else (s, maps.prior, F)


def is_counted(problem: Problem) -> bool:
    """Whether the noise is that of an encoder, on an axis that can be simulated."""
    return problem.resolution is not None and problem.noise_variance is None and problem.drive.friction == "symmetric"


def start_free(sensitivity: Float) -> Float:
    """Information (p, p) of sensitivities (p, N) where the start position is unknown, but measured as well."""
    s = centred_sensitivities(sensitivity)
    return np.asarray(s @ s.T)


def centred_sensitivities(sensitivity: Float) -> Float:
    """(p, N + 1) from (p, N): with the sample at the start, and without what a shift of the position can do as well."""
    s = np.column_stack([np.zeros(len(sensitivity)), sensitivity])
    return np.asarray(s - s.mean(axis=1, keepdims=True))

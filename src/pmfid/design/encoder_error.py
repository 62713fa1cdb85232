"""Standard deviations with the error that an encoder really makes: it repeats with the motion, and is not white."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pmfid.design.fisher import affine
from pmfid.design.problem import Float, Problem
from pmfid.design.simulated import simulate

__all__ = ["encoder_covariance", "start_free"]

#: Start phases on the lattice of the encoder, evenly spread.
PHASES = 128


def encoder_covariance(problem: Problem, u: ArrayLike) -> Float | None:
    """Mean square error (p, p) of unknown + nuisance, in their own units, of least squares on counts, start unknown.

    u: (n,). The error of the counts along the simulated motion (paper eq. 3), from all start phases alike, sent through
    the least squares estimate linearised at the nominal values; what was known before is taken as right.
    None where the noise is not that of an encoder, or where the run and the prior leave a parameter open.
    """
    if problem.resolution is None or problem.noise_variance is not None or problem.drive.friction != "symmetric":
        return None
    s, prior = centred_sensitivities(affine(problem).weighted(u)), affine(problem).prior
    F = s @ s.T + prior
    if np.linalg.cond(F) > 1e12:
        return None
    x = simulate(problem, u).x / problem.resolution
    phases = (np.arange(PHASES)[:, None] + 0.5) / PHASES
    error = np.sqrt(12.0) * (np.floor(x + phases) - x - phases)  # over its deviation
    score = error @ s.T
    middle = score.T @ score / PHASES + prior
    scale = np.outer(problem.scale, problem.scale)
    return np.asarray(np.linalg.solve(F, np.linalg.solve(F, middle).T) * scale)


def start_free(sensitivity: Float) -> Float:
    """Information (p, p) of sensitivities (p, N) where the start position is unknown, but measured as well."""
    s = centred_sensitivities(sensitivity)
    return np.asarray(s @ s.T)


def centred_sensitivities(sensitivity: Float) -> Float:
    """(p, N + 1) from (p, N): with the sample at the start, and without what a shift of the position can do as well."""
    s = np.column_stack([np.zeros(len(sensitivity)), sensitivity])
    return np.asarray(s - s.mean(axis=1, keepdims=True))

"""Uncertainty of a motion that is measured in counts."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from pmfid.design.fisher import affine
from pmfid.design.problem import Problem
from pmfid.design.simulated import both_ways, simulate
from pmfid.design.tuning import TUNING
from pmfid.types import Floats

__all__ = ["Density", "inside", "walk"]

#: A density maps z (..., p) to the log density (...), which is -inf outside.
Density = Callable[[Floats], Floats]


def inside(density: Density, middle: Floats, scatter: Floats) -> Floats:
    """Return starts (..., walkers, p) at middle + scatter, where the density is not 0.

    A start outside moves towards the middle (p,) until the density there is not 0. `scatter` has the shape (...,
    walkers, p).
    """
    z = middle + scatter
    for _ in range(TUNING.encoder_error_halvings):
        outside = ~np.isfinite(density(z))
        if not outside.any():
            break
        z = np.where(outside[..., None], middle + (z - middle) / 2.0, z)
    return z


def walk(density: Density, z: Floats, steps: int, rng: np.random.Generator) -> Floats:
    """Return the places (steps, ..., walkers, p) of the walkers after each step, from z (..., walkers, p).

    The number of walkers is even. The two halves move in turn, each walker along the line to a walker of the other
    half.
    """
    half, size = z.shape[-2] // 2, z.shape[-1]
    halves = [z[..., :half, :].copy(), z[..., half:, :].copy()]
    logs = [density(part) for part in halves]
    path = np.empty((steps, *z.shape))
    for step in range(steps):
        for this in range(2):
            here, other = halves[this], halves[1 - this]
            partner = np.take_along_axis(other, rng.integers(half, size=here.shape[:-1])[..., None], axis=-2)
            stretch = (
                1.0 + (TUNING.encoder_error_longest - 1.0) * rng.random(here.shape[:-1])
            ) ** 2 / TUNING.encoder_error_longest
            trial = partner + stretch[..., None] * (here - partner)
            log = density(trial)
            with np.errstate(invalid="ignore"):  # a walker stays if both places are outside
                better = np.log(rng.random(stretch.shape)) < (size - 1) * np.log(stretch) + log - logs[this]
            halves[this] = np.where(better[..., None], trial, here)
            logs[this] = np.where(better, log, logs[this])
        path[step] = np.concatenate(halves, axis=-2)
    return path


def encoder_covariance(problem: Problem, u: ArrayLike) -> Floats | None:
    """Return the mean square error (p, p) of `calibrate` after one run of u (n,), for unknown and nuisance parameters.

    The parameters have their own units. The error is the mean over machines that differ from the nominal one by the
    uncertainty of the prior, at most `encoder_error_wrong`. Each simulated machine starts at another phase. The counts
    leave a set of parameters open, as in `counted`, here with the sensitivities of the simulated motion. A motion that
    is the best for the nominal values may come to rest on another machine, and bring a hundredth of the information.
    The machines therefore include the corners of the uncertainty. The result is None if the noise does not come from an
    encoder, or if run and prior do not determine a parameter.
    """
    ready = _informations(problem, u) if is_counted(problem) else None
    if ready is None:
        return None
    prior, size = ready[0], len(problem.names)
    known, machines = _bound_prior(prior), _machines(problem, prior)
    errors, moves, roots = [], [], []
    for number, parameters in enumerate(machines):
        x, s = _motion_in_counts(problem, u, parameters)
        phase = (number + 0.5) / len(machines)
        errors.append(np.floor(x + phase) - x - phase)
        roots.append(np.linalg.inv(np.linalg.cholesky(12.0 * s @ s.T + known)).T)  # z scatters as with white noise
        moves.append(roots[-1].T @ s)
    error, move, root = np.array(errors)[:, None], np.array(moves), np.array(roots)
    held = root.swapaxes(1, 2) @ known @ root

    def density(z: Floats) -> Floats:
        return np.asarray(log_of_room(z @ move - error, 0.5) - 0.5 * np.sum((z @ held) * z, axis=-1))

    rng = np.random.default_rng(0)
    start = inside(
        density, np.zeros(size), 0.1 * rng.standard_normal((len(machines), TUNING.encoder_error_walkers, size))
    )
    path = walk(density, start, TUNING.encoder_error_spread + TUNING.walker_steps, rng)[
        TUNING.encoder_error_spread :
    ] @ root.swapaxes(1, 2)
    apart = (path - path.mean(axis=(0, 2), keepdims=True)).reshape(-1, size)
    return np.asarray(apart.T @ apart / len(apart) * np.outer(problem.scale, problem.scale))


def _bound_prior(prior: Floats) -> Floats:
    """Return the prior (p, p) of the scaled parameters, plus a weak bound for a machine that rests."""
    return np.asarray(prior + np.eye(len(prior)) / TUNING.encoder_error_far**2)


def _machines(problem: Problem, prior: Floats) -> list[dict[str, float]]:
    """Return parameters around the nominal ones, drawn and at corners, within the prior (p, p) of the scaled
    parameters.
    """
    nominal = np.array([problem.nominal[name] for name in problem.names])
    least = (
        (TUNING.encoder_error_wrong * np.abs(nominal) / problem.scale) ** -2.0
        if np.all(nominal)
        else np.full(len(nominal), TUNING.encoder_error_wrong**-2.0)
    )
    spread = np.linalg.cholesky(np.linalg.inv(prior + np.diag(least)))
    draws = (
        np.random.default_rng(0)
        .standard_normal((TUNING.encoder_error_machines // 2, len(nominal)))
        .clip(-TUNING.encoder_error_furthest, TUNING.encoder_error_furthest)
    )
    corners = np.array(
        list(product((-TUNING.encoder_error_furthest, TUNING.encoder_error_furthest), repeat=len(nominal)))
    )
    values = nominal + np.vstack([draws, -draws, corners]) @ spread.T * problem.scale
    lower = np.where([name == "offset" for name in problem.names], -np.inf, 0.1 * np.abs(nominal))
    return [dict(zip(problem.names, np.maximum(each, lower).tolist(), strict=True)) for each in values]


def _motion_in_counts(problem: Problem, u: ArrayLike, parameters: dict[str, float]) -> tuple[Floats, Floats]:
    """Return the positions (N + 1,) and their centred sensitivities (p, N + 1) to the scaled parameters, in counts.

    The simulated motion includes stiction.
    """
    resolution = float(problem.resolution or 1.0)
    columns = []
    for name, scale in zip(problem.names, problem.scale, strict=True):
        low, high = both_ways(name, parameters[name])
        ends = [simulate(problem, u, {**parameters, name: value}).x for value in (high, low)]
        columns.append((ends[0] - ends[1]) * scale / (high - low) / resolution)
    s = np.array(columns)
    return simulate(problem, u, parameters).x / resolution, s - s.mean(axis=1, keepdims=True)


def expected_covariance(problem: Problem, u: ArrayLike) -> Floats | None:
    """Return the covariance (p, p) that `calibrate` will have after one run of u, or None if a parameter stays open.

    For an encoder the covariance is `encoder_covariance`. In other cases the noise is white, the start is unknown, and
    the covariance is a mean over simulated machines. With directional friction the covariance comes from the nominal
    machine without stiction.
    """
    if is_counted(problem):
        return encoder_covariance(problem, u)
    ready = _informations(problem, u)
    if ready is None:
        return None
    prior, F = ready
    covariance = _white_covariance(problem, u, prior) if problem.drive.friction == "symmetric" else np.linalg.inv(F)
    return np.asarray(covariance * np.outer(problem.scale, problem.scale))


def _white_covariance(problem: Problem, u: ArrayLike, prior: Floats) -> Floats:
    """Return the covariance (p, p) of the scaled parameters for white noise on simulated machines, with the prior
    (p, p).
    """
    weight = float(problem.resolution or 1.0) ** 2 / problem.variance
    slopes = (_motion_in_counts(problem, u, each)[1] for each in _machines(problem, prior))
    return np.asarray(np.mean([np.linalg.inv(weight * s @ s.T + _bound_prior(prior)) for s in slopes], axis=0))


def log_of_room(distance: Floats, half: float) -> Floats:
    """Return the logarithm of the distance by which a motion may move with each sample within its count.

    `distance` (..., N) is the distance of the motion from the middles of the counts, in counts. `half` is half the
    width of a count. The result is -inf for an impossible motion. The exponential of the result is the likelihood of a
    motion whose start on the encoder's lattice is unknown.
    """
    room = 2.0 * half - (distance.max(axis=-1) - distance.min(axis=-1))
    return np.asarray(np.log(room, out=np.full(room.shape, -np.inf), where=room > 0))


def _informations(problem: Problem, u: ArrayLike) -> tuple[Floats, Floats] | None:
    """Return the scaled prior (p, p) and the information (p, p) with this prior, for an unknown start.

    The result is None if a parameter stays open.
    """
    maps = affine(problem)
    F = start_free(maps.weigh_sensitivities(u)) + maps.prior
    return None if np.linalg.cond(F) > TUNING.encoder_error_worst else (maps.prior, F)


def is_counted(problem: Problem) -> bool:
    """Return whether the noise comes from an encoder, on an axis that can be simulated."""
    return problem.resolution is not None and problem.noise_variance is None and problem.drive.friction == "symmetric"


def start_free(sensitivity: Floats) -> Floats:
    """Return the information (p, p) of sensitivities (p, N) for an unknown start position that is measured as well."""
    s = centred_sensitivities(sensitivity)
    return np.asarray(s @ s.T)


def centred_sensitivities(sensitivity: Floats) -> Floats:
    """Return centred sensitivities (p, N + 1) from sensitivities (p, N), with a sample at the start.

    A shift of the position can replace the mean of a sensitivity, so the mean brings no information.
    """
    s = np.column_stack([np.zeros(len(sensitivity)), sensitivity])
    return np.asarray(s - s.mean(axis=1, keepdims=True))

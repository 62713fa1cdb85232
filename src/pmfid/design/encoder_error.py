"""Uncertainty of a motion that is measured in counts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linprog

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


#: Distances map q (p,) to the simulated minus the measured position of each run, in counts (N,).
Distances = Callable[[Floats], list[Floats]]


def middle_of(distances: Distances, q: Floats, steps: Floats, lower: Floats) -> Floats:
    """Return the parameters (p,) with the least widest range of distances, by linear programs.

    The neighbourhood shrinks if the last program promised too much.
    """
    now, reach = widest(distances(q)), 8.0
    for _ in range(TUNING.encoder_error_steps):
        trial = least_range(distances, q, steps, lower, reach)
        new = widest(distances(trial))
        if new < now:
            gain, q, now = now - new, trial, new
            if gain < TUNING.encoder_error_settled * now:
                break
        else:
            reach /= 4.0
            if reach < 1e-4:
                break
    return q


def widest(errors: Sequence[Floats]) -> float:
    return max(float(e.max() - e.min()) for e in errors)


def least_range(distances: Distances, q: Floats, steps: Floats, lower: Floats, reach: float) -> Floats:
    """Return the parameters (p,) with the least widest range of linearised distances, within `reach` of the steps (p,
    k).

    The variables of the linear program are z (k,), the lowest and highest distance of each run, and the widest range.
    """
    p, here = steps.shape[1], distances(q)
    if p == 0:
        return q
    moves = []
    for i in range(p):
        up, down = np.maximum(q + steps[:, i], lower), np.maximum(q - steps[:, i], lower)
        part = np.linalg.norm(up - down) / np.linalg.norm(steps[:, i])
        moves.append([(a - b) / part for a, b in zip(distances(up), distances(down), strict=True)])
    R = len(here)
    rows, right = [], []
    for r, e in enumerate(here):
        A = np.column_stack([move[r] for move in moves])
        for sign, place in ((1.0, p + 2 * r + 1), (-1.0, p + 2 * r)):
            block = np.zeros((e.size, p + 2 * R + 1))
            block[:, :p], block[:, place] = sign * A, -sign
            rows.append(block)
            right.append(-sign * e)
        width = np.zeros((1, p + 2 * R + 1))
        width[0, [p + 2 * r + 1, p + 2 * r, -1]] = 1.0, -1.0, -1.0
        rows.append(width)
        right.append(np.zeros(1))
    cost = np.r_[np.zeros(p + 2 * R), 1.0]
    bounds = [(-reach, reach)] * p + [(None, None)] * (2 * R + 1)
    found = linprog(cost, np.vstack(rows), np.concatenate(right), bounds=bounds, method="highs")
    return q if found.x is None else np.asarray(np.maximum(q + steps @ found.x[:p], lower))


@dataclass(frozen=True, eq=False)
class Allowed:
    """The density of the possible parameters q (p,), which is the room within the counts, times the prior.

    A count has the width 2 `half` [counts], and q is at least `lower` (p,). The prior is centred on 1, and `root` (p,
    p) is the root of its information.
    """

    distances: Distances
    half: float
    lower: Floats
    root: Floats

    def room(self, q: Floats) -> float:
        """Return the distance by which the motion at q may move within its counts [counts], or 0 if q is impossible."""
        return max(2.0 * self.half - widest(self.distances(q)), 0.0) if np.all(q >= self.lower) else 0.0

    def doubt(self, q: Floats) -> float:
        """Return the negative logarithm of the prior."""
        return 0.5 * float(np.sum((self.root @ (q - 1.0)) ** 2))


def spread_along_ridges(allowed: Allowed, samples: Floats, middle: Floats, rng: np.random.Generator) -> Floats:
    """Spread the samples (n, p) along the ridges that extend beyond the samples. Without ridges, return the samples.

    `middle` (p,) is a possible place in the middle of the samples.
    """
    size, axes = np.linalg.eigh(np.atleast_2d(np.cov(samples.T)))
    steps, spread = axes * np.sqrt(np.maximum(size, 0.0)), samples
    for k, axis in enumerate(axes.T):
        ends = [_follow_ridge(allowed, middle, steps, k, sign) for sign in (-1.0, 1.0)]
        if any(len(end) for end in ends):
            chain = np.array([*ends[0][::-1], middle, *ends[1]])
            along, drawn = (spread - middle) @ axis, _draw_places(allowed, chain, len(samples), rng) - middle
            if np.std(drawn @ axis) > np.std(along):
                spread = spread - np.outer(along, axis) + drawn
    return spread


def _follow_ridge(allowed: Allowed, middle: Floats, steps: Floats, k: int, sign: float) -> list[Floats]:
    """Return places (p,) on the ridge along column k of the steps (p, p), from the middle outwards.

    The list is empty if the ridge ends within the samples.
    """
    others, doubt = np.delete(steps, k, axis=1), allowed.doubt(middle) + TUNING.encoder_error_beyond**2 / 2.0
    first = sign * TUNING.encoder_error_beyond * steps[:, k]
    place, step, found = middle, first, []
    for _ in range(TUNING.most_steps):
        ahead = np.maximum(place + step, allowed.lower)
        trial = least_range(allowed.distances, ahead, others, allowed.lower, TUNING.encoder_error_back)
        if allowed.room(trial) > 0.0 and allowed.doubt(trial) < doubt:
            place, step = trial, TUNING.encoder_error_longer * (trial - place)
            found.append(trial)
        elif not found or np.linalg.norm(step) < TUNING.encoder_error_shortest * np.linalg.norm(first):
            break
        else:
            step = step / 2.0
    return found


def _draw_places(allowed: Allowed, chain: Floats, count: int, rng: np.random.Generator) -> Floats:
    """Draw places (count, p) on a chain (m, p) by the prior and the room at each place.

    The weight is the density at the middle of the ridge times the volume across the ridge. The volume falls with each
    of the other directions.
    """
    room, doubt = (np.array([of(q) for q in chain]) for of in (allowed.room, allowed.doubt))
    way = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(chain, axis=0), axis=1))]
    fine = np.linspace(0.0, way[-1], 50 * len(chain))
    weight = np.interp(fine, way, room) ** chain.shape[1] * np.exp(doubt.min() - np.interp(fine, way, doubt))
    at = rng.choice(fine, size=count, p=weight / weight.sum())
    return np.column_stack([np.interp(at, way, column) for column in chain.T])


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


@dataclass(frozen=True, eq=False)
class Open:
    """The set of parameters that fit the counts.

    The set has the mean (p,), the covariance (p, p) and an interval (p, 2) that holds 95 % of each parameter.
    `unexplained` [counts] is 0 if all counts are explained. Above 0, `unexplained` is the distance of the best motion
    from a count, or of a typical motion from widened counts.
    """

    mean: Floats
    covariance: Floats
    interval: Floats
    unexplained: float


def what_is_open(
    distances: Distances, start: Floats, scatter: Floats, lower: Floats, root: Floats, *, seed: int = 0
) -> Open:
    """Return the set of parameters q that fit the counts, from a start (p,) near them.

    `scatter` (p, p) is the covariance of the first search. `lower` (p,) has the least values. `root` (p, p) is the root
    of the prior information, or zeros without a prior. The prior is centred on the problem's nominal values, which are
    1. `seed` belongs to the walk. If the best motion misses a count, all counts are widened, because the distance is an
    error of the model.
    """
    steps = np.asarray(np.linalg.cholesky(scatter), float)
    middle = middle_of(distances, start, steps, lower)
    errors = distances(middle)
    narrowest = widest(errors) / 2.0
    unexplained = max(0.0, narrowest - TUNING.encoder_error_half)
    # A set that has almost vanished shows a model that the counts almost refute. A small set does not show accuracy
    # here.
    least_room = TUNING.least_room / max(e.size for e in errors)
    half = max(TUNING.encoder_error_half + TUNING.encoder_error_missing * unexplained, narrowest + least_room)
    rng = np.random.default_rng(seed)
    samples = middle + 0.1 * rng.standard_normal((TUNING.count_walkers, len(start))) @ steps.T
    for spread, counted in TUNING.encoder_error_rounds:
        quadratic = _Quadratic.fit_around(distances, middle, steps, lower)
        # At a bound the map is not around the middle itself, and may just miss the middle.
        wide = max(half, widest(quadratic(middle)) / 2.0 + least_room)

        def density(q: Floats, quadratic: _Quadratic = quadratic, wide: float = wide) -> Floats:
            prior = (q - 1.0) @ root.T
            log = sum(log_of_room(each, wide) for each in quadratic(q)) - 0.5 * np.sum(prior**2, axis=-1)
            return np.where((q < lower).any(axis=-1), -np.inf, log)

        path = walk(density, inside(density, middle, samples - middle), spread + counted, rng)[spread:]
        samples, flat = path[-1], path.reshape(-1, len(start))
        covariance = np.atleast_2d(np.cov(flat.T))
        steps = np.asarray(np.linalg.cholesky(covariance), float)
        middle = flat[np.argmax(density(flat))]
    # The map is smooth, but a motion that comes to rest is not. Some true motions therefore check the map.
    true = float(np.median([widest(distances(q)) for q in samples[:: TUNING.encoder_error_checked]])) / 2.0
    if true - wide > TUNING.encoder_error_lost:
        unexplained = max(unexplained, true - wide)
    flat = spread_along_ridges(Allowed(distances, half, lower, root), flat, middle, rng)
    return Open(
        flat.mean(axis=0),
        np.atleast_2d(np.cov(flat.T)),
        np.quantile(flat, TUNING.encoder_error_within, axis=0).T,
        unexplained,
    )


@dataclass(frozen=True, eq=False)
class _Quadratic:
    """Distances as quadratic functions of z = (q - centre) / steps.

    Without these functions, a hundred thousand simulated motions would cost too much.
    """

    centre: Floats
    inverse: Floats
    runs: list[tuple[Floats, Floats]]

    @classmethod
    def fit_around(cls, distances: Distances, q: Floats, steps: Floats, lower: Floats) -> _Quadratic:
        """Fit the motions at q, at q +- each column of the steps (p, p), and at the sums of two columns."""
        p = len(q)
        centre = np.maximum(q, lower + 2.0 * np.abs(steps).max(axis=1))
        at = [distances(centre)]
        up, down = ([distances(centre + sign * steps[:, i]) for i in range(p)] for sign in (1, -1))
        pairs = [(i, j) for i in range(p) for j in range(i)]
        both = [distances(centre + steps[:, i] + steps[:, j]) for i, j in pairs]
        runs = []
        for r, here in enumerate(at[0]):
            linear = [(up[i][r] - down[i][r]) / 2.0 for i in range(p)]
            square = [(up[i][r] + down[i][r]) / 2.0 - here for i in range(p)]
            cross = [each[r] - up[i][r] - up[j][r] + here for each, (i, j) in zip(both, pairs, strict=True)]
            runs.append((here, np.array([*linear, *square, *cross])))
        return cls(centre, np.asarray(np.linalg.inv(steps), float), runs)

    def __call__(self, q: Floats) -> list[Floats]:
        """Return the distances (..., N) of each run at q (..., p)."""
        z = (q - self.centre) @ self.inverse.T
        p = z.shape[-1]
        crossed = [z[..., i] * z[..., j] for i in range(p) for j in range(i)]
        terms = np.concatenate([z, z**2, *(each[..., None] for each in crossed)], axis=-1)
        return [here + terms @ slopes for here, slopes in self.runs]

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

#: z (..., p) -> log density (...), -inf outside.
Density = Callable[[Floats], Floats]


def inside(density: Density, middle: Floats, scatter: Floats) -> Floats:
    """Starts (..., walkers, p): middle + scatter, each moved towards the middle (p,) until the density is not 0 there.

    scatter: (..., walkers, p).
    """
    z = middle + scatter
    for _ in range(TUNING.encoder_error_halvings):
        outside = ~np.isfinite(density(z))
        if not outside.any():
            break
        z = np.where(outside[..., None], middle + (z - middle) / 2.0, z)
    return z


def walk(density: Density, z: Floats, steps: int, rng: np.random.Generator) -> Floats:
    """Where the walkers z (..., walkers, p) are after each step, (steps, ..., walkers, p); even number of walkers.

    The two halves move in turn, each walker along the line to one of the other half.
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
            with np.errstate(invalid="ignore"):  # both outside: stays
                better = np.log(rng.random(stretch.shape)) < (size - 1) * np.log(stretch) + log - logs[this]
            halves[this] = np.where(better[..., None], trial, here)
            logs[this] = np.where(better, log, logs[this])
        path[step] = np.concatenate(halves, axis=-2)
    return path


#: q (p,) -> for each run the simulated less the measured position, in counts, (N,).
Distances = Callable[[Floats], list[Floats]]


def middle_of(distances: Distances, q: Floats, steps: Floats, lower: Floats) -> Floats:
    """Parameters (p,) at which the widest range of distances is the least, by linear programs.

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
    """The same for distances that are linear, within `reach` of the steps (p, k): variables z (k,), then lowest and
    highest of each run, then the widest range."""
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
    """What is possible, and how much: room within counts of width 2 half [counts] for the distances of q (p,), at
    least `lower` (p,), times the prior with the root (p, p) of its information, centred on 1."""

    distances: Distances
    half: float
    lower: Floats
    root: Floats

    def room(self, q: Floats) -> float:
        """The distance by which the motion at q may be moved within its counts [counts], 0 if it may not."""
        return max(2.0 * self.half - widest(self.distances(q)), 0.0) if np.all(q >= self.lower) else 0.0

    def doubt(self, q: Floats) -> float:
        """Minus the logarithm of the prior."""
        return 0.5 * float(np.sum((self.root @ (q - 1.0)) ** 2))


def spread_along_ridges(allowed: Allowed, samples: Floats, middle: Floats, rng: np.random.Generator) -> Floats:
    """Spreads samples (n, p) along the ridges that go on beyond them; without such a ridge returns the samples.

    middle (p,): of the samples, possible.
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
    """Places (p,) on the ridge along column k of steps (p, p), from the middle outwards; empty if the ridge ends within
    the samples."""
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
    """Places (count, p) on a chain (m, p), by the prior and the room that is left there: the density at the ridge's
    middle times the volume across it, which falls with each of the other directions."""
    room, doubt = (np.array([of(q) for q in chain]) for of in (allowed.room, allowed.doubt))
    way = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(chain, axis=0), axis=1))]
    fine = np.linspace(0.0, way[-1], 50 * len(chain))
    weight = np.interp(fine, way, room) ** chain.shape[1] * np.exp(doubt.min() - np.interp(fine, way, doubt))
    at = rng.choice(fine, size=count, p=weight / weight.sum())
    return np.column_stack([np.interp(at, way, column) for column in chain.T])


def encoder_covariance(problem: Problem, u: ArrayLike) -> Floats | None:
    """Mean square error (p, p) of unknown + nuisance, in their own units, of `calibrate` after one run of u (n,).

    The mean over machines that differ from the nominal values by as much as is not known, at most
    encoder_error_wrong, each from
    another start phase: what their counts leave open is as in `counted`, with sensitivities of the simulated motion. A
    motion that is the best for the nominal values may come to rest on another machine, and tell a hundredth: so the
    corners of what is not known are among the machines.
    None if the noise does not come from an encoder, or if run and prior do not determine a parameter.
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
        roots.append(np.linalg.inv(np.linalg.cholesky(12.0 * s @ s.T + known)).T)  # z: the scatter of white noise
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
    """The prior (p, p) of the scaled parameters, plus a weak bound for a machine that rests."""
    return np.asarray(prior + np.eye(len(prior)) / TUNING.encoder_error_far**2)


def _machines(problem: Problem, prior: Floats) -> list[dict[str, float]]:
    """Parameters around the nominal ones, with what the prior (p, p) knows of the scaled ones: normal, and corners."""
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
    ready = _informations(problem, u)
    if ready is None:
        return None
    prior, F = ready
    covariance = _white_covariance(problem, u, prior) if problem.drive.friction == "symmetric" else np.linalg.inv(F)
    return np.asarray(covariance * np.outer(problem.scale, problem.scale))


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


def _informations(problem: Problem, u: ArrayLike) -> tuple[Floats, Floats] | None:
    """Prior and information with it (p, p), scaled, the start unknown; None if they leave a parameter open."""
    maps = affine(problem)
    F = start_free(maps.weigh_sensitivities(u)) + maps.prior
    return None if np.linalg.cond(F) > TUNING.encoder_error_worst else (maps.prior, F)


def is_counted(problem: Problem) -> bool:
    """Whether the noise comes from an encoder, on an axis that can be simulated."""
    return problem.resolution is not None and problem.noise_variance is None and problem.drive.friction == "symmetric"


def start_free(sensitivity: Floats) -> Floats:
    """Information (p, p) of sensitivities (p, N) where the start position is unknown, but measured as well."""
    s = centred_sensitivities(sensitivity)
    return np.asarray(s @ s.T)


def centred_sensitivities(sensitivity: Floats) -> Floats:
    """(p, N + 1) from (p, N): with the sample at the start, and without what a shift of the position can do as well."""
    s = np.column_stack([np.zeros(len(sensitivity)), sensitivity])
    return np.asarray(s - s.mean(axis=1, keepdims=True))


@dataclass(frozen=True, eq=False)
class Open:
    """The set of parameters that fit the counts: mean (p,), covariance (p, p), interval (p, 2) with 95 % of each.

    unexplained: distance of the best motion from a count, or of a typical motion of the set from its widened counts
    [counts]; 0 if all counts are explained.
    """

    mean: Floats
    covariance: Floats
    interval: Floats
    unexplained: float


def what_is_open(
    distances: Distances, start: Floats, scatter: Floats, lower: Floats, root: Floats, *, seed: int = 0
) -> Open:
    """The set of parameters q that fit the counts, from a start (p,) near them.

    scatter (p, p): covariance of the first search. lower (p,): least values. root (p, p): of the prior information,
    centred on the problem's nominal values, which are 1; zeros for none. seed: of the walk.
    If the best motion misses a count, all counts are widened, because the distance is an error of the model.
    """
    steps = np.asarray(np.linalg.cholesky(scatter), float)
    middle = middle_of(distances, start, steps, lower)
    errors = distances(middle)
    narrowest = widest(errors) / 2.0
    unexplained = max(0.0, narrowest - TUNING.encoder_error_half)
    # a set that all but vanished is the mark of a model that is all but refuted, and no accuracy
    least_room = TUNING.least_room / max(e.size for e in errors)
    half = max(TUNING.encoder_error_half + TUNING.encoder_error_missing * unexplained, narrowest + least_room)
    rng = np.random.default_rng(seed)
    samples = middle + 0.1 * rng.standard_normal((TUNING.count_walkers, len(start))) @ steps.T
    for spread, counted in TUNING.encoder_error_rounds:
        quadratic = _Quadratic.fit_around(distances, middle, steps, lower)
        # at a bound the map is not around the middle itself, and may just lose it
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
    # the map is smooth; a motion that comes to rest is not: what it promises is held against some motions themselves
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
    """Distances as quadratics of z = (q - centre) / steps; a hundred thousand motions would cost too much."""

    centre: Floats
    inverse: Floats
    runs: list[tuple[Floats, Floats]]

    @classmethod
    def fit_around(cls, distances: Distances, q: Floats, steps: Floats, lower: Floats) -> _Quadratic:
        """Fits the motions at q, at q +- each column of steps (p, p), and at the sums of two columns."""
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
        """q (..., p) -> for each run (..., N)."""
        z = (q - self.centre) @ self.inverse.T
        p = z.shape[-1]
        crossed = [z[..., i] * z[..., j] for i in range(p) for j in range(i)]
        terms = np.concatenate([z, z**2, *(each[..., None] for each in crossed)], axis=-1)
        return [here + terms @ slopes for here, slopes in self.runs]

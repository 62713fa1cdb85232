"""What counts leave open: all parameters whose motion passes through every count, each as likely as it has room.

Least squares takes the error of an encoder for noise. It is none: a count says between which two positions the axis
is. With a start anywhere on the lattice the likelihood of a motion is the distance by which it could be moved and still
give the same counts (set-membership estimation: Milanese and Vicino 1991). Its mean and scatter are the estimate and
its deviation, however the error repeats along the motion; nothing of it is linear, white or normal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pmfid.design.trial.encoder_error import log_of_room
from pmfid.design.trial.least_range import Distances, middle_of, widest
from pmfid.design.trial.ridges import Allowed, spread_along_ridges
from pmfid.design.trial.walkers import inside, walk
from pmfid.types import Floats

__all__ = ["Open", "what_is_open"]

#: Half a count, and how often what is missing to explain all counts is added to it.
HALF, MISSING = 0.5, 2.0
#: Room that the right model leaves at least, in counts times samples: less in one run of a hundred.
LEAST_ROOM = 0.25
WALKERS = 48
#: One in CHECKED walkers is checked.
CHECKED = 4
#: Counts that the map may be wrong by.
LOST = 0.05
#: Rounds of the walk, each on a map around the last one's middle: steps to spread, steps that count.
ROUNDS = ((100, 60), (60, 60), (60, 240))
#: Quantiles of the interval that holds 95 %.
WITHIN = (0.025, 0.975)


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
    unexplained = max(0.0, narrowest - HALF)
    # a set that all but vanished is the mark of a model that is all but refuted, and no accuracy
    least_room = LEAST_ROOM / max(e.size for e in errors)
    half = max(HALF + MISSING * unexplained, narrowest + least_room)
    rng = np.random.default_rng(seed)
    samples = middle + 0.1 * rng.standard_normal((WALKERS, len(start))) @ steps.T
    for spread, counted in ROUNDS:
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
    true = float(np.median([widest(distances(q)) for q in samples[::CHECKED]])) / 2.0
    if true - wide > LOST:
        unexplained = max(unexplained, true - wide)
    flat = spread_along_ridges(Allowed(distances, half, lower, root), flat, middle, rng)
    return Open(flat.mean(axis=0), np.atleast_2d(np.cov(flat.T)), np.quantile(flat, WITHIN, axis=0).T, unexplained)


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

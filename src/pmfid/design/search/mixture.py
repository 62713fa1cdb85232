"""The best proportions of several motions, and what they say about the best single one.

A criterion that is a concave function of the information has its largest value over *mixtures* where no motion has more
than its share: <gradient, F_i> <= 1 for all (Kiefer and Wolfowitz 1960). So the gradient at a mixture bounds every
single one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pmfid.design.problem.criteria import Criterion
from pmfid.design.problem.fisher import Affine
from pmfid.design.search.ascent import Climber
from pmfid.design.search.oracle import Oracle
from pmfid.types import Floats

__all__ = ["best_mixture", "proportions", "share"]

#: A motion may have so much more than its share.
ENOUGH = 1e-6
ROUNDS = 2000
#: Weights below this take no part.
NEGLIGIBLE = 1e-6
#: New motions at most, and starts of the search for each.
MOTIONS, SEARCHES = 30, 4


def proportions(rule: Criterion, informations: Floats, rounds: int = ROUNDS) -> Floats:
    """Weights (m,), summing to 1, with the largest value of the criterion at sum weights[i] informations[i] (m, p, p).

    Multiplicative steps (Silvey, Titterington and Torsney 1978).
    """
    weights = np.full(len(informations), 1.0 / len(informations))
    for _ in range(rounds):
        mean = np.tensordot(weights, informations, 1)
        shares = np.tensordot(informations, rule.gradient(mean), 2)
        if shares.max() < 1.0 + ENOUGH:
            break
        weights = weights * np.maximum(shares, 0.0) ** 0.9
        weights /= weights.sum()
    return np.where(weights < NEGLIGIBLE, 0.0, weights)


def share(rule: Criterion, mean: Floats) -> Floats:
    """W (p, p) with value(F) <= trace(W F) for every information F, equal at the mean.

    The criteria are homogeneous and concave in F, so that the tangent at the mean is such a bound.
    """
    return rule.gradient(mean) * rule.value(mean)


def best_mixture(
    maps: Affine, rule: Criterion, oracle: Oracle, inputs: list[Floats], seed: int = 0
) -> tuple[Floats, list[Floats]]:
    """Information of the best mixture found, and the inputs that carry it.

    Adds, one at a time, the input with the largest share of the tangent (Fedorov 1972; Wynn 1970).
    """
    rng = np.random.default_rng(seed)
    inputs = list(inputs)
    for _ in range(MOTIONS):
        informations = np.array([maps.information(u) for u in inputs])
        weights = proportions(rule, informations)
        mean = np.tensordot(weights, informations, 1)
        u = _largest_share(maps, rule.gradient(mean), oracle, rng)
        inputs = [v for v, weight in zip(inputs, weights, strict=True) if weight > 0]
        if np.sum(rule.gradient(mean) * maps.information(u)) < 1.001:
            break
        inputs.append(u)
    return mean, inputs


def _largest_share(maps: Affine, weight: Floats, oracle: Oracle, rng: np.random.Generator) -> Floats:
    """Input with the largest trace(weight F(u)) that a few local searches find: full steps climb a convex function."""
    climber = Climber((_rotate_maps(maps, weight),), Criterion("trace", len(maps.scale)), oracle)
    return max((climber.start(rng) for _ in range(SEARCHES)), key=lambda found: found[0])[1]


def _rotate_maps(maps: Affine, weight: Floats) -> Affine:
    """The maps after which the plain trace is trace(weight F)."""
    eigenvalues, vectors = np.linalg.eigh(weight)
    root = (vectors * np.sqrt(np.maximum(eigenvalues, 0.0))) @ vectors.T
    p = len(weight)
    return replace(
        maps,
        matrix=(root @ maps.matrix.reshape(p, -1)).reshape(maps.matrix.shape),
        offset=(root @ maps.offset.reshape(p, -1)).ravel(),
        prior=root @ maps.prior @ root,
    )

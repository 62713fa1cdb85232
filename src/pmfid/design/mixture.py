"""The best proportions of several motions, and what they say about the best single one.

A criterion that is a concave function of the information has its largest value over *mixtures* where no motion has more
than its share: <gradient, F_i> <= 1 for all (Kiefer and Wolfowitz 1960). So the gradient at a mixture bounds every
single one.
"""

from __future__ import annotations

import numpy as np

from pmfid.design.criteria import Criterion
from pmfid.design.problem import Float

__all__ = ["proportions", "share"]

#: A motion may have so much more than its share.
ENOUGH = 1e-6
ROUNDS = 2000
#: Weights below this take no part.
NEGLIGIBLE = 1e-6


def proportions(rule: Criterion, informations: Float, rounds: int = ROUNDS) -> Float:
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


def share(rule: Criterion, mean: Float) -> Float:
    """W (p, p) with value(F) <= trace(W F) for every information F, equal at the mean.

    The criteria are homogeneous and concave in F, so that the tangent at the mean is such a bound.
    """
    return rule.gradient(mean) * rule.value(mean)

"""The comparison of models: candidate forces with Gaussian priors as columns of one Jacobian.

For the information A and the gradient g at the fit, the evidence of each set of candidates has a closed form. The best
set is found by adding and dropping one candidate at a time. The sets next to it, each with its posterior weight, give
the spread of the parameters over the models that the record cannot exclude (Raftery, Madigan and Hoeting 1997).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pmfid.types import Floats

#: Prior odds of a candidate to its absence: one force of ten is there.
ODDS = math.log(0.1)
#: Most candidates in a set, beyond which no record tells the forces of one axis apart.
MOST = 8


@dataclass(frozen=True, eq=False)
class Local:
    """A quadratic log likelihood around a fit: information A (p, p) and gradient g (p,) of minus the log likelihood by
    the parameters, of which the first `plain` are always in the model and the others are candidates with unit priors
    about `-offset` (p,)."""

    A: Floats
    g: Floats
    plain: int

    def evidence(self, chosen: Sequence[int]) -> tuple[float, Floats, Floats]:
        """Return the log evidence of a set of candidates, the parameters' step (k,) and covariance (k, k), for the
        plain parameters and then the candidates."""
        index = [*range(self.plain), *(self.plain + j for j in chosen)]
        A = self.A[np.ix_(index, index)].copy()
        A[range(self.plain, len(index)), range(self.plain, len(index))] += 1.0
        size = np.sqrt(np.maximum(np.diag(A), 1e-300))
        root = np.linalg.cholesky(A / np.outer(size, size) + 1e-13 * np.eye(len(index)))
        half = np.linalg.solve(root, -self.g[index] / size)
        inverse = np.linalg.solve(root, np.eye(len(index)))
        covariance = inverse.T @ inverse / np.outer(size, size)
        value = 0.5 * float(half @ half) - float(np.sum(np.log(np.diag(root)) + np.log(size)))
        return value + ODDS * len(chosen), np.linalg.solve(root.T, half) / size, covariance

    def best(self, first: Sequence[int], allowed: Sequence[int]) -> list[int]:
        """Return the set of candidates with the largest evidence that steps of one candidate reach from `first`."""
        chosen, value = list(first), self.evidence(first)[0]
        while True:
            sets = self.neighbours(chosen, allowed)
            values = [self.evidence(one)[0] for one in sets]
            if not values or max(values) <= value:
                return sorted(chosen)
            value, chosen = max(values), sets[int(np.argmax(values))]

    def neighbours(self, chosen: Sequence[int], allowed: Sequence[int]) -> list[list[int]]:
        """Return the sets with one candidate more or less."""
        fewer = [[j for j in chosen if j != one] for one in chosen]
        more = [[*chosen, j] for j in allowed if j not in chosen] if len(chosen) < MOST else []
        return [*fewer, *more]

    def spread(self, chosen: Sequence[int], allowed: Sequence[int]) -> Floats:
        """Return the standard deviations (plain,) of the plain parameters over the sets next to `chosen`, beyond their
        standard errors within that set."""
        value, step, covariance = self.evidence(chosen)
        weight, total = 1.0, np.zeros(self.plain)
        for one in self.neighbours(chosen, allowed):
            other, moved, wider = self.evidence(one)
            share = math.exp(min(other - value, 50.0))
            more = np.diag(wider)[: self.plain] - np.diag(covariance)[: self.plain]
            total += share * ((moved - np.append(step, np.zeros(moved.size))[: moved.size])[: self.plain] ** 2 + more)
            weight += share
        return np.sqrt(np.maximum(total / weight, 0.0))

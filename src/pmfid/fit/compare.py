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

#: Prior odds of a row of the table to its absence: one force of ten is there. The candidates of a row share the odds.
ODDS = math.log(0.1)
#: Half length of a normal 95 % interval in standard deviations.
NORMAL_95 = 1.96
#: Most candidates in a set, beyond which no record tells the forces of one axis apart.
MOST = 6


@dataclass(frozen=True, eq=False)
class Quadratic:
    """A quadratic log likelihood around a fit: information A (p, p) and gradient g (p,) of minus the log likelihood by
    the parameters, of which the first `plain` are always in the model and the others are candidates with unit priors
    `odds` (p - plain,), as logarithms, and lower bounds `lowest` (p - plain,) of their sizes."""

    A: Floats
    g: Floats
    plain: int
    odds: Floats
    lowest: Floats

    def evidence(self, chosen: Sequence[int]) -> tuple[float, Floats, Floats]:
        """Return the log evidence of a set of candidates, the parameters' step (k,) and covariance (k, k), for the
        plain parameters and then the candidates."""
        index = [*range(self.plain), *(self.plain + j for j in chosen)]
        A = self.A[np.ix_(index, index)].copy()
        A[range(self.plain, len(index)), range(self.plain, len(index))] += 1.0
        size = np.sqrt(np.maximum(np.diag(A), 1e-200))
        try:
            root = np.linalg.cholesky(A / np.outer(size, size) + 1e-9 * np.eye(len(index)))
        except np.linalg.LinAlgError:  # the motion overflows
            return -math.inf, np.zeros(len(index)), np.full((len(index), len(index)), np.inf)
        half = np.linalg.solve(root, -self.g[index] / size)
        inverse = np.linalg.solve(root, np.eye(len(index)))
        covariance = inverse.T @ inverse / np.outer(size, size)
        value = 0.5 * float(half @ half) - float(np.sum(np.log(np.diag(root)) + np.log(size)))
        step = np.linalg.solve(root.T, half) / size
        if np.any(step[self.plain :] < self.lowest[list(chosen)]):
            return -math.inf, step, covariance
        return value + float(np.sum(self.odds[list(chosen)])), step, covariance

    def best_step(self, chosen: Sequence[int], allowed: Sequence[int]) -> list[int] | None:
        """Return the set with one candidate more or less that has the largest evidence, or None if none gains."""
        sets = self.neighbours(chosen, allowed)
        values = [self.evidence(one)[0] for one in sets]
        if not values or max(values) <= self.evidence(chosen)[0]:
            return None
        return sorted(sets[int(np.argmax(values))])

    def neighbours(self, chosen: Sequence[int], allowed: Sequence[int]) -> list[list[int]]:
        """Return the sets with one candidate more or less."""
        fewer = [[j for j in chosen if j != one] for one in chosen]
        more = [[*chosen, j] for j in allowed if j not in chosen] if len(chosen) < MOST else []
        return [*fewer, *more]

    def half_length(
        self, chosen: Sequence[int], allowed: Sequence[int], variance: Floats, rows: Floats
    ) -> tuple[Floats, int | None]:
        """Return the half length (k,) of the intervals that hold 95 % of the posterior over the sets next to `chosen`,
        and the candidate that widens them most, for the products of `rows` (k, c) and the first c parameters of the
        set. A candidate that is gone has the size 0. `variance` (k,) is that within the set.

        The set itself has a normal distribution about 0, and each set next to it another one.
        """
        value, step, inner = self.evidence(chosen)
        weights, shifts, sds = [1.0], [np.zeros(variance.size)], [np.sqrt(variance)]
        sets = [one for one in self.neighbours(chosen, allowed) if np.isfinite(self.evidence(one)[0])]
        for one in sets:
            other, moved, wider = self.evidence(one)
            kept = [k for k, j in enumerate(chosen) if j in one]
            here = [k for k in [*range(self.plain), *(self.plain + k for k in kept)] if k < rows.shape[1]]
            there = [*range(self.plain), *(self.plain + one.index(chosen[k]) for k in kept)][: len(here)]
            change, part = -step[: rows.shape[1]], rows[:, here]
            change[here] += moved[there]
            more = wider[np.ix_(there, there)] - inner[np.ix_(here, here)]
            weights.append(math.exp(min(other - value, 50.0)))
            shifts.append(rows @ change)
            sds.append(np.sqrt(np.maximum(variance + np.einsum("ij,jk,ik->i", part, more, part), 1e-300)))
        half = mixture_half_length(np.array(weights), np.array(shifts), np.array(sds))
        if not sets:
            return half, None
        squares = (np.array(shifts[1:]) ** 2 + np.array(sds[1:]) ** 2) / np.maximum(variance, 1e-300)
        widest = sets[int(np.argmax(np.array(weights[1:]) * np.max(squares, axis=1)))]
        return half, next(iter(set(widest) - set(chosen) or set(chosen) - set(widest)))


def mixture_half_length(weights: Floats, shifts: Floats, sds: Floats) -> Floats:
    """Return the half length (p,) of the interval about 0 with 95 % of a mixture of normal distributions.

    weights: (m,); shifts, sds: (m, p).
    """
    from scipy.special import ndtr

    weights = weights / np.sum(weights)
    low, high = np.zeros(shifts.shape[1]), np.max(np.abs(shifts) + 3.0 * sds, axis=0)
    for _ in range(60):
        middle = (low + high) / 2
        inside = weights @ (ndtr((middle - shifts) / sds) - ndtr((-middle - shifts) / sds))
        low, high = np.where(inside < 0.95, middle, low), np.where(inside < 0.95, high, middle)
    return np.asarray(high)

"""The comparison of terms whose sizes are never negative, with half-normal priors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pmfid.fit.compare import Quadratic
from pmfid.types import Floats


@dataclass(frozen=True, eq=False)
class BoundedQuadratic(Quadratic):
    """A quadratic log likelihood with candidates of which some have the lower bound 0.

    The posterior of such a size is a normal distribution without its negative part. Its mean and variance replace those
    of the whole distribution one candidate at a time, and the other parameters follow along their covariance with it.
    Each pair of candidates comes and goes together, and the `kept` ones stay.
    """

    pairs: tuple[tuple[int, ...], ...] = ()
    kept: tuple[int, ...] = ()

    def neighbours(self, chosen: Sequence[int], allowed: Sequence[int]) -> list[list[int]]:
        """Return the sets with one candidate more or less, or with another one in place of one."""
        others = [j for j in allowed if j not in chosen]
        sets = super().neighbours(chosen, allowed) + [[*{*chosen} - {i}, j] for i in chosen for j in others]
        whole: dict[tuple[int, ...], None] = {}
        for one in sets:
            changed = set(one) ^ set(chosen)
            for pair in map(set, self.pairs):
                if changed & pair:
                    one = [*{*one, *pair}] if set(one) & pair - set(chosen) else [*set(one) - pair]
            if not changed & set(self.kept):
                whole[tuple(sorted(one))] = None
        return [list(one) for one in whole if set(one) != set(chosen)]

    def evidence(self, chosen: Sequence[int]) -> tuple[float, Floats, Floats]:
        free = Quadratic(self.A, self.g, self.plain, self.odds, np.full(self.lowest.size, -np.inf))
        value, step, covariance = free.evidence(chosen)
        if not math.isfinite(value):
            return value, step, covariance
        lowest = np.full(step.size, -np.inf)
        lowest[self.plain :] = [self.lowest[j] for j in chosen]
        part, step, covariance = cut_below(step, covariance, lowest)
        doubled = int(np.sum(np.isfinite(lowest)))  # a half-normal prior has twice the density
        return value + part + doubled * math.log(2), step, covariance


def cut_below(mean: Floats, covariance: Floats, lowest: Floats) -> tuple[float, Floats, Floats]:
    """Return the logarithm of the part of a normal distribution above the bounds `lowest` (p,), with its mean (p,) and
    covariance (p, p). The coordinates are cut one after the other, and the others follow along their covariance."""
    from scipy.special import erfcx, log_ndtr

    value = 0.0
    for k in np.flatnonzero(np.isfinite(lowest)):
        sd = math.sqrt(max(float(covariance[k, k]), 1e-300))
        z = (float(mean[k]) - float(lowest[k])) / sd
        ratio = math.sqrt(2 / math.pi) / float(erfcx(-z / math.sqrt(2)))
        value += float(log_ndtr(z))
        along = covariance[:, k] / sd
        mean = mean + along * ratio
        covariance = covariance - np.outer(along, along) * min(max(ratio * (ratio + z), 0.0), 1 - 1e-9)
    return value, mean, covariance

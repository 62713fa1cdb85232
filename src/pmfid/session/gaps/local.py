"""An input between its samples, where it is not held: a polynomial through the nearest samples on both sides.

Through how many, and of what degree, the samples that are there say: what misses them least where they are left out.
An input that a controller makes from a coarse encoder is smooth with noise on top; a straight line cuts its bends
short, in every gap the same way, and that is a bias of the mass; a cubic through four samples doubles the noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmfid.types import Floats

#: Samples farther away than so many times `half` count for next to nothing: they lie beyond another gap.
NEAR, FAR_WEIGHT = 3.0, 1e-6
#: Left out are at most so many samples, and at least; gaps are filled in so many at once.
MOST, FEWEST, CHUNK = 1000, 30, 20_000


@dataclass(frozen=True)
class Polynomial:
    """Of a degree, by least squares through `half` samples on either side."""

    degree: int
    half: int

    def fill_grid(self, u: Floats, places: NDArray[np.intp]) -> Floats:
        """The input (n,) at every place from 0 to the last, from u (m,) at rising places (m,)."""
        whole = np.empty(int(places[-1]) + 1)
        missing = np.setdiff1d(np.arange(whole.size), places)
        whole[places] = u
        for first in range(0, missing.size, CHUNK):
            at = missing[first : first + CHUNK]
            start = np.clip(np.searchsorted(places, at) - self.half, 0, places.size - 2 * self.half)
            whole[at] = self._interpolate_at(u, places, start[:, None] + np.arange(2 * self.half), at)
        return whole

    def estimate_error(self, u: Floats, places: NDArray[np.intp], length: int) -> float:
        """Root mean square of what it misses of the sum of so many samples in a row, by those that are there; infinite
        where too few are."""
        first = np.arange(self.half, places.size - self.half - length + 1)
        first = first[places[first + length - 1] - places[first] == length - 1]
        if first.size < FEWEST:
            return np.inf
        first = first[:: -(-first.size // MOST)]
        beside = np.r_[np.arange(-self.half, 0), np.arange(length, length + self.half)]
        rows, missed = first[:, None] + beside, np.zeros(first.size)
        for k in range(length):
            missed += self._interpolate_at(u, places, rows, places[first + k]) - u[first + k]
        return float(np.sqrt(np.mean(missed**2)))

    def _interpolate_at(
        self, u: Floats, places: NDArray[np.intp], rows: NDArray[np.intp], at: NDArray[np.intp]
    ) -> Floats:
        """Values (t,) at places (t,), by the samples in rows (t, 2 half)."""
        apart = (places[rows] - at[:, None]).astype(np.float64)
        weight = np.where(np.abs(apart) <= NEAR * self.half, 1.0, FAR_WEIGHT)
        powers = (apart / np.max(np.abs(apart), axis=1, keepdims=True))[..., None] ** np.arange(self.degree + 1)
        weighted = (weight[..., None] * powers).transpose(0, 2, 1)
        level = np.mean(u[rows], axis=1)
        right = weighted @ (u[rows] - level[:, None])[..., None]
        return np.asarray(np.linalg.solve(weighted @ powers, right)[:, 0, 0] + level)


#: Those that are tried: a line, cubics through ever more samples, and a mean for an input that is nothing but noise.
TRIED = (
    Polynomial(1, 1),
    Polynomial(3, 2),
    Polynomial(3, 3),
    Polynomial(3, 4),
    Polynomial(3, 6),
    Polynomial(3, 8),
    Polynomial(0, 8),
)


def best_of(u: Floats, places: NDArray[np.intp]) -> Polynomial:
    """The one that misses least of the samples u (m,) at rising places (m,); the line where there are too few."""
    return min(TRIED, key=lambda tried: tried.estimate_error(u, places, 1) if places.size > 2 * tried.half else np.inf)

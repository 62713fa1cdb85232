"""An input between its samples if it is not held: a polynomial through the nearest samples on both sides.

The measured samples choose degree and number of samples: the polynomial with the smallest error on samples left out.
The input of a controller with a coarse encoder is smooth with noise. A straight line cuts its bends in every gap in the
same way, which biases the mass; a cubic through four samples doubles the noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmfid.types import Floats

#: Samples farther away than NEAR times `half` lie beyond another gap and have the weight FAR_WEIGHT.
NEAR, FAR_WEIGHT = 3.0, 1e-6
#: Most and fewest samples that are left out for the error; missing samples that are filled at once.
MOST, FEWEST, CHUNK = 1000, 30, 20_000


@dataclass(frozen=True)
class Polynomial:
    """A polynomial of a degree, by least squares through `half` samples on either side."""

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
        """Root mean square error of the sum of `length` successive samples, on measured samples; infinite if there are
        too few."""
        first = np.arange(self.half, places.size - self.half - length + 1)
        first = first[places[first + length - 1] - places[first] == length - 1]
        if first.size < FEWEST:
            return np.inf
        first = first[:: -(-first.size // MOST)]
        neighbours = np.r_[np.arange(-self.half, 0), np.arange(length, length + self.half)]
        rows, missed = first[:, None] + neighbours, np.zeros(first.size)
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


#: Polynomials that are tried: a line, cubics through more and more samples, and a mean for an input of pure noise.
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
    """The polynomial with the smallest error on the samples u (m,) at rising places (m,); the line if there are too
    few."""
    return min(TRIED, key=lambda tried: tried.estimate_error(u, places, 1) if places.size > 2 * tried.half else np.inf)

"""Coordinates in which a weighted information is a sum of squares, and its bound over a box of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pmfid.design.problem.fisher import Affine
from pmfid.types import Floats

__all__ = ["Box", "WeightFrame", "frame"]

#: Added to every range: the linear solver works to 1e-7.
SLACK = 1e-7


@dataclass(frozen=True, eq=False)
class WeightFrame:
    """trace(weight F(u)) = |matrix u + offset|^2 + constant for all inputs u that meet the equations of the limits.

    weight: (p, p), positive semidefinite; matrix: (r, K), offset: (r,), largest coordinates first.
    """

    weight: Floats
    matrix: Floats
    offset: Floats
    constant: float


@dataclass(eq=False)
class Box:
    """lower <= z <= upper (r,): ranges of the coordinates of a frame over a part of the inputs."""

    lower: Floats
    upper: Floats

    @property
    def slope(self) -> Floats:
        """Slopes of the chords: z^2 <= slope z - lower upper inside the box."""
        return self.lower + self.upper

    def chords(self, z: Floats) -> float:
        """Sum of the chords at z, an upper bound of |z|^2."""
        return float(self.slope @ z - self.lower @ self.upper)

    def gaps(self, z: Floats) -> Floats:
        """By how much each chord is too high at z."""
        return np.maximum(0.0, (self.upper - z) * (z - self.lower))

    def copy(self) -> Box:
        return Box(self.lower.copy(), self.upper.copy())

    def measure(self, j: int, extreme: Callable[[Floats], Floats], where: WeightFrame) -> list[Floats]:
        """Narrows range j to what the inputs allow, and returns the two inputs at its ends."""
        row, offset = where.matrix[j], where.offset[j]
        ends = [extreme(row), extreme(-row)]
        self.upper[j] = min(self.upper[j], row @ ends[0] + offset + SLACK)
        self.lower[j] = max(self.lower[j], row @ ends[1] + offset - SLACK)
        return ends


def frame(maps: Affine, weight: Floats, directions: Floats, u: Floats) -> WeightFrame:
    """The frame of a weight; directions (K, q): those in which the equations let the input u move."""
    p = len(maps.scale)
    eigenvalues, vectors = np.linalg.eigh(weight)
    root = (vectors * np.sqrt(np.maximum(eigenvalues, 0.0))) @ vectors.T
    M = (root @ maps.matrix.reshape(p, -1)).reshape(maps.matrix.shape)
    here = (root @ maps.weigh_sensitivities(u)).ravel()
    basis = np.linalg.svd(M @ directions, full_matrices=False)[0].T
    z = basis @ here
    constant = float(here @ here - z @ z + np.sum(weight * maps.prior))
    matrix = basis @ M
    return WeightFrame(weight, matrix, z - matrix @ u, constant)

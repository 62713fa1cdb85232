"""The input within the limits that is nearest to a wish."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import nnls
from scipy.sparse.linalg import spsolve

from pmfid.design.problem.problem import InfeasibleError
from pmfid.design.search.highs import least_norm
from pmfid.design.search.polytope import Polytope
from pmfid.types import Floats

__all__ = ["InputSet", "input_set", "nearest", "violation"]

#: Bounds of a row that are closer than this make it an equation.
EQUAL = 1e-9
#: A row that is missed by less, relative to the largest shortfall, is met.
MET = 1e-9


@dataclass(frozen=True, eq=False)
class InputSet:
    """lower <= matrix u <= upper (r,) and |u| <= rows.radius: the inputs u (K,) that meet all limits.

    names (r,): the limit of each row. position (K, K), position_offset (K,): nominal positions at nodes 1 to K =
    position u + position_offset; velocity likewise.
    """

    rows: Polytope
    matrix: Floats
    lower: Floats
    upper: Floats
    names: tuple[str, ...]
    position: Floats
    position_offset: Floats
    velocity: Floats
    velocity_offset: Floats


def input_set(rows: Polytope) -> InputSet:
    """The polytope without its states, which the rows named "motion" give from the input."""
    K, motion = rows.inputs, np.array([name == "motion" for name in rows.names])
    here, there = rows.matrix[:, :K], rows.matrix[:, K:].tocsr()
    right = np.column_stack([-here[motion].toarray(), rows.lower[motion]])
    states = np.asarray(spsolve(there[motion].tocsc(), right)).reshape(there.shape[1], K + 1)
    offset = there[~motion] @ states[:, K]
    return InputSet(
        rows,
        here[~motion].toarray() + there[~motion] @ states[:, :K],
        rows.lower[~motion] - offset,
        rows.upper[~motion] - offset,
        tuple(name for name in rows.names if name != "motion"),
        *(part for i in range(2) for part in (states[i : 2 * K : 2, :K], states[i : 2 * K : 2, K])),
    )


def violation(inputs: InputSet, u: Floats) -> float:
    """By how much u (K,) leaves the limits, relative to the size of each row; 0 if it meets all."""
    value = inputs.matrix @ u
    size = np.abs(inputs.matrix).sum(axis=1) * max(1.0, float(np.abs(u).max()))
    excess = np.maximum(inputs.lower - value, value - inputs.upper) / np.maximum(size, 1e-300)
    return max(0.0, float(excess.max(initial=0.0)), float(np.linalg.norm(u)) / inputs.rows.radius - 1.0)


def nearest(inputs: InputSet, wish: Floats) -> Floats:
    """u (K,) that meets all limits and is nearest to the wish (K,) in the sum of squares.

    A least distance problem (Lawson and Hanson 1974, chapter 23). Where the nearest takes more energy than allowed: the
    first input that does not, on the way to the one of least energy.
    Raises InfeasibleError if no input meets the limits.
    """
    u = _nearest(inputs, wish)
    if np.linalg.norm(u) <= inputs.rows.radius:
        return u
    least = _nearest(inputs, np.zeros(len(wish)))
    step = u - least
    a, b, c = step @ step, least @ step, least @ least - inputs.rows.radius**2
    if c > 0:
        raise InfeasibleError("the energy that the limits need is more than they allow; raise energy or rms")
    return np.asarray(least + step * (-b + np.sqrt(b * b - a * c)) / a)


def _nearest(inputs: InputSet, wish: Floats) -> Floats:
    """The same without the limit of energy: least norm of d where u = wish + base + Z d, the equations met by base."""
    equal = inputs.upper - inputs.lower <= EQUAL
    E, f = inputs.matrix[equal], inputs.upper[equal] - inputs.matrix[equal] @ wish
    base, Z = (np.linalg.lstsq(E, f)[0], null_space(E)) if len(E) else (np.zeros(len(wish)), np.eye(len(wish)))
    up, down = np.isfinite(inputs.upper) & ~equal, np.isfinite(inputs.lower) & ~equal
    A = np.vstack([inputs.matrix[up], -inputs.matrix[down]])
    b = np.r_[inputs.upper[up], -inputs.lower[down]]
    size = np.linalg.norm(A @ Z, axis=1)
    free = size > EQUAL * np.linalg.norm(A, axis=1)  # the others are constant where the equations hold
    G, h = -(A @ Z)[free] / size[free, None], (A @ (wish + base) - b)[free] / size[free]
    return np.asarray(wish + base + Z @ _least_distance(G, h))


def _least_distance(G: Floats, h: Floats) -> Floats:
    """d of least norm with G d >= h, rows of G of unit length."""
    size = float(h.max(initial=0.0))
    if size <= 0.0:
        return np.zeros(G.shape[1])
    # in units of the largest shortfall: if no such d exists, the residual is 0 and not 1 / (1 + |d|^2)
    return size * _least_distance_of_one(G, h / size)


def _least_distance_of_one(G: Floats, h: Floats) -> Floats:
    """The same for a largest h of 1.

    If limits of position and velocity coincide next to a standstill, the active set of `nnls` may become singular. Its
    result is then no minimum. So the result is checked, and computed in another way if the check fails.
    """
    try:
        y, _ = nnls(np.vstack([G.T, h]), np.r_[np.zeros(G.shape[1]), 1.0])
    except RuntimeError:
        return least_norm(G, h)
    residual = np.r_[G.T @ y, h @ y - 1.0]
    if abs(residual[-1]) < EQUAL:
        raise InfeasibleError("no input meets all limits; relax one of them")
    d = np.asarray(-residual[:-1] / residual[-1])
    return d if (h - G @ d).max() <= MET else least_norm(G, h)

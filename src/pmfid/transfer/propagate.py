"""Exact response of x' = F x + g w at the samples of a grid, w held or linear between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm, schur

from pmfid.types import Floats

#: Terms of the exponential series once its argument is scaled below SERIES_NORM: beyond float64.
SERIES_TERMS = 14
SERIES_NORM = 0.25
#: Columns of a product of a small matrix with a long one at a time.
BLOCK = 2048


@dataclass(frozen=True)
class Grid:
    """Instants of one uninterrupted stretch of a record.

    steps: (N-1,) times between neighbouring instants, or one number where all are equal; size: N.
    """

    steps: Floats | float
    size: int

    @property
    def uniform(self) -> bool:
        return isinstance(self.steps, float)

    @property
    def duration(self) -> float:
        """From the first instant to the last."""
        return float(np.sum(self.steps)) * (self.size - 1 if self.uniform else 1)

    @property
    def instants(self) -> Floats:
        """(N,) from 0 on."""
        steps = np.full(self.size - 1, self.steps) if isinstance(self.steps, float) else self.steps
        return np.concatenate([[0.0], np.cumsum(steps)])

    @property
    def reversed(self) -> Grid:
        """The same with the last instant first."""
        return Grid(self.steps if isinstance(self.steps, float) else self.steps[::-1], self.size)


@dataclass(frozen=True)
class Transition:
    """x[k+1] = phi x[k] + now w[k] + change (w[k+1] - w[k]); arrays of one step (uniform grid) or of each."""

    phi: Floats
    now: Floats
    change: Floats


def transition(F: Floats, g: Floats, grid: Grid) -> Transition:
    """The exact transition for w linear between instants (its change 0 where it is held); F: (n, n), g: (n,)."""
    n = F.shape[0]
    steps = np.atleast_1d(np.asarray(grid.steps, float))
    distinct, back = np.unique(steps, return_inverse=True)
    whole = np.zeros((distinct.size, n + 2, n + 2))
    whole[:, :n, :n] = F * distinct[:, None, None]
    whole[:, :n, n] = g * distinct[:, None]
    whole[:, n, n + 1] = 1.0
    found = expm(whole[0]) if grid.uniform else _exponential(whole)[back.ravel()]
    return Transition(found[..., :n, :n], found[..., :n, n], found[..., :n, n + 1])


def respond(F: Floats, g: Floats, grid: Grid, w: Floats, start: Floats, *, held: bool) -> Floats:
    """States (n, channels, N) under w (channels, N) from start (n, channels); held: w is constant within a step. Not a
    number where a step of the process leaves the range of numbers, as one that is far off may."""
    step = transition(F, g, grid)
    if not np.all(np.isfinite(step.phi)):
        return np.full((*start.shape, w.shape[1]), np.nan)
    if not grid.uniform:
        forced = step.now.T[:, None, :] * w[:, :-1]
        if not held:
            forced = forced + step.change.T[:, None, :] * np.diff(w)
        return _recur_varying(step.phi, forced, start)
    T, Q = schur(step.phi, output="complex")
    back = Q.conj().T
    now, change = back @ step.now, np.zeros(F.shape[0]) if held else back @ step.change
    modes = _recur(
        T, [a * w[:, :-1] + (0.0 if held else b * np.diff(w)) for a, b in zip(now, change, strict=True)], back @ start
    )
    return _combine_modes(Q, modes).reshape(*start.shape, -1)


def _recur(T: Floats, forced: list[Floats], start: Floats) -> list[Floats]:
    """x[k+1] = T x[k] + forced[k], T upper triangular (a Schur form keeps close poles exact): a first-order recursion
    for each state, the last one first."""
    from scipy.signal import lfilter  # slow to import, and only transfer functions need it

    states: list[Floats] = []
    for i in range(T.shape[0] - 1, -1, -1):
        drive = np.empty((start.shape[1], forced[i].shape[1] + 1), complex)
        drive[:, 0], drive[:, 1:] = start[i], forced[i]
        for value, state in zip(T[i, i + 1 :], states, strict=True):
            drive[:, 1:] += value * state[:, :-1]
        states.insert(0, lfilter([1.0], [1.0, -T[i, i]], drive))
    return states


def _combine_modes(Q: Floats, modes: list[Floats]) -> Floats:
    """Real part of Q modes, in blocks so small that the product stays in one thread: more threads only wait."""
    real, imag = np.array([mode.real.ravel() for mode in modes]), np.array([mode.imag.ravel() for mode in modes])
    result = np.empty(real.shape)
    for first in range(0, real.shape[1], BLOCK):
        part = slice(first, first + BLOCK)
        result[:, part] = Q.real @ real[:, part] - Q.imag @ imag[:, part]
    return result


def product(matrix: Floats, rows: Floats) -> Floats:
    """matrix (n, n) times rows (n, N), in blocks for the same reason."""
    result = np.empty(rows.shape)
    for first in range(0, rows.shape[1], BLOCK):
        part = slice(first, first + BLOCK)
        result[:, part] = matrix @ rows[:, part]
    return result


def _recur_varying(phi: Floats, forced: Floats, start: Floats) -> Floats:
    drive = np.ascontiguousarray(np.moveaxis(forced, -1, 0))
    states = np.empty((drive.shape[0] + 1, *start.shape))
    states[0] = x = start
    for k in range(drive.shape[0]):
        x = phi[k] @ x + drive[k]
        states[k + 1] = x
    return np.asarray(np.moveaxis(states, 0, -1))


def _exponential(matrices: Floats) -> Floats:
    """exp of each of (k, n, n) by scaling, series and squaring; scipy's goes through them one by one."""
    size = float(np.max(np.sum(np.abs(matrices), axis=-1)))
    squarings = max(0, int(np.ceil(np.log2(max(size, 1e-300) / SERIES_NORM))))
    scaled = matrices / 2.0**squarings
    unit = np.eye(matrices.shape[-1])
    result = unit + scaled / SERIES_TERMS
    for term in range(SERIES_TERMS - 1, 0, -1):
        result = unit + scaled @ result / term
    for _ in range(squarings):
        result = result @ result
    return np.asarray(result)

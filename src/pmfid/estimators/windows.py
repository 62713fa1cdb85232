"""Simulation over windows of a record, each from a start of its own.

Least squares of a whole simulation weighs how far the position drifts, a force balance weighs the force. What
predicts a machine whose friction no model has lies between them: simulation over windows of some length, with starts
that are fitted, too (multiple shooting without continuity: Bock 1983; what it does to the sum of squares: Ribeiro et
al. 2020).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from pmfid.estimators.difference import STEP, WHITE, Difference, rms
from pmfid.estimators.scatter import TINY
from pmfid.estimators.starts import choose_start, fit_start
from pmfid.types import Floats

#: Each window begins in the middle of the one before: where they lie must not decide.
HOPS = 2
MAX_STEPS = 60
#: A step that lowers the sum of squares by less than this part has settled.
SETTLED = 1e-8
#: The same where windows of different lengths are compared.
ROUGHLY = 1e-4
MAX_DAMPING = 1e8


@dataclass(frozen=True)
class Windows(Difference):
    """A `Difference` over windows that overlap, without a high-pass, as a function of q = (theta, x0, v0, x0, v0, ...)
    / scale: parameters (p,), and a start for each window.

    Its samples are those of the windows one after the other. pieces: the windows; firsts: their first samples in the
    record.
    """

    pieces: tuple[Difference, ...] = ()
    firsts: tuple[int, ...] = ()

    @classmethod
    def cover_stretches(cls, difference: Difference, stretches: Sequence[tuple[int, int]], length: int) -> Windows:
        """Windows of about `length` samples that fill stretches of the record, from first to last - 1 each."""
        edges = [edge for stretch in stretches for edge in _covering(*stretch, length)]
        own = {field.name: getattr(difference, field.name) for field in fields(Difference)} | {"pole": 0.0}
        pieces = tuple(Difference(**own).part(first, last) for first, last in edges)
        return cls(**own, pieces=pieces, firsts=tuple(first for first, _ in edges))

    def start_windows(self, theta: Floats, cutoff: float) -> Floats:
        """q (q,) at scaled parameters (p,) with the start of each window that fits it; each is begun at the speed that
        the window before has there, or that the counts show within 1 / cutoff [s]."""
        places, speeds, before = [], np.zeros(0), 0
        for part, first in zip(self.pieces, self.firsts, strict=True):
            there = speeds[first - before : first - before + 1].tolist()
            q = fit_start(part, choose_start(part, theta, cutoff, there))
            places.append(q[theta.size :])
            speeds, before = part.motion(q)[1], first
        return np.concatenate([theta, *places])

    def split_windows(self, q: Floats) -> list[tuple[Difference, Floats]]:
        """Each window with its own q (p + 2,)."""
        p = self.parameters
        return [(part, np.r_[q[:p], place]) for part, place in zip(self.pieces, q[p:].reshape(-1, 2), strict=True)]

    def __call__(self, q: Floats) -> Floats:
        return np.concatenate([part(own) for part, own in self.split_windows(q)])

    def motion(self, q: Floats, force: Floats | None = None) -> tuple[Floats, Floats]:
        position, velocity = zip(*(part.motion(own) for part, own in self.split_windows(q)), strict=True)
        return np.concatenate(position), np.concatenate(velocity)

    def own_sensitivity(self, q: Floats, root: Floats | None = None, width: float = STEP) -> Floats:
        return np.concatenate([part.own_sensitivity(own, None, width) for part, own in self.split_windows(q)])

    def sum_by_sample(self, values: Floats) -> Floats:
        """(n, ...) at the samples of the record, the sum over the windows that have them."""
        total, begin = np.zeros((self.y.size, *values.shape[1:])), 0
        for part, first in zip(self.pieces, self.firsts, strict=True):
            total[first : first + part.y.size] += values[begin : begin + part.y.size]
            begin += part.y.size
        return total

    @property
    def lower(self) -> Floats:
        return np.concatenate([super().lower[:-2], np.full(2 * len(self.pieces), -np.inf)])

    @property
    def size_of_motion(self) -> float:
        """About the mean of each window: what a start cannot follow."""
        return rms(np.concatenate([part.y - np.mean(part.y) for part in self.pieces]) / self.resolution)


def _covering(first: int, last: int, length: int) -> list[tuple[int, int]]:
    count = max(1, round((last - first) / length))
    size = (last - first) // count
    begins = np.linspace(first, last - size, HOPS * (count - 1) + 1).round().astype(int)
    return [(begin, begin + size) for begin in begins.tolist()]


@dataclass(frozen=True)
class _Slope:
    """One window, linear at its q: what is left (n,), the parameters' own effect on it (n, p), and by how much its
    start moves, (2,) for what is left and (2, p) for a unit of each parameter."""

    left: Floats
    own: Floats
    start: Floats
    moves: Floats


def _slope(part: Difference, q: Floats) -> _Slope:
    error, jacobian = part(q), part.jacobian(q)
    effects, nuisance = np.column_stack([error, jacobian[:, :-2]]), jacobian[:, -2:]
    prior = np.array([[0.0, 1 / part.start_velocity_std]])
    targets = np.r_[WHITE * effects, np.zeros((1, effects.shape[1]))]
    moves = np.linalg.lstsq(np.r_[WHITE * nuisance, prior], targets)[0]
    apart = effects - nuisance @ moves
    return _Slope(apart[:, 0], apart[:, 1:], moves[:, 0], moves[:, 1:])


def descend(windows: Windows, q: Floats, settled: float = SETTLED) -> Floats:
    """Least squares from q (q,): damped steps of Gauss and Newton, the starts eliminated window by window; a parameter
    that a step would take below its bound stays there."""
    low, p, damping = windows.lower, windows.parameters, 1e-3
    cost, slopes = _cost(windows(q)), [_slope(part, own) for part, own in windows.split_windows(q)]
    for _ in range(MAX_STEPS):
        theta = np.maximum(q[:p] + _step(slopes, damping, q[:p] <= low[:p]), low[:p])
        trial = _move_starts(windows, q, theta, slopes)
        found = _cost(windows(trial))
        if found < cost:
            gain, q, cost, damping = 1 - found / cost, trial, found, damping / 10
            if gain < settled:
                break
            slopes = [_slope(part, own) for part, own in windows.split_windows(q)]
        elif damping > MAX_DAMPING:
            break
        else:
            damping *= 10
    return q


def _move_starts(windows: Windows, q: Floats, theta: Floats, slopes: Sequence[_Slope]) -> Floats:
    """Other parameters (p,), and each start where it follows from them, or where it was: a start within stiction moves
    nothing until it moves much, and one such window must not hold up all others."""
    places, change = [], theta - q[: theta.size]
    for (part, own), slope in zip(windows.split_windows(q), slopes, strict=True):
        along = slope.moves @ change
        starts = [own[-2:] - step for step in (slope.start + along, along, 0.0 * along)]
        places.append(min(starts, key=lambda start: _cost(part(np.r_[theta, start]))))
    return np.concatenate([theta, *places])


def _step(slopes: Sequence[_Slope], damping: float, bound: NDArray[np.bool_]) -> Floats:
    """Of the parameters (p,), those at a bound only away from it."""
    normal = np.sum([slope.own.T @ slope.own for slope in slopes], axis=0)
    downhill = -np.sum([slope.own.T @ slope.left for slope in slopes], axis=0)
    free = ~(bound & (downhill < 0))
    normal = normal + damping * np.diag(np.maximum(np.diagonal(normal), TINY))
    step = np.zeros(free.size)
    step[free] = np.linalg.solve(normal[np.ix_(free, free)], downhill[free])
    return step


def _cost(left: Floats) -> float:
    """Sum of squares; infinite where a step was too far."""
    with np.errstate(over="ignore", invalid="ignore"):
        total = float(left @ left)
    return total if total < np.inf else np.inf

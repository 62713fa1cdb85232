"""The solver: Levenberg (1944) and Marquardt (1963) with start states eliminated, for any likelihood."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pmfid.errors import NotIdentifiableError
from pmfid.findings import MOVE
from pmfid.fit.problem import ResidualBlock
from pmfid.types import Floats

#: Precisions of the start states about zero [1/counts^2, and of counts per mean step]: weak, because an axis at rest
#: says nothing about its start velocity. A second mass at rest says little of its place. Velocities of 1e4
#: counts per step and twists of 1e5 counts occur with fine encoders, and must cost nothing. Further states are those of
#: a transfer function.
START = np.array([1e-2, 1e-10, 1e-12, 1e-10, 1e-6, 1e-6, 1e-6])


class Simulator(Protocol):
    """A model of a record: its residuals and derivatives, and the bounds of its parameters."""

    def linearise(self, q: Floats, starts: Floats) -> list[ResidualBlock]: ...
    def clip_to_bounds(self, q: Floats) -> Floats: ...


class Likelihood(Protocol):
    """A likelihood takes the blocks of a problem, and returns minus its logarithm and weighted blocks, in the memory of
    the first ones. The gradient is the sum of J' e of the weighted blocks, the curvature that of J' J."""

    def __call__(self, blocks: Sequence[ResidualBlock]) -> tuple[float, list[ResidualBlock]]: ...


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations with start states eliminated: information A (p, p) and gradient g (p,), with a prior.

    `fall` is the slope of the cost along the step of the start states alone.
    """

    A: Floats
    g: Floats
    blocks: Sequence[ResidualBlock]
    inner: Sequence[Floats]
    fall: float

    @property
    def rows(self) -> int:
        """Number of observations."""
        return sum(block.e.size for block in self.blocks)

    def starts(self, step: Floats) -> Floats:
        """Return the steps (m, s) of the start states that go with a step (p,) of the parameters."""
        return np.array([-(h[:, 0] + h[:, 1:] @ step) for h in self.inner])


def normal_of(blocks: Sequence[ResidualBlock], starts: Floats, damping: float = 0.0) -> Normal:
    """Return the normal equations of weighted blocks."""
    weak = START[: starts.shape[1]]
    cross = np.array([block.K.T @ block.J for block in blocks])
    curved = np.array([block.K.T @ block.K for block in blocks]) + np.diag(weak)
    pull = np.array([block.K.T @ block.e for block in blocks]) + weak * starts
    diagonal = np.einsum("mss->ms", curved)
    curved = curved + damping * diagonal[:, None, :] * np.eye(weak.size)
    size = np.sqrt(np.einsum("mss->ms", curved))
    scaled = curved / (size[:, :, None] * size[:, None, :]) + 1e-12 * np.eye(weak.size)
    inner = (
        np.linalg.solve(scaled, np.concatenate([pull[..., None], cross], axis=2) / size[..., None]) / size[..., None]
    )
    A = sum(block.J.T @ block.J for block in blocks) - np.einsum("msp,msq->pq", cross, inner[..., 1:])
    g = sum(block.J.T @ block.e for block in blocks) - np.einsum("msp,ms->p", cross, inner[..., 0])
    fall = float(np.sum(pull * inner[..., 0]))
    return Normal(A, g, blocks, inner, fall)


@dataclass(frozen=True, eq=False)
class Optimum:
    """Parameters q (p,), start states (m, s), the cost, and the normal equations there without prior and damping.
    `settled` is False if the steps ended before the cost did."""

    q: Floats
    starts: Floats
    cost: float
    normal: Normal
    settled: bool


def solve(
    problem: Simulator,
    likelihood: Likelihood,
    q: Floats,
    starts: Floats,
    prior: Floats,
    steps: int = 30,
    small: float = 1e-3,
) -> Optimum:
    """Minimise minus the log likelihood, plus that of a prior with precisions (p,) about zero.

    The search ends when a step gains less than `small`, in units of the log likelihood.
    """
    damping, settled = 1e-4, False
    at = _Point(problem, likelihood, q, starts, prior)
    for _ in range(steps):
        better, damping = _descend(at, damping, small)
        if better is None:
            settled = True
            break
        gain, at = at.cost - better.cost, better
        if gain < small:
            settled = True
            break
    return Optimum(at.q, at.starts, at.cost, normal_of(at.blocks, at.starts), settled)


class _Point:
    """A point of the search with its cost and its weighted blocks."""

    def __init__(self, problem: Simulator, likelihood: Likelihood, q: Floats, starts: Floats, prior: Floats) -> None:
        self.problem, self.likelihood, self.q, self.starts, self.prior = problem, likelihood, q, starts, prior
        cost, self.blocks = likelihood(problem.linearise(q, starts))
        self.cost = float(cost + 0.5 * prior @ q**2 + 0.5 * np.sum(START[: starts.shape[1]] * starts**2))

    def move(self, step: Floats, starts: Floats) -> _Point:
        q = self.problem.clip_to_bounds(self.q + step)
        return _Point(self.problem, self.likelihood, q, self.starts + starts, self.prior)


def _descend(at: _Point, damping: float, small: float) -> tuple[_Point | None, float]:
    """Return a better point or None, and the next damping. A step whose slope promises less than `small` ends it.

    After a step that fails, no other is tried whose parameters move more than half as far.
    """
    longest = math.inf
    for _ in range(12):
        normal = normal_of(at.blocks, at.starts, damping)
        A, g = normal.A + np.diag(at.prior), normal.g + at.prior * at.q
        step = bounded_step(at.problem, at.q, A, g, damping)
        if not np.all(np.isfinite(step)) or normal.fall - float(g @ step) < small:
            return None, damping
        length = float(np.linalg.norm(np.sqrt(np.maximum(np.diag(A), 0.0)) * step))
        if length > longest:
            damping *= 10
            continue
        tried = at.move(step, normal.starts(step))
        if np.isfinite(tried.cost) and tried.cost < at.cost:
            return tried, max(damping / 10, 1e-10) if longest == math.inf else damping
        damping, longest = 10 * damping, length / 2
    return None, damping


def bounded_step(problem: Simulator, q: Floats, A: Floats, g: Floats, damping: float) -> Floats:
    """Return the step from q (p,). The parameters that it would take beyond a bound go to their bounds, and the step of
    the others goes with theirs (Bertsekas 1982)."""
    fixed, step = np.zeros(q.size, bool), find_step(A, g, damping)
    for _ in range(q.size):
        inside = problem.clip_to_bounds(q + step) - q
        beyond = ~fixed & (np.abs(inside - step) > 1e-12 * np.abs(step))
        if not np.any(beyond):
            break
        fixed |= beyond
        ends, free = np.where(fixed, inside, 0.0), ~fixed
        step = np.where(fixed, ends, find_step(A * np.outer(free, free), (g + A @ ends) * free, damping))
    return step


def find_step(A: Floats, g: Floats, damping: float) -> Floats:
    """Return the step of Marquardt. Parameters without information do not move."""
    size = np.sqrt(np.maximum(np.diag(A), 0.0))
    size = np.where(size > 0, size, 1.0)
    scaled = A / np.outer(size, size) + np.diag(np.where(np.diag(A) > 0, damping + 1e-14, 1.0))
    try:
        return np.asarray(-np.linalg.solve(scaled, g / size) / size)
    except np.linalg.LinAlgError:
        return np.zeros_like(g)


def inverse(A: Floats) -> Floats:
    """Return the inverse of an information matrix, with a large variance where it has no information.

    Raises NotIdentifiableError for a matrix of a motion beyond the range of numbers.
    """
    scaled, size = scale_matrix(A)
    if not np.all(np.isfinite(scaled)):
        raise NotIdentifiableError(f"the motion of the model exceeds the range of numbers; {MOVE}")
    values, vectors = np.linalg.eigh(scaled)
    scaled = (vectors / np.maximum(values, 1e-12)) @ vectors.T
    return np.asarray(scaled / np.outer(size, size))


def root_of_rows(rows: Floats) -> Floats:
    """Return a matrix R (p, p) with R R' = (rows' rows)^-1 for at least p rows (n, p), by orthogonal transformations
    (Golub 1965).

    No product of the rows squares their condition, as in `inverse`. A combination of parameters of which the rows say
    nothing has the variance that the rounding of numbers leaves.
    """
    size = np.maximum(np.linalg.norm(rows, axis=0), 1e-100)
    values, vectors = np.linalg.svd(np.linalg.qr(rows / size, mode="r"))[1:]
    return np.asarray(vectors.T / np.maximum(values, np.finfo(float).eps) / size[:, None])


def covariance_of(normal: Normal, prior: Floats) -> Floats:
    """Return the covariance (p, p) of the parameters by the weighted blocks of normal equations, start states
    eliminated, and by a prior with precisions (p,)."""
    rows = [np.diag(np.sqrt(prior))]
    for block in normal.blocks:
        weak = np.diag(np.sqrt(START[: block.K.shape[1]]))
        Q = np.linalg.qr(np.vstack([block.K, weak]))[0]
        J = np.vstack([block.J, np.zeros((len(weak), prior.size))])
        rows.append(J - Q @ (Q.T @ J))
    root = root_of_rows(np.vstack(rows))
    return np.asarray(root @ root.T)


def root_of(covariance: Floats) -> Floats:
    """Return a matrix R (p, p) with R R' = covariance, up to 1e-9 of each variance."""
    scaled, size = scale_matrix(covariance)
    values, vectors = np.linalg.eigh(scaled)
    return np.asarray(size[:, None] * vectors * np.sqrt(np.maximum(values, 1e-9)))


def scale_matrix(A: Floats) -> tuple[Floats, Floats]:
    """Return a matrix with a unit diagonal, and the roots of the diagonal."""
    size = np.sqrt(np.maximum(np.diag(A), 1e-200))
    return A / np.outer(size, size), size


def random_step(A: Floats, rng: np.random.Generator) -> Floats:
    """Return a random step (p,) with the covariance that belongs to an information A (p, p). Directions without
    information have a bound."""
    scaled, size = scale_matrix(A)
    values, vectors = np.linalg.eigh(scaled)
    return np.asarray(vectors @ (rng.standard_normal(size.size) / np.sqrt(np.maximum(values, 1e-6))) / size)

"""Motions within every count, by linear programs: the shortest way to one, and the room that the counts leave."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from pmfid.fit.likelihood import ROUNDING
from pmfid.fit.problem import ResidualBlock
from pmfid.fit.solve import START, Simulator, inverse, root_of
from pmfid.fit.tuning import WITHIN_TUNING
from pmfid.types import Flags, Floats


class CountedRows(Protocol):
    """The rows of a stretch: which of them are counts, and their variances [counts^2]."""

    @property
    def counted(self) -> Flags: ...
    @property
    def variance(self) -> Floats: ...


class CountedSimulator(Simulator, Protocol):
    """A simulator of a record with counts."""

    @property
    def stretches(self) -> Sequence[CountedRows]: ...


def reach_counts(
    problem: CountedSimulator, q: Floats, starts: Floats, precision: Floats, beyond: float
) -> tuple[Floats, Floats] | None:
    """Return parameters (p,) and start states (m, s) near the given ones whose motion is at most `beyond` [counts]
    outside of each count, or None. Observations that are no counts bound no motion. The prior of parameters and start
    states has precisions (p + m s,).

    Each round solves a linear program: the step of least sum of absolute values, in standard errors of least squares,
    after which the linearised motion is within every count, or nearest to that. Stops, starts and contacts bend the
    true motion, so that steps have a bound. The bound grows where the linear motion holds, and shrinks elsewhere
    (Madsen 1975).
    """
    counted = np.concatenate([one.counted for one in problem.stretches])
    if not np.any(counted):
        return None
    size = np.sqrt(ROUNDING / np.concatenate([one.variance for one in problem.stretches]))[:, None]
    (e, J), longest, root = stack(problem.linearise(q, starts)), WITHIN_TUNING.longest, None
    for _ in range(WITHIN_TUNING.rounds):
        outside = float(np.max(np.abs(e[counted]))) - 0.5
        if outside <= beyond:
            return q, starts
        if root is None:
            rows = information_rows(J * size, precision)
            root = root_of(inverse(rows.T @ rows))
        step, promised = _shortest_step(e[counted], J[counted], root, longest)
        next_q = problem.clip_to_bounds(q + step[: q.size])
        next_starts = starts + step[q.size :].reshape(starts.shape)
        next_e, next_J = stack(problem.linearise(next_q, next_starts))
        gain = (outside + 0.5 - float(np.max(np.abs(next_e[counted])))) / max(promised, 1e-12)
        if gain > 0.75:
            longest = min(2 * longest, WITHIN_TUNING.longest)
        elif not gain > 0.25:
            longest /= 4
        if gain > 0:
            q, starts, e, J, root = next_q, next_starts, next_e, next_J, None
    return None


def _shortest_step(e: Floats, J: Floats, root: Floats, longest: float) -> tuple[Floats, float]:
    """Return the step (p,) for residuals e (n,) and their derivatives J (n, p), zero if the program fails, and how far
    it takes the worst residual in. The columns of `root` (p, p) are steps of a standard error, at most `longest`."""
    from scipy.optimize import linprog

    rows = J @ root
    near = np.abs(e) + longest * np.sum(np.abs(rows), axis=1) > 0.5 - WITHIN_TUNING.margin
    rows, e, p = rows[near] * np.sign(e[near])[:, None], np.abs(e[near]), J.shape[1]
    sides = np.column_stack([rows, -rows, -np.ones(e.size)])
    bounds = [(0.0, longest)] * (2 * p) + [(0.0, None)]
    program = linprog(
        np.append(np.ones(2 * p), WITHIN_TUNING.penalty),
        sides,
        0.5 - WITHIN_TUNING.margin - e,
        bounds=bounds,
        method="highs",
    )
    if program.x is None:
        return np.zeros(p), 0.0
    step = program.x[:p] - program.x[p : 2 * p]
    return np.asarray(root @ step), float(np.max(e) - np.max(e + rows @ step))


def find_depth(e: Floats, J: Floats) -> float:
    """Return the depth [counts] of the region that all bounds of residuals e (n,) leave: the largest distance from all
    bounds at once, negative if no step is inside. J (n, p) are derivatives by steps of unit size.

    Rounding alone leaves residuals that are uniform between their bounds. The depth d then has n chances to be small,
    and 2 n d has about a gamma distribution of order p. Noise makes the region shallower.
    """
    from scipy.optimize import linprog

    near = np.abs(e) + WITHIN_TUNING.longest * np.sqrt(np.sum(J**2, axis=1)) > 0.5 - e.size**-0.5
    e, J, ones = e[near], J[near], np.ones(np.count_nonzero(near))
    sides, room = np.vstack([np.column_stack([J, ones]), np.column_stack([-J, ones])]), np.append(0.5 - e, 0.5 + e)
    bounds = [(-WITHIN_TUNING.longest, WITHIN_TUNING.longest)] * J.shape[1] + [(None, 0.5)]
    program = linprog(np.append(np.zeros(J.shape[1]), -1.0), sides, room, bounds=bounds, method="highs")
    return -np.inf if program.x is None else float(program.x[-1])


def usual_depth(J: Floats) -> float:
    """Return the mean depth [counts] of the region that rounding alone leaves, for derivatives J (n, p)."""
    return float(J.shape[1] / (2 * len(J)))


def start_precision(starts: Floats) -> Floats:
    """Return the precisions (m s,) of the start states (m, s). A second mass whose start no count shows stays within a
    count of it, because its motion is far from linear."""
    weak = START[: starts.shape[1]]
    return np.tile(np.maximum(weak, 1.0) if weak.size > 2 else weak, len(starts))


def information_rows(J: Floats, precision: Floats) -> Floats:
    """Return rows whose products with themselves are the information of least squares, for derivatives J (n, p) of
    counts and a prior with precisions (p,)."""
    return np.vstack([J / np.sqrt(ROUNDING), np.diag(np.sqrt(precision))])


def stack(blocks: Sequence[ResidualBlock]) -> tuple[Floats, Floats]:
    """Return the residuals (n,) of all blocks, and their derivatives (n, p + s m) by parameters and m start states."""
    from scipy.linalg import block_diag

    J = np.concatenate([block.J for block in blocks])
    return np.concatenate([block.e for block in blocks]), np.column_stack([J, block_diag(*[b.K for b in blocks])])

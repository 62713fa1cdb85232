"""Parameters with the least range of distances between motion and counts: the middle of the set that fits them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import linprog

from pmfid.types import Floats

__all__ = ["Distances", "least_range", "middle_of", "widest"]

#: q (p,) -> for each run the simulated less the measured position, in counts, (N,).
Distances = Callable[[Floats], list[Floats]]

#: Steps towards the middle, and the part of it by which the last one still narrows the range.
STEPS, SETTLED = 20, 1e-4


def middle_of(distances: Distances, q: Floats, steps: Floats, lower: Floats) -> Floats:
    """Parameters (p,) at which the widest range of distances is the least, by linear programs.

    The neighbourhood shrinks if the last program promised too much.
    """
    now, reach = widest(distances(q)), 8.0
    for _ in range(STEPS):
        trial = least_range(distances, q, steps, lower, reach)
        new = widest(distances(trial))
        if new < now:
            gain, q, now = now - new, trial, new
            if gain < SETTLED * now:
                break
        else:
            reach /= 4.0
            if reach < 1e-4:
                break
    return q


def widest(errors: Sequence[Floats]) -> float:
    return max(float(e.max() - e.min()) for e in errors)


def least_range(distances: Distances, q: Floats, steps: Floats, lower: Floats, reach: float) -> Floats:
    """The same for distances that are linear, within `reach` of the steps (p, k): variables z (k,), then lowest and
    highest of each run, then the widest range."""
    p, here = steps.shape[1], distances(q)
    if p == 0:
        return q
    moves = []
    for i in range(p):
        up, down = np.maximum(q + steps[:, i], lower), np.maximum(q - steps[:, i], lower)
        part = np.linalg.norm(up - down) / np.linalg.norm(steps[:, i])
        moves.append([(a - b) / part for a, b in zip(distances(up), distances(down), strict=True)])
    R = len(here)
    rows, right = [], []
    for r, e in enumerate(here):
        A = np.column_stack([move[r] for move in moves])
        for sign, place in ((1.0, p + 2 * r + 1), (-1.0, p + 2 * r)):
            block = np.zeros((e.size, p + 2 * R + 1))
            block[:, :p], block[:, place] = sign * A, -sign
            rows.append(block)
            right.append(-sign * e)
        width = np.zeros((1, p + 2 * R + 1))
        width[0, [p + 2 * r + 1, p + 2 * r, -1]] = 1.0, -1.0, -1.0
        rows.append(width)
        right.append(np.zeros(1))
    cost = np.r_[np.zeros(p + 2 * R), 1.0]
    bounds = [(-reach, reach)] * p + [(None, None)] * (2 * R + 1)
    found = linprog(cost, np.vstack(rows), np.concatenate(right), bounds=bounds, method="highs")
    return q if found.x is None else np.asarray(np.maximum(q + steps @ found.x[:p], lower))

"""Bounded response of an unstable process: what decays runs forward in time, what grows runs backward.

With unknown initial conditions it does not matter which end of a stretch they are counted from: all solutions of
A y = B u are the bounded one plus the free responses. From the start, responses of an unstable pole would exceed every
number; from the end they decay into the past. The residual after the fit of the free responses belongs to the predictor
with mirrored poles (Forssell and Ljung 2000), a Kalman filter without process noise and with an unknown start.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import schur, solve_sylvester

from pmfid.transfer.propagate import Grid, product, respond
from pmfid.types import Floats


def respond_bounded(F: Floats, g: Floats, grid: Grid, w: Floats, start: Floats, *, held: bool) -> Floats:
    """As `respond`, but modes that grow by more than e over the grid run backward, and have their part of `start` at
    the last instant."""
    n, limit = F.shape[0], 1 / max(grid.duration, 1e-300)
    T, Q, kept = schur(F - limit * np.eye(n), sort="lhp")
    if kept == n:
        return respond(F, g, grid, w, start, held=held)
    T = T + limit * np.eye(n)
    X = solve_sylvester(T[:kept, :kept], -T[kept:, kept:], -T[:kept, kept:]) if kept else np.zeros((0, n))
    apart, back = np.eye(n), np.eye(n)
    apart[:kept, kept:], back[:kept, kept:] = X, -X
    g, start = back @ Q.T @ g, back @ Q.T @ start
    parts = []
    if kept:
        parts.append(respond(T[:kept, :kept], g[:kept], grid, w, start[:kept], held=held))
    late = respond(-T[kept:, kept:], -g[kept:], grid.reversed, _reverse_time(w, held), start[kept:], held=held)
    modes = np.concatenate([*parts, late[..., ::-1]])
    return product(Q @ apart, modes.reshape(n, -1)).reshape(modes.shape)


def _reverse_time(w: Floats, held: bool) -> Floats:
    """w (channels, N) for time that runs backward: a held value belongs to the step before it then."""
    return np.concatenate([w[:, -2::-1], w[:, :1]], axis=1) if held else w[:, ::-1]

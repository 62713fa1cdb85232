"""A dead time of any length: states and inputs of a process some time before the instants of a grid, exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmfid.transfer.propagate import Grid, product, transition
from pmfid.types import Floats

#: A dead time that ends so close before an instant, in parts of the step, ends there.
SAME = 1e-9


@dataclass(frozen=True)
class Late:
    """states (n, channels, N), inputs (channels, N), their slopes, the dead time before each instant; zero where that
    is before the first one."""

    states: Floats
    inputs: Floats
    slopes: Floats


def delay_states(F: Floats, g: Floats, grid: Grid, w: Floats, states: Floats, dead_time: float, *, held: bool) -> Late:
    """From states (n, channels, N) of x' = F x + g w at the instants of the grid and w (channels, N), held or linear.

    Each reading starts at the last instant before it, so a switch of the input inside a sample has its exact effect."""
    t = grid.instants
    steps = np.broadcast_to(np.asarray(grid.steps, float), (grid.size - 1,))
    index, rest = _places(grid, t, steps, dead_time)
    known = index >= 0
    index = np.maximum(index, 0)
    ahead = np.minimum(index, grid.size - 2)
    slope = np.zeros(w[:, index].shape) if held else (np.diff(w) / steps)[:, ahead]
    found, inputs = states[..., index], w[:, index] + slope * rest
    if np.any(rest):
        found = _advance_states(F, g, grid, found, w[:, index], slope, rest)
    return Late(found * known, inputs * known, slope * known)


def _places(grid: Grid, t: Floats, steps: Floats, dead_time: float) -> tuple[NDArray[np.int64], Floats]:
    """(N,) the last instant at or before each reading, negative where there is none, and the time from there to it."""
    if isinstance(grid.steps, float):
        whole = int(np.ceil(dead_time / grid.steps - SAME))
        rest = max(0.0, whole * grid.steps - dead_time)
        return np.arange(grid.size) - whole, np.full(grid.size, rest if rest > SAME * grid.steps else 0.0)
    wanted, close = t - dead_time, SAME * float(np.median(steps))
    index = np.searchsorted(t, wanted + close, side="right") - 1
    return index, np.maximum(0.0, wanted - t[np.maximum(index, 0)]) * (index >= 0)


def _advance_states(F: Floats, g: Floats, grid: Grid, x: Floats, w: Floats, slope: Floats, rest: Floats) -> Floats:
    """x (n, channels, N) by the times `rest` (N,) further on."""
    if grid.uniform:
        step = transition(F, g, Grid(float(rest[0]), 2))
        moved = product(step.phi, x.reshape(F.shape[0], -1)).reshape(x.shape)
        return np.asarray(moved + step.now[:, None, None] * w + step.change[:, None, None] * slope * rest)
    step = transition(F, g, Grid(rest, rest.size + 1))
    moved = np.einsum("kij,jck->ick", step.phi, x)
    return np.asarray(moved + step.now.T[:, None] * w + step.change.T[:, None] * slope * rest)

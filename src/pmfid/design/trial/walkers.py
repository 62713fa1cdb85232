"""Samples of a density, by walkers that stretch towards each other: linear changes of coordinates change nothing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pmfid.types import Floats

__all__ = ["Density", "inside", "walk"]

#: z (..., p) -> log density (...), -inf outside.
Density = Callable[[Floats], Floats]

#: Largest stretch (Goodman and Weare 2010).
LONGEST = 2.0
#: How often a start outside may be moved half the way to the middle.
HALVINGS = 60


def inside(density: Density, middle: Floats, scatter: Floats) -> Floats:
    """Starts (..., walkers, p): middle + scatter, each moved towards the middle (p,) until the density is not 0 there.

    scatter: (..., walkers, p).
    """
    z = middle + scatter
    for _ in range(HALVINGS):
        outside = ~np.isfinite(density(z))
        if not outside.any():
            break
        z = np.where(outside[..., None], middle + (z - middle) / 2.0, z)
    return z


def walk(density: Density, z: Floats, steps: int, rng: np.random.Generator) -> Floats:
    """Where the walkers z (..., walkers, p) are after each step, (steps, ..., walkers, p); even number of walkers.

    The two halves move in turn, each walker along the line to one of the other half.
    """
    half, size = z.shape[-2] // 2, z.shape[-1]
    halves = [z[..., :half, :].copy(), z[..., half:, :].copy()]
    logs = [density(part) for part in halves]
    path = np.empty((steps, *z.shape))
    for step in range(steps):
        for this in range(2):
            here, other = halves[this], halves[1 - this]
            partner = np.take_along_axis(other, rng.integers(half, size=here.shape[:-1])[..., None], axis=-2)
            stretch = (1.0 + (LONGEST - 1.0) * rng.random(here.shape[:-1])) ** 2 / LONGEST
            trial = partner + stretch[..., None] * (here - partner)
            log = density(trial)
            with np.errstate(invalid="ignore"):  # both outside: stays
                better = np.log(rng.random(stretch.shape)) < (size - 1) * np.log(stretch) + log - logs[this]
            halves[this] = np.where(better[..., None], trial, here)
            logs[this] = np.where(better, log, logs[this])
        path[step] = np.concatenate(halves, axis=-2)
    return path

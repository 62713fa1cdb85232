"""Ridges of parameters that fit all counts, and that a quadratic map of the motion does not show.

A motion is smooth in its parameters until the axis comes to rest on the way. From there on less of the motion separates
the parameters. The parameters that fit all counts then form a narrow, bent ridge, far beyond the map around the middle.
Such a ridge is followed with simulated motions: a step along the ridge, then back to its middle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pmfid.design.trial.least_range import Distances, least_range, widest
from pmfid.types import Floats

__all__ = ["Allowed", "spread_along_ridges"]

#: Distance from the middle along an axis [standard deviations] that is still possible if the ridge goes on.
BEYOND = 4.0
#: Each step along a ridge is longer than the last by this factor, or half as long if the last one left the ridge;
LONGER, MOST_STEPS = 1.5, 60
#: longest way back to the middle of the ridge [standard deviations];
BACK = 30.0
#: steps shorter than this part of the first end it.
SHORTEST = 1 / 8


@dataclass(frozen=True, eq=False)
class Allowed:
    """What is possible, and how much: room within counts of width 2 half [counts] for the distances of q (p,), at
    least `lower` (p,), times the prior with the root (p, p) of its information, centred on 1."""

    distances: Distances
    half: float
    lower: Floats
    root: Floats

    def room(self, q: Floats) -> float:
        """By how much the motion at q may be moved within its counts [counts], 0 if it may not."""
        return max(2.0 * self.half - widest(self.distances(q)), 0.0) if np.all(q >= self.lower) else 0.0

    def doubt(self, q: Floats) -> float:
        """Minus the logarithm of the prior."""
        return 0.5 * float(np.sum((self.root @ (q - 1.0)) ** 2))


def spread_along_ridges(allowed: Allowed, samples: Floats, middle: Floats, rng: np.random.Generator) -> Floats:
    """Spreads samples (n, p) along the ridges that go on beyond them; without such a ridge returns the samples.

    middle (p,): of the samples, possible.
    """
    size, axes = np.linalg.eigh(np.atleast_2d(np.cov(samples.T)))
    steps, spread = axes * np.sqrt(np.maximum(size, 0.0)), samples
    for k, axis in enumerate(axes.T):
        ends = [_follow_ridge(allowed, middle, steps, k, sign) for sign in (-1.0, 1.0)]
        if any(len(end) for end in ends):
            chain = np.array([*ends[0][::-1], middle, *ends[1]])
            along, drawn = (spread - middle) @ axis, _draw_places(allowed, chain, len(samples), rng) - middle
            if np.std(drawn @ axis) > np.std(along):
                spread = spread - np.outer(along, axis) + drawn
    return spread


def _follow_ridge(allowed: Allowed, middle: Floats, steps: Floats, k: int, sign: float) -> list[Floats]:
    """Places (p,) on the ridge along column k of steps (p, p), from the middle outwards; empty if the ridge ends within
    the samples."""
    others, doubt = np.delete(steps, k, axis=1), allowed.doubt(middle) + BEYOND**2 / 2.0
    first = sign * BEYOND * steps[:, k]
    place, step, found = middle, first, []
    for _ in range(MOST_STEPS):
        ahead = np.maximum(place + step, allowed.lower)
        trial = least_range(allowed.distances, ahead, others, allowed.lower, BACK)
        if allowed.room(trial) > 0.0 and allowed.doubt(trial) < doubt:
            place, step = trial, LONGER * (trial - place)
            found.append(trial)
        elif not found or np.linalg.norm(step) < SHORTEST * np.linalg.norm(first):
            break
        else:
            step = step / 2.0
    return found


def _draw_places(allowed: Allowed, chain: Floats, count: int, rng: np.random.Generator) -> Floats:
    """Places (count, p) on a chain (m, p), by the prior and the room that is left there: the density at the ridge's
    middle times the volume across it, which falls with each of the other directions."""
    room, doubt = (np.array([of(q) for q in chain]) for of in (allowed.room, allowed.doubt))
    way = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(chain, axis=0), axis=1))]
    fine = np.linspace(0.0, way[-1], 50 * len(chain))
    weight = np.interp(fine, way, room) ** chain.shape[1] * np.exp(doubt.min() - np.interp(fine, way, doubt))
    at = rng.choice(fine, size=count, p=weight / weight.sum())
    return np.column_stack([np.interp(at, way, column) for column in chain.T])

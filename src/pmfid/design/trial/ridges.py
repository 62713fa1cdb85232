"""What counts leave open where a map of the motion does not see it: ridges that go on, and bend.

A motion is smooth in its parameters until the axis comes to rest on the way: from there on less of it tells the
parameters apart, and what passes through all counts goes on, narrow and bent, far beyond what a map around the middle
shows. Such a ridge is followed on the motions themselves, step by step along it and back to its middle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pmfid.design.trial.least_range import Distances, least_range, widest
from pmfid.types import Floats

__all__ = ["Allowed", "along_ridges"]

#: A ridge goes on where a place so many deviations from the middle along an axis is still possible.
BEYOND = 4.0
#: Each step along it is longer than the last by this factor, or half as long where the last one left it;
LONGER, MOST_STEPS = 1.5, 60
#: the way back to its middle may be so many deviations long;
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
        """By how much the motion at q may be moved within its counts [counts], 0 where it may not."""
        return max(2.0 * self.half - widest(self.distances(q)), 0.0) if np.all(q >= self.lower) else 0.0

    def doubt(self, q: Floats) -> float:
        """Minus the logarithm of the prior."""
        return 0.5 * float(np.sum((self.root @ (q - 1.0)) ** 2))


def along_ridges(allowed: Allowed, samples: Floats, middle: Floats, rng: np.random.Generator) -> Floats:
    """Samples (n, p) of what is left open, spread along the ridges that go on beyond them; as they are where none does.

    middle (p,): of the samples, possible.
    """
    size, axes = np.linalg.eigh(np.atleast_2d(np.cov(samples.T)))
    steps, spread = axes * np.sqrt(np.maximum(size, 0.0)), samples
    for k, axis in enumerate(axes.T):
        ends = [_followed(allowed, middle, steps, k, sign) for sign in (-1.0, 1.0)]
        if any(len(end) for end in ends):
            chain = np.array([*ends[0][::-1], middle, *ends[1]])
            along, drawn = (spread - middle) @ axis, _drawn(allowed, chain, len(samples), rng) - middle
            if np.std(drawn @ axis) > np.std(along):
                spread = spread - np.outer(along, axis) + drawn
    return spread


def _followed(allowed: Allowed, middle: Floats, steps: Floats, k: int, sign: float) -> list[Floats]:
    """Places (p,) on the ridge along column k of steps (p, p), from the middle outwards; none where it ends within the
    samples."""
    beside, doubt = np.delete(steps, k, axis=1), allowed.doubt(middle) + BEYOND**2 / 2.0
    first = sign * BEYOND * steps[:, k]
    place, step, found = middle, first, []
    for _ in range(MOST_STEPS):
        ahead = np.maximum(place + step, allowed.lower)
        trial = least_range(allowed.distances, ahead, beside, allowed.lower, BACK)
        if allowed.room(trial) > 0.0 and allowed.doubt(trial) < doubt:
            place, step = trial, LONGER * (trial - place)
            found.append(trial)
        elif not found or np.linalg.norm(step) < SHORTEST * np.linalg.norm(first):
            break
        else:
            step = step / 2.0
    return found


def _drawn(allowed: Allowed, chain: Floats, count: int, rng: np.random.Generator) -> Floats:
    """Places (count, p) on a chain (m, p), by the prior and the room that is left there: the density at the ridge's
    middle times the volume across it, which falls with each of the other directions."""
    room, doubt = (np.array([of(q) for q in chain]) for of in (allowed.room, allowed.doubt))
    way = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(chain, axis=0), axis=1))]
    fine = np.linspace(0.0, way[-1], 50 * len(chain))
    weight = np.interp(fine, way, room) ** chain.shape[1] * np.exp(doubt.min() - np.interp(fine, way, doubt))
    at = rng.choice(fine, size=count, p=weight / weight.sum())
    return np.column_stack([np.interp(at, way, column) for column in chain.T])

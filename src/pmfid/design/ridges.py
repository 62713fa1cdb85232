"""What counts leave open where a map of the motion does not see it: ridges that go on, and bend.

A motion is smooth in its parameters until the axis comes to rest on the way: from there on less of it tells the
parameters apart, and what passes through all counts goes on, narrow and bent, far beyond what a map around the middle
shows. Such a ridge is followed on the motions themselves, step by step along it and back to its middle.
"""

from __future__ import annotations

import numpy as np

from pmfid.design.least_range import Distances, least_range, widest
from pmfid.design.problem import Float

__all__ = ["along_ridges"]

#: A ridge goes on where a place so many deviations from the middle along an axis is still possible.
BEYOND = 4.0
#: Each step along it is longer than the last by this factor, or half as long where the last one left it;
LONGER, MOST_STEPS = 1.5, 60
#: the way back to its middle may be so many deviations long;
BACK = 30.0
#: steps shorter than this part of the first end it.
SHORTEST = 1 / 8


def along_ridges(
    distances: Distances, samples: Float, middle: Float, half: float, lower: Float, rng: np.random.Generator
) -> Float:
    """Samples (n, p) of what is left open, spread along the ridges that go on beyond them; as they are where none does.

    middle (p,): of the samples, inside; half: width of a count over 2 [counts]; lower (p,): least values.
    """
    size, axes = np.linalg.eigh(np.atleast_2d(np.cov(samples.T)))
    steps, spread = axes * np.sqrt(np.maximum(size, 0.0)), samples
    for k, axis in enumerate(axes.T):
        ends = [_followed(distances, middle, steps, k, sign, half, lower) for sign in (-1.0, 1.0)]
        if any(len(end) for end in ends):
            chain = np.array([*ends[0][::-1], middle, *ends[1]])
            along, drawn = (spread - middle) @ axis, _drawn(distances, chain, half, len(samples), rng) - middle
            if np.std(drawn @ axis) > np.std(along):
                spread = spread - np.outer(along, axis) + drawn
    return spread


def _followed(
    distances: Distances, middle: Float, steps: Float, k: int, sign: float, half: float, lower: Float
) -> list[Float]:
    """Places (p,) on the ridge along column k of steps (p, p), from the middle outwards; none where it ends within the
    samples."""
    beside = np.delete(steps, k, axis=1)
    first = sign * BEYOND * steps[:, k]
    place, step, found = middle, first, []
    for _ in range(MOST_STEPS):
        trial = least_range(distances, place + step, beside, lower, BACK)
        if np.all(trial >= lower) and widest(distances(trial)) < 2.0 * half:
            place, step = trial, LONGER * (trial - place)
            found.append(trial)
        elif not found or np.linalg.norm(step) < SHORTEST * np.linalg.norm(first):
            break
        else:
            step = step / 2.0
    return found


def _drawn(distances: Distances, chain: Float, half: float, count: int, rng: np.random.Generator) -> Float:
    """Places (count, p) on a chain (m, p), by the room that is left there: the density at the ridge's middle times the
    volume across it, which falls with each of the other directions."""
    room = np.array([max(2.0 * half - widest(distances(q)), 0.0) for q in chain])
    way = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(chain, axis=0), axis=1))]
    fine = np.linspace(0.0, way[-1], 50 * len(chain))
    weight = np.interp(fine, way, room) ** chain.shape[1]
    at = rng.choice(fine, size=count, p=weight / weight.sum())
    return np.column_stack([np.interp(at, way, column) for column in chain.T])

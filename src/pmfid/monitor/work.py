"""Units of work: what a machine that its model does not describe lets expect of normal work.

Friction beyond the model's errs in every part of a move in another way, and rarely by much: single blocks of such a
machine are neither independent nor near normal, and no hour of them says what one does once in a day. So blocks are
summed until they tell as much as several moves do: what the model lacks repeats itself in each, and has a mean, which
is taken off. A unit that deviates by more than nearly all others counts for less, as in robust tests (Huber 1965):
then it takes several that agree to raise an alarm, and of how units come together an hour has enough.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pmfid._stage import centred, weights
from pmfid.monitor.scores import Blocks, Scale, make_scale
from pmfid.types import Floats

#: Information of a unit [average blocks]: the first in which units hardly go with their neighbours.
SIZES = (16.0, 32.0, 64.0)
ALIKE = 0.3
#: Units that a scale is made of; where there are fewer, smaller units would not help.
LEAST_UNITS = 100
#: Part of the units of normal work that deviate within the limit.
WITHIN = 0.97
#: Passes in which limit and mean are found.
PASSES = 5


@dataclass(frozen=True)
class Work:
    """What normal work is like, in units. size: information of a unit [average blocks]; offset: (p,) by which the
    parameters seem to be off all the time, as the model lacks something [unit of theta]; scale: of units; limit: (p,)
    deviations, in its standard deviations, beyond which a unit counts for less."""

    size: float
    offset: Floats
    scale: Scale
    limit: Floats

    def units(self, blocks: Blocks, information: Floats) -> Blocks:
        """Whole units of blocks with (n,) information, in average blocks."""
        return self.weighed(self.centred(summed(blocks, information, self.size)))

    def centred(self, blocks: Blocks) -> Blocks:
        """Blocks, or sums of them, without what is off all the time."""
        return replace(blocks, score=centred(blocks.score, blocks.cross, self.offset))

    def weighed(self, units: Blocks) -> Blocks:
        """Centred units, each as far as it counts."""
        weight = weights(self.scale.standardise(units)[0], self.limit)
        return Blocks(
            units.score * weight[:, None], units.cross * weight[:, None, None], units.square * weight[:, None, None]
        )


def summed(blocks: Blocks, information: Floats, size: float) -> Blocks:
    """Sums of the blocks, each of which has gathered `size` of the (n,) information."""
    ends, told = [0], 0.0
    for k, part in enumerate(information.tolist()):
        told += part
        if told >= size:
            ends.append(k + 1)
            told = 0.0
    begins = np.array(ends[:-1], int)
    if not begins.size:
        return blocks[:0]
    used = blocks[: ends[-1]]
    return Blocks(*(np.add.reduceat(part, begins, axis=0) for part in (used.score, used.cross, used.square)))


def learn(blocks: Blocks, information: Floats) -> Work:
    """From the blocks of normal work and their (n,) information, in average blocks."""
    found = _learned(units := summed(blocks, information, SIZES[0]), SIZES[0])
    for size in SIZES[1:]:
        larger = summed(blocks, information, size)
        if _alike(found.scale.standardise(found.weighed(found.centred(units)))[0]) <= ALIKE:
            return found
        if len(larger.score) < LEAST_UNITS:
            return found
        units, found = larger, _learned(larger, size)
    return found


def _alike(x: Floats) -> float:
    """The largest correlation of x (n, p) with the next one."""
    return float(np.max(np.abs((x[1:] * x[:-1]).mean(axis=0) / (x**2).mean(axis=0))))


def _learned(units: Blocks, size: float) -> Work:
    p = units.score.shape[1]
    found = Work(size, np.zeros(p), make_scale(units), np.full(p, np.inf))
    for _ in range(PASSES):
        counted = found.weighed(found.centred(units))
        step = np.linalg.solve(counted.cross.sum(axis=0), counted.score.sum(axis=0))
        found = replace(found, offset=found.offset + step)
        scale = make_scale(found.weighed(found.centred(units)))
        x, _ = scale.standardise(found.centred(units))
        found = replace(found, scale=scale, limit=np.quantile(np.abs(x), WITHIN, axis=0))
    x, w = found.scale.standardise(found.weighed(found.centred(units)))
    sigma = np.sqrt((x**2).mean(axis=0))
    scale = replace(found.scale, sigma=found.scale.sigma * sigma, energy=found.scale.energy * w.mean(axis=0))
    return replace(found, scale=scale, limit=found.limit / sigma)

"""Units of work: normal work of a machine with unmodelled effects.

Unmodelled friction deviates differently in each part of a move, and rarely by much. Single blocks of such a machine are
neither independent nor nearly normal, and an hour of blocks does not show the deviation that occurs once a day. So
blocks are summed until the sum has the information of several moves. Unmodelled effects repeat in each unit; their mean
is subtracted. A unit that deviates by more than nearly all others counts for less, as in robust tests (Huber 1965).
Then an alarm takes several units that agree, and an hour holds enough sequences of units.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pmfid._stage import centred, weights
from pmfid.monitor.scores import Blocks, Scale, make_scale
from pmfid.types import Floats

#: Information of a unit [average blocks]; the first size at which neighbouring units correlate by less than ALIKE.
SIZES = (16.0, 32.0, 64.0)
ALIKE = 0.3
#: Least units for a scale.
LEAST_UNITS = 100
#: Part of the units of normal work that deviate within the limit.
WITHIN = 0.97
#: Passes in which limit and mean are found.
PASSES = 5


@dataclass(frozen=True)
class NormalWork:
    """Normal work in units. size: information of a unit [average blocks]; offset: (p,) constant deviation of the
    parameters by unmodelled effects [unit of theta]; scale: of units; limit: (p,) deviations, in standard deviations of
    the scale, beyond which a unit counts for less."""

    size: float
    offset: Floats
    scale: Scale
    limit: Floats

    def units(self, blocks: Blocks, information: Floats) -> Blocks:
        """Whole units of blocks with (n,) information, in average blocks."""
        return self.weigh(self.centre(sum_blocks(blocks, information, self.size)))

    def centre(self, blocks: Blocks) -> Blocks:
        """Blocks, or sums of blocks, without the constant deviation."""
        return replace(blocks, score=centred(blocks.score, blocks.cross, self.offset))

    def weigh(self, units: Blocks) -> Blocks:
        """Centred units, each with its weight."""
        weight = weights(self.scale.standardise(units)[0], self.limit)
        return Blocks(
            units.score * weight[:, None], units.cross * weight[:, None, None], units.square * weight[:, None, None]
        )


def sum_blocks(blocks: Blocks, information: Floats, size: float) -> Blocks:
    """Sums of blocks; each sum has at least `size` of the (n,) information."""
    ends, gathered = [0], 0.0
    for k, part in enumerate(information.tolist()):
        gathered += part
        if gathered >= size:
            ends.append(k + 1)
            gathered = 0.0
    begins = np.array(ends[:-1], int)
    if not begins.size:
        return blocks[:0]
    used = blocks[: ends[-1]]
    return Blocks(*(np.add.reduceat(part, begins, axis=0) for part in (used.score, used.cross, used.square)))


def learn(blocks: Blocks, information: Floats) -> NormalWork:
    """From the blocks of normal work and their (n,) information, in average blocks."""
    found = _learn_units(units := sum_blocks(blocks, information, SIZES[0]), SIZES[0])
    for size in SIZES[1:]:
        larger = sum_blocks(blocks, information, size)
        if _alike(found.scale.standardise(found.weigh(found.centre(units)))[0]) <= ALIKE:
            return found
        if len(larger.score) < LEAST_UNITS:
            return found
        units, found = larger, _learn_units(larger, size)
    return found


def _alike(x: Floats) -> float:
    """The largest correlation of x (n, p) with the next one."""
    return float(np.max(np.abs((x[1:] * x[:-1]).mean(axis=0) / (x**2).mean(axis=0))))


def _learn_units(units: Blocks, size: float) -> NormalWork:
    p = units.score.shape[1]
    found = NormalWork(size, np.zeros(p), make_scale(units), np.full(p, np.inf))
    for _ in range(PASSES):
        counted = found.weigh(found.centre(units))
        step = np.linalg.solve(counted.cross.sum(axis=0), counted.score.sum(axis=0))
        found = replace(found, offset=found.offset + step)
        scale = make_scale(found.weigh(found.centre(units)))
        x, _ = scale.standardise(found.centre(units))
        found = replace(found, scale=scale, limit=np.quantile(np.abs(x), WITHIN, axis=0))
    x, w = found.scale.standardise(found.weigh(found.centre(units)))
    sigma = np.sqrt((x**2).mean(axis=0))
    scale = replace(found.scale, sigma=found.scale.sigma * sigma, energy=found.scale.energy * w.mean(axis=0))
    return replace(found, scale=scale, limit=found.limit / sigma)

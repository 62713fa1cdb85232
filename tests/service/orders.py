"""Blocks of one axis as sent, and as they arrive: doubled, lost, out of order within a window."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from random import Random

import numpy as np

from pmfid.stream.delivery import Block
from pmfid.stream.order import UNKNOWN_GAP
from pmfid.types import Counts, Floats

DT = 0.01
LONGEST = 40

#: lead, apart, u, counts, time.
Expected = tuple[int, bool, float, int, float]


@dataclass(frozen=True)
class Sending:
    """Blocks of one axis as sent and as they arrive.

    `sent` are the blocks in order without the lost ones, each with its place on the axis of all samples. `arrived` are
    the blocks in order of arrival. `expected` are the samples of the sorted data without duplicates, and `ages` their
    ages of edges, if there are any.
    """

    sent: tuple[tuple[int, Block], ...]
    arrived: tuple[Block, ...]
    expected: tuple[Expected, ...]
    window: int
    ages: tuple[float, ...] = ()

    def shuffled(self, random: Random) -> list[Block]:
        """Return the same blocks in another order within the window."""
        return _shuffled(self.sent, self.window, random)


def _shuffled(sent: Sequence[tuple[int, Block]], window: int, random: Random) -> list[Block]:
    # a block precedes an earlier block only if it ends within the window after the start of the earlier one
    keyed = [(place + random.uniform(0, window - LONGEST), block) for place, block in sent]
    keyed += [(key + random.uniform(0, 5 * window), block) for key, block in keyed if random.random() < 0.3]
    return [block for _, block in sorted(keyed, key=lambda pair: pair[0])]


def made(
    u: Floats,
    counts: Counts,
    random: Random,
    window: int,
    loss: float = 0.15,
    restart: float = 0.05,
    ages: Floats | None = None,
) -> Sending:
    """Cut samples (n,) into blocks, of which some are lost.

    At times the sender restarts: with a gap that its clock shows, or with another clock.
    """
    sent, expected, old = list[tuple[int, Block]](), list[Expected](), list[float]()
    place, first, epoch, time, lead, apart, fresh = 0, random.randrange(50), 0, 100.0, 0, True, True
    while place < counts.size:
        n = min(random.randint(1, LONGEST), counts.size - place)
        here = slice(place, place + n)
        own = None if ages is None else ages[here]
        block = Block("x", epoch, first, time, DT, u[here], counts[here], own)
        if not fresh and random.random() < loss:
            lead += n
        else:
            sent.append((place, block))
            old += [] if own is None else own.tolist()
            rows = zip(u[here].tolist(), counts[here].tolist(), strict=True)
            for k, (a, b) in enumerate(rows):
                expected.append((lead if k == 0 else 0, apart and k == 0 and lead != 0, a, b, time + k * DT))
            lead, apart, fresh = 0, False, False
        place, first, time = place + n, first + n, time + n * DT
        if not fresh and lead == 0 and random.random() < restart:
            missing = random.choice([UNKNOWN_GAP, random.randint(20, 300)])
            epoch, first, fresh, apart, lead = epoch + random.randint(1, 3), random.randrange(9), True, True, missing
            time = random.choice([-50.0, time + 4000.0]) if missing == UNKNOWN_GAP else time + missing * DT
    return Sending(tuple(sent), tuple(_shuffled(sent, window, random)), tuple(expected), window, tuple(old))


def sending_of(seed: int, window: int, samples: int = 600) -> Sending:
    """Return a sending of numbered samples, so that each sample can be recognised."""
    numbers = np.arange(samples)
    u = np.where(numbers % 97 == 5, math.inf, numbers + 0.5)
    return made(u, numbers, Random(seed), window)

"""Makes numbered blocks of the samples of axes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from pmfid.errors import UsageError
from pmfid.stream.blocks import encode, problem_of
from pmfid.stream.delivery import Block
from pmfid.stream.layout import MOST_SAMPLES
from pmfid.types import Counts, Floats

__all__ = ["Numbering"]


@dataclass
class _Axis:
    """Samples that wait for their block. first: number of the first sample; time: of it [s]; u, counts: (n,)."""

    first: int = 0
    time: float = math.nan
    u: Floats = field(default_factory=lambda: np.zeros(0))
    counts: Counts = field(default_factory=lambda: np.zeros(0, np.int64))


@dataclass
class Numbering:
    """Numbers the samples of each axis from 0 on, and makes blocks of them. dt: sample period [s]; epoch: of all
    blocks; samples: of a block. Raises UsageError for a number of samples that no receiver takes."""

    dt: float
    epoch: int
    samples: int
    _axes: dict[str, _Axis] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        if not 1 <= self.samples <= MOST_SAMPLES:
            raise UsageError(f"a block has 1 to {MOST_SAMPLES} samples, got {self.samples}; give another number")

    def add(self, axis: str, u: ArrayLike, counts: ArrayLike, time: float) -> list[bytes]:
        """The blocks that are full with samples u, counts (n,), or one of each, that follow the last ones; time: of the
        first [s], NaN for none. Raises UsageError for what no block takes."""
        u, counts = np.atleast_1d(np.asarray(u, np.float64)), np.atleast_1d(np.asarray(counts, np.int64))
        if u.ndim != 1 or u.shape != counts.shape:
            raise UsageError(f"u and counts are not of one length: {u.shape} and {counts.shape}")
        block = Block(axis, self.epoch, 0, time, self.dt, u, counts)
        if u.size and (problem := problem_of(block, u, counts)) is not None:
            raise UsageError(f"a receiver would refuse these samples: {problem.problem}")
        waiting = self._axes.setdefault(axis, _Axis())
        if not waiting.u.size:
            waiting.time = time
        waiting.u, waiting.counts = np.append(waiting.u, u), np.append(waiting.counts, counts)
        return list(self._blocks(axis, waiting, whole=True))

    def skip(self, axis: str, samples: int) -> list[bytes]:
        """Leaves numbers of an axis out. Returns the block of its waiting samples before them, if there is one."""
        waiting = self._axes.setdefault(axis, _Axis())
        made = list(self._blocks(axis, waiting, whole=False))
        waiting.first += samples
        return made

    def rest(self) -> list[bytes]:
        """Blocks of all that waits."""
        return [block for axis, waiting in self._axes.items() for block in self._blocks(axis, waiting, whole=False)]

    @property
    def waits(self) -> bool:
        """Whether anything does."""
        return any(waiting.u.size for waiting in self._axes.values())

    def _blocks(self, axis: str, waiting: _Axis, whole: bool) -> Iterator[bytes]:
        """Blocks of what waits, but for the last one that is not full (whole)."""
        u, counts, begin = waiting.u, waiting.counts, 0
        while u.size - begin >= (self.samples if whole else 1):
            part = slice(begin, begin + self.samples)
            block = Block(axis, self.epoch, waiting.first, waiting.time, self.dt, u[part], counts[part])
            begin = begin + block.counts.size
            waiting.first += block.counts.size
            waiting.time += block.counts.size * self.dt
            yield encode(block)
        waiting.u, waiting.counts = u[begin:], counts[begin:]

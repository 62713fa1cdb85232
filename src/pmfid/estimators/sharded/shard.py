"""Axes of one configuration in arrays of a fixed size, stepped piece by piece."""

from __future__ import annotations

from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.runner import Runner
from pmfid.estimators.side_by_side import SampleBlock
from pmfid.kernel.saved import fleet_head
from pmfid.kernel.structures import whole_words

if TYPE_CHECKING:
    from pmfid._kernel64 import ManyKernel

__all__ = ["Shard", "ShardGroup", "ShardPiece"]


class ShardGroup:
    """A configuration. runner: that it came with; identity: distinguishes its states from others; start: (bytes,) the
    state in which axes begin where nothing else is said."""

    def __init__(self, runner: Runner[RecursiveEstimator]) -> None:
        self.runner = runner
        self.start = state_of(runner)
        self.identity = identity_of(runner)
        self._idle: SimpleQueue[ManyKernel] = SimpleQueue()
        self.fastest_way = _many(runner).fastest_way

    def borrow(self) -> ManyKernel:
        """A kernel of the configuration, which a thread has for itself until it gives it back."""
        try:
            return self._idle.get_nowait()
        except Empty:
            return _many(self.runner)

    def give_back(self, kernel: ManyKernel) -> None:
        """It is free again."""
        kernel.hold(self.start[None])
        self._idle.put(kernel)


def _many(runner: Runner[RecursiveEstimator]) -> ManyKernel:
    return runner.kernel.many(1, whole_words(runner.precision))


def state_of(runner: Runner[RecursiveEstimator]) -> NDArray[np.uint8]:
    """(bytes,) the present state, packed."""
    return np.array(_many(runner).states[0])


def identity_of(runner: Runner[RecursiveEstimator]) -> bytes:
    """The prefix of a configuration's states: it identifies kernel, layout and configuration."""
    head = fleet_head(_many(runner), runner.precision)
    head["axes"] = 0
    return head.tobytes()[:-4]  # without the checksum


@dataclass(eq=False)
class Shard:
    """Up to `size` axes. number: its own in the fleet; rows: places that have been in use; changed: since the last
    checkpoint; side, sequence: the file that holds it in the last checkpoint, if there is one; synced: the disk is
    known to have that file."""

    group: ShardGroup
    number: int
    size: int
    rows: int = 0
    changed: bool = False
    side: int = 1
    sequence: int = 0
    synced: bool = False
    #: (size, bytes); of rows that nobody has used the memory is not there yet.
    states: NDArray[np.uint8] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self.states = np.zeros((self.size, self.group.start.size), np.uint8)

    @property
    def used(self) -> NDArray[np.uint8]:
        """(rows, bytes) the states."""
        return self.states[: self.rows]

    def begin(self, rows: NDArray[np.int64], start: NDArray[np.uint8]) -> None:
        """Axes begin in these rows."""
        self.states[_span(rows)] = start
        self.rows = max(self.rows, int(rows.max()) + 1)
        self.changed = True


def _span(rows: NDArray[np.int64]) -> slice | NDArray[np.int64]:
    """Ascending rows, as a slice where they follow one another."""
    first, end = int(rows[0]), int(rows[-1]) + 1
    return slice(first, end) if end - first == rows.size else rows


@dataclass(frozen=True)
class ShardPiece:
    """Axes of a shard that a thread steps at once. rows: (k,) ascending; at: where they are in the tables."""

    shard: Shard
    rows: NDArray[np.int64]
    at: slice

    def run(self, work: SampleBlock, way: int) -> None:
        """Its part of a call."""
        span = _span(self.rows)
        states = self.shard.states[span]
        results = tuple(result[self.at] for result in work.results)
        kernel = self.shard.group.borrow()
        kernel.hold(states)
        kernel.run(work.u[self.at], work.counts[self.at], 0, self.rows.size, work.every, results, way)
        self.shard.group.give_back(kernel)
        if not isinstance(span, slice):  # then they are copies
            self.shard.states[span] = states

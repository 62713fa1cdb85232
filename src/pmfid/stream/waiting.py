"""Ordered samples that wait to be stepped: blocks of tables, and pieces of single axes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pmfid.stream.delivery import join_arrays
from pmfid.stream.groups import Group, Seat
from pmfid.stream.order import SamplePiece
from pmfid.types import Counts, Flags, Floats

__all__ = ["Batch", "GroupQueue"]


@dataclass(frozen=True)
class Batch:
    """Samples of k axes to be stepped at once.

    index: (k,) numbers of the axes, each once; u, counts: (k, n); time, offset, turn: (k,) as in `SamplePiece`;
    received: (k,); pieces: (k,) pieces, or empty for blocks of a table: no sample is missing before these blocks, and
    their samples have no times of their own.
    """

    index: NDArray[np.int64]
    u: Floats
    counts: Counts
    time: Floats
    offset: NDArray[np.int64]
    turn: NDArray[np.int64]
    received: Floats
    pieces: tuple[SamplePiece, ...] = ()

    @classmethod
    def stack_pieces(cls, pairs: Sequence[tuple[Seat, SamplePiece]]) -> Batch:
        """One batch of pieces of the same length."""
        pieces = tuple(piece for _, piece in pairs)
        return cls(
            np.array([seat.index for seat, _ in pairs], np.int64),
            np.stack([piece.u for piece in pieces]),
            np.stack([piece.counts for piece in pieces]),
            np.array([piece.time for piece in pieces], np.float64),
            np.array([piece.offset for piece in pieces], np.int64),
            np.array([piece.turn for piece in pieces], np.int64),
            np.array([piece.received for piece in pieces], np.float64),
            pieces,
        )

    @classmethod
    def join(cls, parts: Sequence[Batch]) -> Batch:
        """One batch of batches without pieces, each of other axes."""
        if len(parts) == 1:
            return parts[0]
        index, u, counts, time = join_arrays(parts, "index", "u", "counts", "time")
        offset, turn, received = join_arrays(parts, "offset", "turn", "received")
        return cls(index, u, counts, time, offset, turn, received)


@dataclass
class GroupQueue:
    """The waiting samples of one group. Batches of tables are stepped first, so none may have an axis with waiting
    samples."""

    group: Group
    _tables: dict[int, list[Batch]] = field(default_factory=dict, init=False)
    _queues: dict[Seat, list[SamplePiece]] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        self._busy: Flags = np.zeros(len(self.group.seats), np.bool_)

    def may_put(self, index: NDArray[np.int64]) -> bool:
        """Whether no samples wait for any of these axes (k,)."""
        return not self._busy[index].any()

    def put(self, batch: Batch) -> None:
        """Appends blocks of a table."""
        self._busy[batch.index] = True
        self._tables.setdefault(batch.counts.shape[1], []).append(batch)

    def queue(self, seat: Seat, pieces: Sequence[SamplePiece]) -> None:
        """Appends pieces after all waiting samples of this axis."""
        self._busy[seat.index] = True
        self._queues.setdefault(seat, []).extend(pieces)

    def batches(self) -> Iterator[Batch]:
        """All waiting samples in the fewest batches; the samples of each axis are in order."""
        for parts in self._tables.values():
            yield Batch.join(parts)
        depth, left = 0, list(self._queues.items())
        while left:
            by_length: dict[int, list[tuple[Seat, SamplePiece]]] = {}
            for seat, queue in left:
                by_length.setdefault(queue[depth].counts.size, []).append((seat, queue[depth]))
            yield from map(Batch.stack_pieces, by_length.values())
            depth += 1
            left = [one for one in left if len(one[1]) > depth]

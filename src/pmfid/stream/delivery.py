"""Deliveries of sources, which are blocks of numbered samples, lines with a time, and unusable input."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmfid.stream.timeline import Line
from pmfid.types import Counts, Floats


@dataclass(frozen=True)
class Block:
    """Consecutive samples of one axis, numbered by the sender.

    `axis` is the name. The sender raises `epoch` when its numbers restart, for example after a restart of the drive.
    `first` >= 0 is the number of the first sample. `time` is the time of the first sample by the sender's clock [s],
    NaN without a clock. `dt` is the sender's sample period [s]. `u` (n,) is the input in the unit of the model, NaN for
    a lost sample, and `counts` is (n,). `ages` (n,) is the time from the last edge of the encoder to the sample [s],
    NaN without an edge, or None if the sender does not know it.
    """

    axis: str
    epoch: int
    first: int
    time: float
    dt: float
    u: Floats
    counts: Counts
    ages: Floats | None = None

    @property
    def end(self) -> int:
        """Number of the sample after the last one."""
        return self.first + self.counts.size


def join_arrays(parts: Sequence[object], *names: str) -> list[NDArray[Any]]:
    """Return the joined arrays of the parts, by their names."""
    return [np.concatenate([getattr(part, name) for part in parts]) for name in names]


def join_ages(ages: Sequence[Floats | None]) -> Floats | None:
    """Return the joined ages of parts, or None if the parts have none."""
    known = [one for one in ages if one is not None]
    return np.concatenate(known) if known else None


@dataclass(frozen=True)
class Table:
    """Blocks of one length as one item, with a row for each block in the sender's order.

    `axes` has the names. `epoch`, `first`, `time` and `dt` (k,) are as in `Block`. `u`, `counts` and `ages` are (k, n),
    n > 0, where `ages` may be None.
    """

    axes: tuple[str, ...]
    epoch: NDArray[np.int64]
    first: NDArray[np.int64]
    time: Floats
    dt: Floats
    u: Floats
    counts: Counts
    ages: Floats | None = None

    @property
    def form(self) -> tuple[int, bool]:
        """Samples in a block, and whether the blocks have ages. Tables of one form can be joined."""
        return self.counts.shape[1], self.ages is not None

    @classmethod
    def join(cls, tables: Sequence[Table]) -> Table:
        """Join tables of one form into one table."""
        if len(tables) == 1:
            return tables[0]
        axes, ages = tuple(chain.from_iterable(table.axes for table in tables)), [table.ages for table in tables]
        epoch, first, time, dt, u, counts = join_arrays(tables, "epoch", "first", "time", "dt", "u", "counts")
        return cls(axes, epoch, first, time, dt, u, counts, join_ages(ages))

    def block(self, row: int) -> Block:
        numbers = int(self.epoch[row]), int(self.first[row]), float(self.time[row]), float(self.dt[row])
        ages = None if self.ages is None else self.ages[row]
        return Block(self.axes[row], *numbers, self.u[row], self.counts[row], ages)

    def parts(self, first: int, end: int) -> Iterator[Table]:
        """Yield the table of the rows from `first` to `end`, or nothing if there are none."""
        if end - first == len(self.axes):
            yield self
        elif end > first:
            rows = slice(first, end)
            parts = {name: array[rows] for name, array in vars(self).items() if array is not None}
            yield replace(self, **parts)

    def blocks(self) -> list[Block]:
        return [self.block(row) for row in range(len(self.axes))]


@dataclass(frozen=True)
class Lines:
    """Samples of one axis that have a time instead of a number, as a logger writes them."""

    axis: str
    lines: Sequence[Line]


@dataclass(frozen=True)
class Unusable:
    """Input without a usable sample.

    `reason` is a short fixed word for counters, such as "crc". `problem` is a sentence. `axis` is the name if known,
    otherwise "".
    """

    reason: str
    problem: str
    axis: str = ""


Item = Block | Table | Lines | Unusable


def split_tables(items: Sequence[Item]) -> list[Block | Lines | Unusable]:
    """Return the items with single blocks in place of tables."""
    single = list[Block | Lines | Unusable]()
    for item in items:
        single += item.blocks() if isinstance(item, Table) else [item]
    return single


@dataclass(frozen=True)
class Delivery:
    """Items that a source hands over in one piece.

    `source` is the name in PLANT.toml. `items` are in the order of their arrival. `done` is called at most once, from
    any thread, when all items are in a durable checkpoint. Without checkpoints it is called immediately. A source that
    can acknowledge uses `done` for the acknowledgement. `received` is `time.monotonic()` at the arrival.
    """

    source: str
    items: Sequence[Item]
    done: Callable[[], object] | None = None
    received: float = 0.0

    @property
    def size(self) -> int:
        """Number of items, where each block of a table counts as one."""
        return sum(len(item.axes) if isinstance(item, Table) else 1 for item in self.items)

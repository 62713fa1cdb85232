"""Deliveries of sources: blocks of numbered samples, lines with a time, and unusable input."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmfid.pipeline.monitored.timeline import Line
from pmfid.types import Counts, Floats

#: JSON from which a source resumes after a restart, such as the position in a file.
Mark = dict[str, int | float | str]


@dataclass(frozen=True)
class Block:
    """Samples of one axis that follow one another, numbered by the sender.

    axis: its name; epoch: raised by the sender when its numbers restart, as after a restart of the drive; first:
    number of the first sample, 0 or more; time: of the first sample by the sender's clock [s], NaN without a clock;
    dt: the sender's sample period [s]; u: (n,) input in the unit of the model, NaN where a sample is lost; counts:
    (n,).
    """

    axis: str
    epoch: int
    first: int
    time: float
    dt: float
    u: Floats
    counts: Counts

    @property
    def end(self) -> int:
        """Number of the sample after the last one."""
        return self.first + self.counts.size


def join_arrays(parts: Sequence[object], *names: str) -> list[NDArray[Any]]:
    """The concatenation of the parts' arrays, by name."""
    return [np.concatenate([getattr(part, name) for part in parts]) for name in names]


@dataclass(frozen=True)
class Table:
    """Blocks of the same number of samples as one item, as gateways send them: a row for each, in their order.

    axes: their names; epoch, first, time, dt: (k,) as of `Block`; u, counts: (k, n), n > 0.
    """

    axes: tuple[str, ...]
    epoch: NDArray[np.int64]
    first: NDArray[np.int64]
    time: Floats
    dt: Floats
    u: Floats
    counts: Counts

    @classmethod
    def join(cls, tables: Sequence[Table]) -> Table:
        """One table of all rows; the blocks of all tables have the same length."""
        if len(tables) == 1:
            return tables[0]
        return cls(
            tuple(chain.from_iterable(table.axes for table in tables)),
            *join_arrays(tables, "epoch", "first", "time", "dt", "u", "counts"),
        )

    def block(self, row: int) -> Block:
        numbers = int(self.epoch[row]), int(self.first[row]), float(self.time[row]), float(self.dt[row])
        return Block(self.axes[row], *numbers, self.u[row], self.counts[row])

    def blocks(self) -> list[Block]:
        return [self.block(row) for row in range(len(self.axes))]


@dataclass(frozen=True)
class Lines:
    """Samples of one axis that have a time in place of a number, as a logger writes them."""

    axis: str
    lines: Sequence[Line]


@dataclass(frozen=True)
class Unusable:
    """Input without a usable sample. reason: a short fixed word, as "crc", for counters; problem: a sentence; axis: its
    name if known, else ""."""

    reason: str
    problem: str
    axis: str = ""


Item = Block | Table | Lines | Unusable


def split_tables(items: Sequence[Item]) -> list[Block | Lines | Unusable]:
    """The items with single blocks in place of tables."""
    single = list[Block | Lines | Unusable]()
    for item in items:
        single += item.blocks() if isinstance(item, Table) else [item]
    return single


@dataclass(frozen=True)
class Delivery:
    """Items that a source hands over at once.

    source: its name in PLANT.toml; items: in the order of their arrival; done: called, from any thread and at most
    once, when all items are in a durable checkpoint, or at once without checkpoints; a source that can acknowledge
    does so then; mark: position of the source after this delivery, kept in the checkpoint; received:
    `time.monotonic()` at the arrival.
    """

    source: str
    items: Sequence[Item]
    done: Callable[[], object] | None = None
    mark: Mark | None = field(default=None)
    received: float = 0.0

    @property
    def size(self) -> int:
        """Number of items, with each block of a table as one."""
        return sum(len(item.axes) if isinstance(item, Table) else 1 for item in self.items)

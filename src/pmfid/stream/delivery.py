"""What comes in: blocks of numbered samples, lines with a time, and what could not be used."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmfid.session.monitored.timeline import Line
from pmfid.types import Counts, Floats

__all__ = ["Block", "Delivery", "Item", "Lines", "Table", "Unusable", "join_arrays", "split_tables"]

#: JSON of a source by which it goes on after a restart, as the place in a file.
Mark = dict[str, int | float | str]


@dataclass(frozen=True)
class Block:
    """Samples of one axis that follow one another, numbered by the sender.

    axis: its name; epoch: what the sender raises when its numbers begin anew, as after a restart of the drive; first:
    number of the first sample, 0 or more; time: of the first sample by the sender's clock [s], NaN where it has none;
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
        """Number of the sample behind the last."""
        return self.first + self.counts.size


def join_arrays(parts: Sequence[object], *names: str) -> list[NDArray[Any]]:
    """The arrays of these names of each part, one behind the other."""
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
        """Tables of blocks of the same length, one behind the other, as one."""
        if len(tables) == 1:
            return tables[0]
        return cls(
            tuple(chain.from_iterable(table.axes for table in tables)),
            *join_arrays(tables, "epoch", "first", "time", "dt", "u", "counts"),
        )

    def block(self, row: int) -> Block:
        """One of them."""
        numbers = int(self.epoch[row]), int(self.first[row]), float(self.time[row]), float(self.dt[row])
        return Block(self.axes[row], *numbers, self.u[row], self.counts[row])

    def blocks(self) -> list[Block]:
        """All of them."""
        return [self.block(row) for row in range(len(self.axes))]


@dataclass(frozen=True)
class Lines:
    """Samples of one axis that have a time in place of a number, as a logger writes them."""

    axis: str
    lines: Sequence[Line]


@dataclass(frozen=True)
class Unusable:
    """Something that came and is no sample. reason: a short fixed word, as "crc", for counters; problem: a sentence;
    axis: its name where that is known, else ""."""

    reason: str
    problem: str
    axis: str = ""


Item = Block | Table | Lines | Unusable


def split_tables(items: Sequence[Item]) -> list[Block | Lines | Unusable]:
    """The same with single blocks in place of tables."""
    found = list[Block | Lines | Unusable]()
    for item in items:
        found += item.blocks() if isinstance(item, Table) else [item]
    return found


@dataclass(frozen=True)
class Delivery:
    """What a source hands over at once.

    source: its name in PLANT.toml; items: in the order in which they came; done: called, from any thread and at most
    once, when all of it is in a checkpoint that a restart would find, or at once where no checkpoints are kept; a
    source that can acknowledge does it then; mark: where the source stands behind this delivery, kept in that
    checkpoint; received: `time.monotonic()` when it came.
    """

    source: str
    items: Sequence[Item]
    done: Callable[[], None] | None = None
    mark: Mark | None = field(default=None)
    received: float = 0.0

    @property
    def size(self) -> int:
        """Its items, the blocks of a table one by one."""
        return sum(len(item.axes) if isinstance(item, Table) else 1 for item in self.items)

"""Where the numbers and the clocks of many axes stand: a column for each, so that many are looked at at once.

There is one copy of it: `Order` and `Clock` of an axis read and write the row of that axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from pmfid.monitor.arrays import RowArrays
from pmfid.types import Flags, Floats

__all__ = ["Column", "PositionRow", "Positions"]

T = TypeVar("T", int, float, bool)


@dataclass
class Positions(RowArrays):
    """Columns (axes,). epoch, expected: of the next sample, epoch -1 before the first; time: of sample `number` by the
    sender's clock [s], NaN while unknown; start, first: a time and its number from where the rate of that clock is
    measured; told: that it has another one; wrong_period: what came with another period was told; waits: some blocks
    came too early; heard: when samples of it were used last [s], by the clock of `Silence`, NaN: not yet; alarm: number
    of the alarm that it is silent, 0 for none."""

    epoch: NDArray[np.int64]
    expected: NDArray[np.int64]
    time: Floats
    number: NDArray[np.int64]
    start: Floats
    first: NDArray[np.int64]
    wrong_rate: Flags
    wrong_period: Flags
    waits: Flags
    heard: Floats
    alarm: NDArray[np.int64]

    @classmethod
    def fresh(cls, axes: int) -> Positions:
        """Of axes of which nothing came yet."""
        zeros, unknown, no = np.zeros(axes, np.int64), np.full(axes, np.nan), np.zeros(axes, np.bool_)
        clock = unknown, zeros.copy(), unknown.copy(), zeros.copy()
        flags = no, no.copy(), no.copy()
        return cls(zeros - 1, zeros, *clock, *flags, unknown.copy(), zeros.copy())

    def add(self, axes: int) -> None:
        """So many more."""
        vars(self).update(vars(self.join_rows(Positions.fresh(axes))))

    def forget(self, index: int) -> None:
        """Of this one nothing came yet; how long it has been silent stays."""
        here, fresh = slice(index, index + 1), Positions.fresh(1)
        fresh.heard, fresh.alarm = self.heard[here], self.alarm[here]
        self.put(here, fresh)

    def fall_silent(self, index: int, alarm: int) -> None:
        """It was silent before a restart, and is until it is heard; alarm: number of that, 0: it was not."""
        if alarm:
            self.heard[index], self.alarm[index] = -np.inf, alarm

    def remove(self, index: Sequence[int]) -> None:
        """Without these; the others move up in their order."""
        left = np.delete(np.arange(self.epoch.size), list(index))
        vars(self).update(vars(self.take_rows(left)))


class PositionRow:
    """The row of an axis. It moves when others go."""

    __slots__ = ("index", "positions")

    def __init__(self, positions: Positions, index: int) -> None:
        self.positions, self.index = positions, index


class Column(Generic[T]):
    """An attribute of something with a `place`, kept in a column of its positions."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __get__(self, one: object, kind: type | None = None) -> T:
        place: PositionRow = one.place  # type: ignore[attr-defined]
        found: T = getattr(place.positions, self._name).item(place.index)
        return found

    def __set__(self, one: object, value: T) -> None:
        place: PositionRow = one.place  # type: ignore[attr-defined]
        getattr(place.positions, self._name)[place.index] = value

"""State of the numbers and the clocks of many axes: a column for each quantity, so that many axes are tested at once.

There is one copy: `Order` and `Clock` of an axis read and write the row of that axis.
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
    """Columns (axes,).

    epoch, expected: of the next sample, epoch -1 before the first; time: of sample `number` by the sender's clock [s],
    NaN while unknown; start, first: time and number at which the measurement of that clock's rate began; wrong_rate:
    the last measured rate was outside its tolerance; wrong_period: a notice has reported samples of another period;
    waits: some blocks are early; heard: time of its last used samples by the clock of `Silence` [s], NaN before;
    alarm: number of the alarm on its silence, 0 for none.
    """

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
        """Rows of axes without any data."""
        zeros, unknown, no = np.zeros(axes, np.int64), np.full(axes, np.nan), np.zeros(axes, np.bool_)
        clock = unknown, zeros.copy(), unknown.copy(), zeros.copy()
        flags = no, no.copy(), no.copy()
        return cls(zeros - 1, zeros, *clock, *flags, unknown.copy(), zeros.copy())

    def add(self, axes: int) -> None:
        """Adds rows of axes without any data."""
        vars(self).update(vars(self.join_rows(Positions.fresh(axes))))

    def forget(self, index: int) -> None:
        """Resets the row of an axis; the duration of its silence stays."""
        here, fresh = slice(index, index + 1), Positions.fresh(1)
        fresh.heard, fresh.alarm = self.heard[here], self.alarm[here]
        self.put(here, fresh)

    def fall_silent(self, index: int, alarm: int) -> None:
        """Marks an axis that was silent before a restart as silent until new data; alarm: its number, 0: not silent."""
        if alarm:
            self.heard[index], self.alarm[index] = -np.inf, alarm

    def remove(self, index: Sequence[int]) -> None:
        """Removes rows; the others move up in order."""
        left = np.delete(np.arange(self.epoch.size), list(index))
        vars(self).update(vars(self.take_rows(left)))


class PositionRow:
    """The row of an axis, which moves up when other axes are removed."""

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

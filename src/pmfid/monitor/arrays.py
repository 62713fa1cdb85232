"""All that changes in monitored axes, as arrays with a row for each axis."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from functools import cache
from typing import Self

import numpy as np
from numpy.typing import NDArray

from pmfid._stage import ALONE, CHANGED, FRESH, KNOWN, LOST, POWER, SAME, SAMPLES, USUAL, put_rows
from pmfid.monitor.scores import width_of
from pmfid.types import Floats, Places

#: Units that an alarm looks back on.
LOOK_BACK = 64
#: What follows from other arrays, and is not saved.
DERIVED = {"saved": False}


class RowArrays:
    """Arrays with the same number of rows, one row for each axis."""

    __dataclass_fields__: dict[str, object]

    def parts(self, saved_only: bool = False) -> Iterator[tuple[str, NDArray[np.generic]]]:
        """The arrays by name."""
        return ((name, getattr(self, name)) for name in _names(type(self), saved_only))  # type: ignore[arg-type]  # a class has a hash

    def take_rows(self, index: Places | slice) -> Self:
        """Some rows: an array of numbers gives copies, a slice gives views."""
        if isinstance(index, slice):
            return type(self)(**{name: part[index] for name, part in self.parts()})
        return type(self)(**{name: part.take(index, axis=0) for name, part in self.parts()})

    def put(self, index: Places | slice, rows: Self) -> None:
        """Overwrites some rows."""
        for name, part in self.parts():
            if isinstance(index, slice):
                part[index] = getattr(rows, name)
            else:
                put_rows(part, index, getattr(rows, name))

    def copy_rows(self) -> Self:
        """A copy of all rows."""
        return type(self)(**{name: part.copy() for name, part in self.parts()})

    def repeat_rows(self, times: int) -> Self:
        """Each row, `times` times."""
        return type(self)(**{name: np.repeat(part, times, axis=0) for name, part in self.parts()})

    def join_rows(self, other: Self) -> Self:
        """These rows, then those of `other`."""
        return type(self)(**{name: np.concatenate([part, getattr(other, name)]) for name, part in self.parts()})


@cache
def _names(kind: type[RowArrays], saved_only: bool) -> tuple[str, ...]:
    return tuple(one.name for one in fields(kind) if one.metadata.get("saved", True) or not saved_only)  # type: ignore[arg-type]


@dataclass
class Sampled(RowArrays):
    """What the samples of an axis change. whole, real: of its `Inputs`; flagged: status of the last sample that was not
    lost; estimator, filter: states of the kernels, packed; sums, progress: of the block under way, see `Scoring`."""

    whole: NDArray[np.int64]
    real: Floats
    flagged: NDArray[np.uint32]
    estimator: NDArray[np.uint8]
    filter: NDArray[np.uint8]
    sums: Floats
    progress: NDArray[np.uint32]

    @property
    def samples(self) -> NDArray[np.int64]:
        """(n,) so far, the lost ones among them."""
        return self.whole[:, SAMPLES]

    @property
    def yes_or_no(self) -> NDArray[np.int64]:
        """(n, 3) 1 or 0: whether the last sample was lost, any was not, the input changed in the last that was not."""
        return self.whole[:, [LOST, KNOWN, CHANGED]]

    @property
    def fresh(self) -> NDArray[np.int64]:
        """(n,) counts that are kept and follow one another."""
        return self.whole[:, FRESH]

    @property
    def sizes(self) -> Floats:
        """(n, 2), not negative: what the input changes by from sample to sample, and its mean square."""
        return self.real[:, [USUAL, POWER]]

    @property
    def shares(self) -> Floats:
        """(n, 2) from 0 to 1: samples in which the input stays the same, and its changes that come alone."""
        return self.real[:, [SAME, ALONE]]


@dataclass
class Watched(RowArrays):
    """What the blocks of an axis change. theta: (n, p) reference; state: number of `STATES`; waiting: blocks that count
    for nothing; silence: blocks since the last one with information; opened: information of the unit under way,
    opening: its sum (n, width), members: its blocks, begun: its time; detection: of the detector; units: so far with
    this reference. wait, sigma, tolerance: of the reference."""

    theta: Floats
    state: NDArray[np.uint8]
    waiting: NDArray[np.int64]
    silence: NDArray[np.int64]
    opened: Floats
    opening: Floats
    members: NDArray[np.int64]
    begun: Floats
    detection: Floats
    statistic: Floats
    units: NDArray[np.int64]
    wait: NDArray[np.int64] = field(metadata=DERIVED)
    sigma: Floats = field(metadata=DERIVED)
    tolerance: Floats = field(metadata=DERIVED)

    @classmethod
    def empty(cls, axes: int, p: int, detection: int) -> Watched:
        """`axes` axes that have no reference yet."""
        none, nowhere, vector = np.zeros(axes), np.zeros(axes, np.int64), np.zeros((axes, p))
        return cls(
            theta=vector,
            state=np.zeros(axes, np.uint8),
            waiting=nowhere,
            silence=nowhere.copy(),
            opened=none,
            opening=np.zeros((axes, width_of(p))),
            members=nowhere.copy(),
            begun=none.copy(),
            detection=np.zeros((axes, detection, p)),
            statistic=none.copy(),
            units=nowhere.copy(),
            wait=nowhere.copy(),
            sigma=vector.copy(),
            tolerance=vector.copy(),
        )


@dataclass
class Disturbed(RowArrays):
    """Data that alarms use and change. units: (n, LOOK_BACK, width) the last, in a ring; begun: (n, LOOK_BACK) their
    times; gathered: information since the suspicion, or since the alarm; suspected: units since the suspicion; crossed:
    the statistic at it; refined: whether the estimate is the model already; before: (n, p) the reference until then;
    settled: (n, width) sum of the blocks relative to that model; gain: of the input, over that of the estimator;
    by_gain: whether the alarm was of the gain of the input."""

    units: Floats
    begun: Floats
    gathered: Floats
    suspected: NDArray[np.int64]
    crossed: Floats
    refined: NDArray[np.uint8]
    before: Floats
    settled: Floats
    gain: Floats
    by_gain: NDArray[np.uint8]

    @classmethod
    def empty(cls, axes: int, p: int) -> Disturbed:
        """`axes` axes without an alarm."""
        width = width_of(p)
        return cls(
            np.zeros((axes, LOOK_BACK, width)),
            np.zeros((axes, LOOK_BACK)),
            np.zeros(axes),
            np.zeros(axes, np.int64),
            np.zeros(axes),
            np.zeros(axes, np.uint8),
            np.zeros((axes, p)),
            np.zeros((axes, width)),
            np.ones(axes),
            np.zeros(axes, np.uint8),
        )

    def recent(self, axis: int, units: int) -> tuple[Floats, Floats]:
        """The last units (m, width) of an axis and their times (m,), in order; units: number of all so far."""
        order = np.arange(max(0, units - LOOK_BACK), units) % LOOK_BACK
        return self.units[axis, order], self.begun[axis, order]

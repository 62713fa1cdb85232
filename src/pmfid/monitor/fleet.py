"""Many axes watched in one process."""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import UsageError, whole_number
from pmfid.estimators.configuration import configuration_of, made
from pmfid.monitor.events import Event
from pmfid.monitor.monitor import Monitor
from pmfid.monitor.record import configuration_number, load, store
from pmfid.monitor.rows import STATES, FleetRows
from pmfid.monitor.saved import States, read, written
from pmfid.types import Floats


class MonitorFleet:
    """Many axes watched with the configuration and calibration of one monitor, each with a state of its own and the
    bits that `Monitor` alone would give.

    All start from the present state of `monitor`, which itself does not change. axes: number, >= 0. Raises UsageError
    for another number.
    """

    def __init__(self, monitor: Monitor, axes: int) -> None:
        axes = whole_number("axes", axes, 0, "it is the number of axes")
        self._source, self._first = monitor, store(monitor)
        self.dt, self.names, self.units = monitor.estimator.dt, monitor.names, monitor.units
        self._monitors = [self._new() for _ in range(axes)]

    @property
    def axes(self) -> int:
        """How many there are now."""
        return len(self._monitors)

    def _new(self) -> Monitor:
        return _as(self._source, self._first, 0)

    def run(self, index: ArrayLike, u: ArrayLike, counts: ArrayLike) -> FleetRows:
        """The next n samples of the axes `index` (k,), each at most once; u, counts: (k, n), u not finite: the sample
        is lost, as in `Monitor.step`. Raises UsageError where an axis is not there or comes twice, or the arrays do not
        fit."""
        index, u, counts = self._checked(index, u, counts)
        rows = FleetRows.empty(len(u), u.shape[1], len(self.names))
        for row, axis in enumerate(index.tolist()):
            rows.take(row, self._monitors[axis].run(u[row], counts[row]))
        return rows

    def _checked(
        self, index: ArrayLike, u: ArrayLike, counts: ArrayLike
    ) -> tuple[NDArray[np.int64], Floats, NDArray[np.int64]]:
        places = self._places(index)
        inputs, read_counts = np.asarray(u, np.float64), np.asarray(counts)
        if read_counts.dtype.kind not in "iu" and read_counts.size:
            raise UsageError(f"counts must be integers, got {read_counts.dtype}")
        if inputs.ndim != 2 or inputs.shape != read_counts.shape or len(inputs) != places.size:
            raise UsageError(
                f"u and counts must be ({places.size}, n), a row for each axis; got {inputs.shape} and "
                f"{read_counts.shape}"
            )
        return places, inputs, read_counts.astype(np.int64)

    def _places(self, index: ArrayLike) -> NDArray[np.int64]:
        places = np.asarray(index)
        if places.ndim != 1 or (places.size and places.dtype.kind not in "iu"):
            raise UsageError(f"index must be numbers of axes (k,), got {places.dtype} {places.shape}")
        if places.size and not (places.min() >= 0 and places.max() < self.axes):
            raise UsageError(f"there are {self.axes} axes, from 0 on; got {places.min()} to {places.max()}")
        if np.unique(places).size < places.size:
            raise UsageError("an axis comes twice in index: its samples follow one another, in two calls")
        return places.astype(np.int64)

    def _one(self, axis: int) -> Monitor:
        return self._monitors[int(self._places([axis])[0])]

    def skip(self, axis: int, samples: int) -> list[Event]:
        """`Monitor.skip` of an axis."""
        return self._one(axis).skip(samples)

    def between(self, axis: int, missing: int, u: float, counts: int) -> list[Event]:
        """`Monitor.between` of an axis."""
        return self._one(axis).between(missing, u, counts)

    def rebase(self, axis: int, counts: int) -> None:
        """`Monitor.rebase` of an axis."""
        self._one(axis).rebase(counts)

    def refer(self, axis: int, theta: ArrayLike | None = None) -> list[Event]:
        """`Monitor.refer` of an axis."""
        return self._one(axis).refer(theta)

    def monitor(self, axis: int) -> Monitor:
        """A monitor of its own in the state of an axis."""
        return _as(self._source, store(self._one(axis)), 0)

    def samples(self) -> NDArray[np.int64]:
        """(axes,) `Monitor.samples` of each."""
        return np.array([monitor.samples for monitor in self._monitors], np.int64)

    def states(self) -> NDArray[np.uint8]:
        """(axes,) numbers of `STATES`."""
        return np.array([STATES.index(monitor.state) for monitor in self._monitors], np.uint8)

    def statistics(self) -> Floats:
        """(axes,) `Monitor.statistic` of each."""
        return np.array([monitor.statistic for monitor in self._monitors], np.float64)

    def references(self) -> Floats:
        """(axes, p) `Monitor.reference` of each."""
        p = self._source.reference.size
        return np.array([monitor.reference for monitor in self._monitors], np.float64).reshape(-1, p)

    def add(self, count: int = 1) -> range:
        """So many axes more, in the state that all began with; their numbers."""
        before = self.axes
        self._monitors += [self._new() for _ in range(whole_number("count", count, 0, "it is a number of axes"))]
        return range(before, self.axes)

    def remove(self, index: ArrayLike) -> NDArray[np.int64]:
        """Without these axes; the others move up in their order. Returns (axes before,) their new numbers, -1 of those
        that are gone. Raises UsageError for one that is not there or comes twice."""
        gone, moved = self._places(index), np.full(self.axes, -1, np.int64)
        kept = np.setdiff1d(np.arange(self.axes), gone)
        moved[kept] = np.arange(kept.size)
        self._monitors = [self._monitors[axis] for axis in kept.tolist()]
        return moved

    def get_state(self) -> bytes:
        """The states of all axes, with a version and checksums; `set_state` of a fleet with the same configuration goes
        on from them."""
        return written(self._states(), configuration_number(self._source))

    def _states(self) -> States:
        parts = [store(monitor) for monitor in self._monitors]
        return {name: np.concatenate([part[:0], *(one[name] for one in parts)]) for name, part in self._first.items()}

    def set_state(self, state: bytes) -> None:
        """Goes on from saved states, of as many axes as they are of. Raises UsageError, and stays as it was, for those
        of another configuration, damaged ones, and numbers that no sample could have made."""
        found = read(state, self._first, configuration_number(self._source))
        self._monitors = list(_each(self._source, found))


def _each(source: Monitor, states: States) -> Iterator[Monitor]:
    for axis in range(len(states["state"])):
        yield _as(source, states, axis)


def _as(source: Monitor, states: States, axis: int) -> Monitor:
    """A monitor of its own with the configuration of another one, in the state of an axis."""
    estimator = made(type(source.estimator), configuration_of(source.estimator))
    single = Monitor(estimator, source.calibration, copy(source.watch), source.known)
    load(single, states, axis)
    return single

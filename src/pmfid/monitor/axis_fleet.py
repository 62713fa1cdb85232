"""The states of many monitored axes: added, removed, saved, and stepped one by one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import UsageError, whole_number
from pmfid.estimators.configuration import integer_counts, numbers
from pmfid.monitor.events import Event, FleetRows
from pmfid.monitor.saved import StateRows, make_parts, read, write_states
from pmfid.monitor.tuning import TUNING
from pmfid.types import Counts, Floats, Places

S = TypeVar("S", bound=StateRows)
T = TypeVar("T")


class Watcher(Protocol[S]):
    """The parts of a monitor of one axis that a fleet needs."""

    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def units(self) -> tuple[str, ...]: ...
    @property
    def configuration_number(self) -> int: ...
    def pack_state(self) -> S: ...
    def go_on(self, saved: S, axis: int) -> None: ...
    def check_states(self, saved: S) -> S: ...
    def skip(self, samples: int) -> list[Event]: ...
    def refer(self, theta: ArrayLike | None = None) -> list[Event]: ...


M = TypeVar("M", bound=Watcher)  # type: ignore[type-arg]  # a bound has no variables


class AxisFleet(ABC, Generic[M, S]):
    """Many axes watched with the configuration of one monitor, each with its own state.

    `monitor` is the monitor from whose present state all axes start; it does not change. `axes` is the number of axes.
    Raises UsageError if `axes` is not a whole number >= 0.
    """

    def __init__(self, monitor: M, axes: int) -> None:
        axes = whole_number("axes", axes, 0, "it is the number of axes")
        self._source, self._first = monitor, monitor.pack_state()
        self.names, self.units = monitor.names, monitor.units
        self._all: S = self._first.repeat_rows(axes)
        self._scratch = self._copy_monitor()  # computes the axes that are not quiet, one after the other

    @abstractmethod
    def _copy_monitor(self) -> M:
        """Return a new monitor with the configuration of the fleet."""

    @property
    def axes(self) -> int:
        """Number of axes."""
        return self._all.axes

    def _with(self, axis: int, action: Callable[[M], T]) -> T:
        """Apply an action to the monitor of an axis, store the monitor's new state, and return the action's result."""
        self._scratch.go_on(self._all, axis)
        found = action(self._scratch)
        self._all.put(slice(axis, axis + 1), self._scratch.pack_state())
        return found

    def run(self, index: ArrayLike, u: ArrayLike, counts: ArrayLike, ages: ArrayLike | None = None) -> FleetRows:
        """Take the next n samples u, counts (k, n) of the axes `index` (k,), each at most once.

        `ages` (k, n) belong to monitors of edges: an age [s] is NaN without an edge since the last sample, and None
        means no edges. If u is not finite, the sample is lost, as in `step` of a monitor. Raises UsageError if an axis
        does not exist or comes twice, or if the arrays do not fit.
        """
        places, inputs, read_counts = self._check_arrays(index, u, counts)
        nothing = np.broadcast_to(np.float64(np.nan), inputs.shape)
        instants = nothing if ages is None else np.asarray(numbers("ages", ages), np.float64)
        if instants.shape != inputs.shape:
            raise UsageError(f"ages must have the shape {inputs.shape} of u, got {instants.shape}")
        rows = FleetRows.empty(len(inputs), inputs.shape[1], len(self.names))
        for group in slices(len(inputs), TUNING.fleet_group):
            for time in slices(inputs.shape[1], TUNING.fleet_piece):
                part = group, time
                self._run(places[group], inputs[part], read_counts[part], instants[part], rows, part)
        rows.events.sort(key=lambda one: one[:2])
        return rows

    @abstractmethod
    def _run(
        self, index: Places, u: Floats, counts: Counts, ages: Floats, rows: FleetRows, part: tuple[slice, slice]
    ) -> None:
        """Run a piece of a group of axes. The quiet axes run together, all other axes one by one."""

    def _check_arrays(self, index: ArrayLike, u: ArrayLike, counts: ArrayLike) -> tuple[Places, Floats, Counts]:
        places = self._places(index)
        inputs = np.ascontiguousarray(numbers("u", u), np.float64)
        read_counts = np.ascontiguousarray(integer_counts(counts), np.int64)
        if inputs.ndim != 2 or inputs.shape != read_counts.shape or len(inputs) != places.size:
            raise UsageError(
                f"u and counts must be ({places.size}, n), with one row for each axis; got {inputs.shape} and "
                f"{read_counts.shape}"
            )
        return places, inputs, read_counts

    def _places(self, index: ArrayLike) -> NDArray[np.int64]:
        places = np.asarray(index)
        if places.ndim != 1 or (places.size and places.dtype.kind not in "iu"):
            raise UsageError(f"index must contain the numbers of the axes (k,), got {places.dtype} {places.shape}")
        if places.size and not (places.min() >= 0 and places.max() < self.axes):
            raise UsageError(
                f"index must be from 0 to {self.axes - 1} for {self.axes} axes; got {places.min()} to {places.max()}"
            )
        if not (np.diff(places) > 0).all() and not np.diff(np.sort(places)).all():
            raise UsageError("index contains an axis twice; pass later samples of an axis in a second call")
        return places.astype(np.int64)

    def _place(self, axis: int) -> int:
        return int(self._places([axis])[0])

    def skip(self, axis: int, samples: int) -> list[Event]:
        """Skip lost samples of one axis, and return the events."""
        return self._with(self._place(axis), lambda monitor: monitor.skip(samples))

    def refer(self, axis: int, theta: ArrayLike | None = None) -> list[Event]:
        """Make theta (p,) the reference of one axis, and return the events. None takes its present estimate."""
        return self._with(self._place(axis), lambda monitor: monitor.refer(theta))

    def monitor(self, axis: int) -> M:
        """Return a new monitor in the state of an axis."""
        single = self._copy_monitor()
        single.go_on(self._all, self._place(axis))
        return single

    def add(self, count: int = 1) -> range:
        """Add `count` axes in the start state of the fleet, and return their numbers."""
        before = self.axes
        more = whole_number("count", count, 0, "it is the number of axes to add")
        self._all = self._all.join_rows(self._first.repeat_rows(more))
        return range(before, self.axes)

    def remove(self, index: ArrayLike) -> NDArray[np.int64]:
        """Remove axes, and return the new numbers (axes before,) of all axes, -1 for the removed ones.

        The remaining axes keep their order. Raises UsageError for an axis that does not exist or comes twice.
        """
        kept, moved = np.ones(self.axes, np.bool_), np.full(self.axes, -1, np.int64)
        kept[self._places(index)] = False
        moved[kept] = np.arange(kept.sum())
        self._all = self._all.take_rows(np.flatnonzero(kept))
        return moved

    def get_state(self) -> bytes:
        """Return the states of all axes, with a version and checksums.

        `set_state` of a fleet with the same configuration continues from these states.
        """
        return write_states(self._all, self._source.configuration_number)

    def unsealed_state(self) -> list[memoryview]:
        """Return the states of all axes in pieces, without the checksum.

        Most pieces are the arrays themselves. The checksum takes longer than a copy. `pmfid.monitor.saved.seal_parts`
        adds the checksum to a copy, in any thread.
        """
        return make_parts(self._all, self._source.configuration_number)

    def set_state(self, state: bytes) -> None:
        """Continue from saved states of the same number of axes.

        Raises UsageError, and changes nothing, for states of another configuration, damaged states and impossible
        numbers.
        """
        self._all = self._read(state)

    def _read(self, state: bytes) -> S:
        found: S = self._scratch.check_states(read(state, self._first, self._source.configuration_number))
        return found


def slices(size: int, most: int) -> Iterator[slice]:
    """Yield slices of at most `most` rows of `size` rows."""
    return (slice(start, min(start + most, size)) for start in range(0, size, most))

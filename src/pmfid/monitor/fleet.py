"""Monitors of many axes, where quiet axes are computed together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import methodcaller
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import UsageError, whole_number
from pmfid.estimators.configuration import integer_counts, numbers
from pmfid.monitor.base import check_further
from pmfid.monitor.edges import EdgeMonitor
from pmfid.monitor.events import Event, FleetRows
from pmfid.monitor.monitor import Monitor
from pmfid.monitor.quiet import Quiet
from pmfid.monitor.saved import make_parts, read, write_states
from pmfid.monitor.tuning import TUNING
from pmfid.types import Counts, Floats, Places

T = TypeVar("T")


class MonitorFleet:
    """Many axes watched with the configuration and calibration of one monitor.

    Each axis has its own state. The results have the same bits as the results of a single monitor.

    Parameters
    ----------
    monitor
        `Monitor`, or `EdgeMonitor` for encoders with edge times, from whose present state all axes start; the monitor
        does not change.
    axes
        Number of axes, >= 0.

    Raises
    ------
    UsageError
        If `axes` is not a whole number >= 0.

    Notes
    -----
    Only one thread at a time may use a fleet.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import RIV, Drive, Encoder
    >>> from pmfid.monitor import Monitor, MonitorFleet, calibrate
    >>> from pmfid.simulation import CART, make_scenario
    >>> work = make_scenario("moves", seed=1, duration=200.0)
    >>> riv = RIV(Drive(CART.input_gain), Encoder(work.resolution), work.dt, 50.0, forgetting=0.99)
    >>> theta = np.array([CART.mass, CART.viscous_friction, CART.coulomb_friction])
    >>> calibration = calibrate(riv, theta, work.motion.u, work.counts)
    >>> fleet = MonitorFleet(Monitor(riv, calibration), axes=2)
    >>> rows = fleet.run([0, 1], np.tile(work.motion.u[:500], (2, 1)), np.tile(work.counts[:500], (2, 1)))
    >>> rows.theta.shape, fleet.axes
    ((2, 500, 3), 2)
    """

    def __init__(self, monitor: Monitor | EdgeMonitor, axes: int) -> None:
        axes = whole_number("axes", axes, 0, "it is the number of axes")
        self._source, self._first = monitor, monitor.pack_state()
        self.names, self.units = monitor.names, monitor.units
        self._all: Any = self._first.repeat_rows(axes)
        scratch = monitor.fresh()
        self._scratch: Any = scratch  # acts on one axis at a time
        self._quiet = None if isinstance(scratch, EdgeMonitor) else Quiet(scratch)

    @property
    def further(self) -> str:
        """Name of the further column of samples, "ages" or "temperature", or an empty text."""
        return self._source.further

    @property
    def axes(self) -> int:
        """Number of axes."""
        return int(self._all.axes)

    def _with(self, axis: int, action: Callable[[Any], T]) -> T:
        """Apply an action to the monitor of an axis, store the monitor's new state, and return the action's result."""
        self._scratch.go_on(self._all, axis)
        found = action(self._scratch)
        self._all.put(slice(axis, axis + 1), self._scratch.pack_state())
        return found

    def run(
        self,
        index: ArrayLike,
        u: ArrayLike,
        counts: ArrayLike,
        further: ArrayLike | None = None,
    ) -> FleetRows:
        """Take the next n samples u, counts (k, n) of the axes `index` (k,), each at most once.

        The column `further` (k, n) belongs to monitors with a `further` column: an age [s] is NaN without an edge since
        the last sample, and a temperature is NaN if it is unknown. If u is not finite, the sample is lost, as in `step`
        of a monitor. Raises UsageError if an axis does not exist or comes twice, if the arrays do not fit, or for a
        column that the monitors do not take.
        """
        places, *inputs = self._check_arrays(index, u, counts)
        shape = inputs[0].shape
        if self.further:
            inputs.append(check_further(self.further, further, shape))
        elif further is not None:
            raise UsageError("these monitors compute from counts: leave out ages, or make a fleet of an EdgeMonitor")
        rows = FleetRows.empty(shape[0], shape[1], len(self.names))
        for first in range(0, shape[0], TUNING.fleet_group):
            for begin in range(0, shape[1], TUNING.fleet_piece):
                part = slice(first, first + TUNING.fleet_group), slice(begin, begin + TUNING.fleet_piece)
                rows.take(self._run_piece(places[part[0]], [array[part] for array in inputs]), *part)
        rows.events.sort(key=lambda one: one[:2])
        return rows

    def _run_piece(self, index: Places, inputs: Sequence[NDArray[Any]]) -> FleetRows:
        """Run a piece of a group of axes. Quiet axes run together, and all other axes one by one."""
        rows = FleetRows.empty(index.size, inputs[0].shape[1], len(self.names))
        quiet = np.zeros(index.size, np.bool_)
        if self._quiet is not None:
            quiet = self._quiet.run(self._all, index, rows, *inputs[:2])
        for row in np.flatnonzero(~quiet).tolist():
            single = self._with(int(index[row]), methodcaller("run", *(array[row] for array in inputs)))
            rows.take(single, slice(row, row + 1), slice(None))
        return rows

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

    def monitor(self, axis: int) -> Any:
        """Return a new monitor in the state of an axis."""
        single = self._source.fresh()
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

        Most pieces are the arrays themselves. The checksum takes longer than a copy. `pmfid.kernel.saved.seal_parts`
        adds the checksum to a copy, in any thread.
        """
        return make_parts(self._all, self._source.configuration_number)

    def set_state(self, state: bytes) -> None:
        """Continue from saved states of the same number of axes.

        Raises UsageError, and changes nothing, for states of another configuration, damaged states and impossible
        numbers.
        """
        self._all = self._scratch.check_states(read(state, self._first, self._source.configuration_number))

    def fill_gap(self, axis: int, missing: int, u: float, counts: int) -> list[Event]:
        """Call `fill_gap` of the monitor of one axis, and return the events."""
        return self._with(self._place(axis), lambda monitor: monitor.fill_gap(missing, u, counts))

    def samples(self) -> NDArray[np.int64]:
        """Number of samples of each axis so far, (axes,)."""
        return np.array(self._all.samples, np.int64)

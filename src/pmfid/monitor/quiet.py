"""Quiet axes of a fleet, computed together."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pmfid._stage import bars, follow_many
from pmfid.monitor.axis import REASONS
from pmfid.monitor.events import SETTLING, STATES, SUSPICIOUS, Event, FleetRows, Outlier, StateChange
from pmfid.monitor.monitor import ANY_OUTLIER, Monitor, outliers
from pmfid.monitor.states import AxisStates, Sampled
from pmfid.types import Counts, Flags, Floats, Places

#: Numbers of the states in which an axis is not quiet.
UNEASY = (STATES.index(SUSPICIOUS), STATES.index(SETTLING))


class Quiet:
    """A runner that steps quiet axes together, a piece of their samples at a time, with the configuration of a
    monitor."""

    def __init__(self, monitor: Monitor) -> None:
        self._watcher = monitor.watcher
        self._estimator, self._filter = monitor.packers
        self._scoring, self._dt, self._delay = monitor.scoring, monitor.estimator.dt, monitor.estimator.delay
        # Each estimate needs its own combination with prior information. Each block needs the model of its temperature.
        alone = monitor.known is not None or bool(monitor.further)
        self._calm = np.array([state not in UNEASY and not alone for state in range(len(STATES))])
        self._memory = np.empty((0, 0, 0)), np.empty((0, 0, 0)), np.empty((0, 0))

    def run(self, every: AxisStates, index: Places, rows: FleetRows, u: Floats, counts: Counts) -> Flags:
        """Run a piece u, counts (k, n) of the axes `index` (k,), and return whether each axis was quiet, (k,).

        Only the states of quiet axes change. The rows of the other axes have no meaning.
        """
        calm = self._calm[every.watched.state[index]]
        if not calm.any():
            return calm
        before, sampled = every.take_rows(index[~calm]) if not calm.all() else None, every.sampled.take_rows(index)
        quiet = calm & self._run(every, index, sampled, np.ascontiguousarray(u), np.ascontiguousarray(counts), rows)
        every.sampled.put(index[quiet], sampled if quiet.all() else sampled.take_rows(np.flatnonzero(quiet)))
        if before is not None:
            every.put(index[~calm], before)
        rows.events[:] = [event for event in rows.events if quiet[event[0]]]
        return quiet

    def _run(
        self, every: AxisStates, index: Places, sampled: Sampled, u: Floats, counts: Counts, rows: FleetRows
    ) -> Flags:
        """Run a piece u, counts (k, n), n >= 1, of k axes, and return whether each axis stayed quiet, (k,).

        `index` (k,) has the rows of the axes in `every`. `sampled` has only the axes of the piece, and is updated.
        `every.watched` is updated for the axes that stay quiet. `rows` is filled as if all axes stayed quiet.
        """
        samples, filled = sampled.samples - self._delay, sampled.progress[:, 0].astype(np.int64)
        own = follow_many(sampled.whole, sampled.real, u, counts)
        self._estimates(sampled, u, own, rows)
        rows.state[:] = every.watched.state[index][:, None]
        rows.events.extend(self._outliers(sampled, rows.status, samples))
        self._filter.hold(sampled.filter)
        theta = every.watched.theta[index]
        scored = self._filter.score(u, own, self._scoring.numbers, theta, sampled.sums, sampled.progress)
        wanted, reason, crossed = self._watcher.run(
            every.watched, every.disturbed, index, scored, rows.status, samples, filled, self._scoring.size, self._dt
        )
        self._changes(rows, wanted, reason, filled, samples)
        return ~crossed

    def _estimates(self, sampled: Sampled, u: Floats, counts: Counts, rows: FleetRows) -> None:
        factor, inflation, variance = self._room(*rows.theta.shape)
        results = rows.theta, factor, inflation, rows.innovation, variance, rows.status
        self._estimator.hold(sampled.estimator)
        self._estimator.run(u, counts, 0, len(u), 1, results, self._estimator.fastest_way)
        bars(factor, variance, inflation, rows.std)

    def _room(self, k: int, n: int, p: int) -> tuple[Floats, Floats, Floats]:
        """Return work arrays for results that are not returned. The memory of the arrays is reused."""
        if self._memory[0].shape != (k, n, p):
            self._memory = np.empty((k, n, p)), np.empty((k, n, p)), np.empty((k, n))
        return self._memory

    def _outliers(
        self, sampled: Sampled, status: NDArray[np.uint32], samples: Places
    ) -> Iterator[tuple[int, int, Event]]:
        before = sampled.flagged.copy()
        sampled.flagged[:] = status[:, -1]
        for row in np.flatnonzero(np.any(status & ANY_OUTLIER, axis=1)).tolist():
            for k, signal in outliers(status[row], int(before[row]))[0]:
                yield row, k, Outlier((int(samples[row]) + k) * self._dt, signal)

    def _changes(
        self, rows: FleetRows, wanted: NDArray[np.uint8], reason: NDArray[np.uint8], filled: Places, samples: Places
    ) -> None:
        """Report changes of state. `wanted` (k, most) is the state after each block."""
        if (wanted == rows.state[:, :1]).all():
            return
        before = np.concatenate([rows.state[:, :1], wanted[:, :-1]], axis=1)
        for k, block in np.argwhere(wanted != before).tolist():
            place = (block + 1) * self._scoring.size - 1 - int(filled[k])
            time = (int(samples[k]) + place) * self._dt
            rows.state[k, place:] = wanted[k, block]
            rows.events.append((k, place, StateChange(time, STATES[wanted[k, block]], REASONS[reason[k, block]])))

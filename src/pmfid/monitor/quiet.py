"""Many quiet axes at once: axes that are neither suspicious nor settling.

A piece of all their samples is computed in arrays, as if no axis became suspicious in it. An axis that becomes
suspicious resets its covariance within the piece, so its results are discarded and the piece is computed for it alone.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pmfid._stage import bars, follow_many, last_flags
from pmfid.models.equation import ESTIMATE
from pmfid.monitor.arrays import Sampled, Watched
from pmfid.monitor.events import SETTLING, SUSPICIOUS, Event, Outlier, StateChange
from pmfid.monitor.monitor import ANY_OUTLIER, Monitor, outliers
from pmfid.monitor.rows import STATES, FleetRows
from pmfid.monitor.saved import AxisStates
from pmfid.monitor.watching import REASONS
from pmfid.types import Counts, Flags, Floats, Places

#: Numbers of the states in which an axis is not quiet.
UNEASY = (STATES.index(SUSPICIOUS), STATES.index(SETTLING))


class Quiet:
    """Runs pieces of quiet axes with the configuration of a monitor."""

    def __init__(self, monitor: Monitor) -> None:
        self._watching = monitor.watching
        self._estimator, self._filter = monitor.packers
        self._scoring, self._dt = monitor.scoring, monitor.estimator.dt
        alone = monitor.known is not None  # prior information is combined with each estimate separately
        self._calm = np.array([state not in UNEASY and not alone for state in range(len(STATES))])
        self._memory = np.empty((0, 0, 0)), np.empty((0, 0, 0)), np.empty((0, 0))
        self._one_reference = monitor.estimator.equation.dead_time == ESTIMATE  # the kernel is configured with it
        self._theta = monitor.calibration.theta

    def may_run(self, watched: Watched, index: Places) -> Flags:
        """(k,) which of these axes can be run here."""
        quiet = self._calm[watched.state[index]]
        return quiet & np.all(watched.theta[index] == self._theta, axis=1) if self._one_reference else quiet

    def run(
        self, every: AxisStates, index: Places, sampled: Sampled, u: Floats, counts: Counts, rows: FleetRows
    ) -> Flags:
        """Runs a piece u, counts: (k, n), n >= 1, of k axes, the rows `index` (k,) of `every`.

        sampled: of these axes alone, is updated. `every.watched` is updated for the axes that stay quiet. rows: filled
        as if all stayed quiet. Returns (k,) whether each axis stayed quiet.
        """
        samples, filled = sampled.samples.copy(), sampled.progress[:, 0].astype(np.int64)
        own = follow_many(sampled.whole, sampled.real, u, counts)
        self._estimates(sampled, u, own, rows)
        rows.state[:] = every.watched.state[index][:, None]
        rows.events.extend(self._outliers(sampled, rows.status, u, samples))
        self._filter.hold(sampled.filter)
        theta = every.watched.theta[index]
        scored = self._filter.score(u, own, self._scoring.numbers, theta, sampled.sums, sampled.progress)
        wanted, reason, crossed = self._watching.watcher.run(
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
        """Work arrays for results that are not returned; their memory is reused."""
        if self._memory[0].shape != (k, n, p):
            self._memory = np.empty((k, n, p)), np.empty((k, n, p)), np.empty((k, n))
        return self._memory

    def _outliers(
        self, sampled: Sampled, status: NDArray[np.uint32], u: Floats, samples: Places
    ) -> Iterator[tuple[int, int, Event]]:
        before = sampled.flagged.copy()
        for row in last_flags(status, u, sampled.flagged, ANY_OUTLIER).tolist():
            for k, signal in outliers(status[row], ~np.isfinite(u[row]), int(before[row]))[0]:
                yield row, k, Outlier((int(samples[row]) + k) * self._dt, signal)

    def _changes(
        self, rows: FleetRows, wanted: NDArray[np.uint8], reason: NDArray[np.uint8], filled: Places, samples: Places
    ) -> None:
        """Reports changes of state; wanted: (k, most) the state after each block."""
        if (wanted == rows.state[:, :1]).all():
            return
        before = np.concatenate([rows.state[:, :1], wanted[:, :-1]], axis=1)
        for k, block in np.argwhere(wanted != before).tolist():
            place = (block + 1) * self._scoring.size - 1 - int(filled[k])
            time = (int(samples[k]) + place) * self._dt
            rows.state[k, place:] = wanted[k, block]
            rows.events.append((k, place, StateChange(time, STATES[wanted[k, block]], REASONS[reason[k, block]])))

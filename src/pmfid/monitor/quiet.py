"""Quiet axes, many at once: those of which nothing is to be told but how their watch goes on.

A piece of all their samples is computed in arrays, as if none became suspicious in it. One that does has opened its
estimator's memory in the middle: what was computed of it is thrown away, and it goes through the piece by itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmfid._stage import follow_many, last_flags
from pmfid.estimators.track import Tracks
from pmfid.models.equation import ESTIMATE
from pmfid.monitor.arrays import Sampled, Watched
from pmfid.monitor.events import SETTLING, SUSPICIOUS, Event, Outlier, StateChange
from pmfid.monitor.monitor import ANY_OUTLIER, Monitor, outliers
from pmfid.monitor.rows import STATES, FleetRows
from pmfid.monitor.saved import Saved
from pmfid.monitor.watching import REASONS
from pmfid.types import Counts, Flags, Floats, Places

#: Numbers of the states in which an axis is not quiet.
UNEASY = (STATES.index(SUSPICIOUS), STATES.index(SETTLING))


@dataclass
class Piece:
    """What a piece of samples made of k quiet axes. rows: as if all had stayed quiet; crossed: (k,) those that did
    not."""

    rows: FleetRows
    crossed: Flags


class Quiet:
    """Runs pieces of quiet axes with the configuration of a monitor."""

    def __init__(self, monitor: Monitor) -> None:
        self._watching, self._names, self._units = monitor.watching, monitor.names, monitor.units
        self._estimator, self._filter = monitor.packers
        self._scoring, self._dt = monitor.scoring, monitor.estimator.dt
        self._alone = monitor.known is not None  # put together with each estimate by itself
        self._one_reference = monitor.estimator.equation.dead_time == ESTIMATE  # the kernel is configured with it
        self._theta = monitor.calibration.theta

    def may_run(self, watched: Watched, index: Places) -> Flags:
        """(k,) which of these axes can be run here."""
        quiet = ~np.isin(watched.state[index], UNEASY) & (not self._alone)
        return quiet & np.all(watched.theta[index] == self._theta, axis=1) if self._one_reference else quiet

    def run(self, every: Saved, index: Places, sampled: Sampled, u: Floats, counts: Counts) -> Piece:
        """A piece u, counts: (k, n), n >= 1, of k axes, the rows `index` (k,) of every. sampled: of these axes alone,
        which goes on; what is watched of those that stay quiet goes on in its place."""
        samples, filled = sampled.samples.copy(), sampled.progress[:, 0].astype(np.int64)
        own = follow_many(sampled.whole, sampled.real, u, counts)
        tracks = self._tracks(sampled, u, own)
        state = np.repeat(every.watched.state[index][:, None], u.shape[1], axis=1)
        events = list(self._outliers(sampled, tracks.status, u, samples))
        rows = FleetRows(tracks.theta, tracks.theta_std, tracks.innovation, tracks.status, state, events)
        self._filter.hold(sampled.filter)
        theta = every.watched.theta[index]
        scored = self._filter.score(u, own, self._scoring.numbers, theta, sampled.sums, sampled.progress)
        wanted, reason, crossed = self._watching.watcher.run(
            every.watched, every.disturbed, index, scored, tracks.status, samples, filled, self._scoring.size, self._dt
        )
        self._changes(rows, wanted, reason, filled, samples)
        return Piece(rows, crossed)

    def _tracks(self, sampled: Sampled, u: Floats, counts: Counts) -> Tracks:
        k, n, p = *u.shape, len(self._names)
        theta, factor, inflation = (np.empty((k, n, p)) for _ in range(3))
        innovation, variance, status = np.empty((k, n)), np.empty((k, n)), np.empty((k, n), np.uint32)
        results = theta, factor, inflation, innovation, variance, status
        self._estimator.hold(sampled.estimator)
        self._estimator.run(u, counts, 0, k, 1, results, self._estimator.fastest_way)
        return Tracks(self._names, self._units, *results, np.arange(n))

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
        """The states behind the blocks, (k, most), where they are other ones than before."""
        size, n = self._scoring.size, rows.state.shape[1]
        before = np.concatenate([rows.state[:, :1], wanted[:, :-1]], axis=1)
        whole = np.arange(wanted.shape[1]) < ((filled + n) // size)[:, None]
        for k, block in np.argwhere((wanted != before) & whole).tolist():
            place = (block + 1) * size - 1 - int(filled[k])
            time = (int(samples[k]) + place) * self._dt
            rows.state[k, place:] = wanted[k, block]
            rows.events.append((k, place, StateChange(time, STATES[wanted[k, block]], REASONS[reason[k, block]])))

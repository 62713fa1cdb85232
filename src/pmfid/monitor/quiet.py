"""Quiet axes, many at once: those of which nothing is to be told but how their watch goes on.

A piece of all their samples is computed in arrays, as if none became suspicious in it. One that does has opened its
estimator's memory in the middle: what was computed of it is thrown away, and it goes through the piece by itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pmfid._stage import follow_many
from pmfid.estimators.track import Tracks
from pmfid.models.equation import ESTIMATE
from pmfid.monitor.arrays import Disturbed, Sampled, Watched
from pmfid.monitor.events import SETTLING, SUSPICIOUS, Event, Outlier, StateChange
from pmfid.monitor.monitor import ANY_OUTLIER, Monitor, outliers
from pmfid.monitor.rows import STATES, FleetRows
from pmfid.monitor.watching import REASONS
from pmfid.types import Counts, Flags, Floats, Places

#: Numbers of the states in which an axis is not quiet.
UNEASY = (STATES.index(SUSPICIOUS), STATES.index(SETTLING))


@dataclass
class Pushed:
    """Units that some axes completed. axes: their rows; before: how many they had; units: (m, width); begun: times."""

    axes: Places
    before: Places
    units: Floats
    begun: Floats


@dataclass
class Piece:
    """What a piece of samples made of k quiet axes. sampled, watched: behind it; rows: as if all had stayed quiet;
    crossed: (k,) those that did not."""

    sampled: Sampled
    watched: Watched
    rows: FleetRows
    crossed: Flags
    pushed: list[Pushed] = field(default_factory=list)

    def push(self, into: Disturbed, kept: Flags, index: Places) -> None:
        """The units of the axes that are kept, (k,), into the rows `index` (k,) of all."""
        for one in self.pushed:
            mine = kept[one.axes]
            into.push(index[one.axes[mine]], one.before[mine], one.units[mine], one.begun[mine])


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

    def run(self, sampled: Sampled, watched: Watched, u: Floats, counts: Counts) -> Piece:
        """A piece u, counts: (k, n), n >= 1, of k axes, whose states are changed."""
        samples, filled = sampled.samples.copy(), sampled.progress[:, 0].astype(np.int64)
        own = follow_many(sampled.whole, sampled.real, u, counts)
        tracks = self._tracks(sampled, u, own)
        state = np.repeat(watched.state[:, None], u.shape[1], axis=1)
        events = list(self._outliers(sampled, tracks.status, u, samples))
        rows = FleetRows(tracks.theta, tracks.theta_std, tracks.innovation, tracks.status, state, events)
        piece = Piece(sampled, watched, rows, np.zeros(len(u), np.bool_))
        self._blocks(piece, u, own, samples, filled)
        return piece

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
        kept = np.isfinite(u)
        last = u.shape[1] - 1 - np.argmax(kept[:, ::-1], axis=1)
        flagged = np.where(kept.any(axis=1), status[np.arange(len(u)), last], sampled.flagged)
        for row in np.flatnonzero(np.any(((status & ANY_OUTLIER) != 0) & kept, axis=1)).tolist():
            for k, signal in outliers(status[row], ~kept[row], int(sampled.flagged[row]))[0]:
                yield row, k, Outlier((int(samples[row]) + k) * self._dt, signal)
        sampled.flagged[:] = flagged

    def _blocks(self, piece: Piece, u: Floats, counts: Counts, samples: Places, filled: Places) -> None:
        sampled, watched, size = piece.sampled, piece.watched, self._scoring.size
        self._filter.hold(sampled.filter)
        sums, progress = sampled.sums, sampled.progress
        blocks, lost = self._filter.score(u, counts, self._scoring.numbers, watched.theta, sums, progress)
        whole = (filled + u.shape[1]) // size
        for k in range(blocks.shape[1]):
            rows = np.flatnonzero((whole > k) & ~piece.crossed)
            if rows.size:
                place = (k + 1) * size - 1 - filled[rows]
                self._block(
                    piece,
                    rows,
                    place,
                    np.asarray((samples[rows] + place) * self._dt, np.float64),
                    blocks[rows, k],
                    lost[rows, k],
                )

    def _block(
        self, piece: Piece, rows: Places, place: Places, time: Floats, blocks: Floats, lost: NDArray[np.uint8]
    ) -> None:
        """One block of each of some axes, at these samples and times."""
        watching, status = self._watching, piece.rows.status[rows, place]
        own = piece.watched.selected(rows)
        blocks, information = watching.informed(own, blocks, lost)
        whole, units = watching.whole(own, blocks, information, time)
        wanted, reason = watching.looked(own, status)
        for k in np.flatnonzero(wanted != own.state).tolist():
            change = StateChange(float(time[k]), STATES[wanted[k]], REASONS[reason[k]])
            piece.rows.events.append((int(rows[k]), int(place[k]), change))
            piece.rows.state[rows[k], place[k] :] = wanted[k]
        own.state[:] = wanted
        done = np.flatnonzero(whole)
        if done.size:
            piece.pushed.append(Pushed(rows[done], own.units[done], units[done], own.begun[done]))
            counted = own.selected(done)
            told = watching.counted(counted, units[done])
            piece.crossed[rows[done]] = watching.crossed(counted, told, status[done])
            own.put_selected(done, counted)
        piece.watched.put_selected(rows, own)

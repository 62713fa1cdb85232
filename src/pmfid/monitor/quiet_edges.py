"""Quiet axes with edge times of a fleet, judged together."""

from __future__ import annotations

import numpy as np

from pmfid._stage import bars
from pmfid.monitor.edges import BASE, COUNTS, REFERENCE, SAMPLES, SILENT, SINCE, EdgeMonitor, EdgeStates
from pmfid.monitor.events import CANNOT_TELL, STARTING, STATES, WATCHING, FleetRows
from pmfid.status import Status
from pmfid.types import Counts, Flags, Floats, Places

#: Numbers of the states in which an axis can be quiet.
_STARTING, _WATCHING, _CANNOT_TELL = (STATES.index(state) for state in (STARTING, WATCHING, CANNOT_TELL))


class QuietEdges:
    """A runner that steps quiet axes with edge times together, with the configuration of a monitor."""

    def __init__(self, monitor: EdgeMonitor) -> None:
        self._monitor = monitor

    def may_run(self, every: EdgeStates, index: Places, u: Floats) -> Flags:
        """Return which of these axes can run here, (k,)."""
        calm = np.isin(every.state[index], (_STARTING, _WATCHING, _CANNOT_TELL))
        return np.asarray(np.isfinite(u).all(axis=1) & calm)

    def run(self, every: EdgeStates, index: Places, rows: FleetRows, u: Floats, counts: Counts, ages: Floats) -> Flags:
        """Run a piece u, counts, ages (k, n) of the axes `index` (k,), and return whether each axis stayed quiet, (k,).

        Only the states of axes that stayed quiet change.
        """
        states = every.take_rows(index)
        given = np.ascontiguousarray(u), np.ascontiguousarray(counts), np.ascontiguousarray(ages)
        found = self._monitor.estimator.kernel.run_many(states.recursion, *given)
        theta, variance, innovation, known, status = found
        rows.theta[:], rows.innovation[:], rows.status[:] = theta, innovation, status
        bars(variance, known, np.zeros_like(variance), rows.std)
        rows.state[:] = states.state[:, None]
        kept = self._judge(states, counts, rows)
        every.put(index[kept], states.take_rows(np.flatnonzero(kept)))
        return kept

    def _judge(self, states: EdgeStates, counts: Counts, rows: FleetRows) -> Flags:
        """Judge the estimates as `EdgeMonitor` does, and return whether each axis stayed in its state, (k,)."""
        n, before, monitor = counts.shape[1], states.whole, self._monitor
        moved = np.diff(counts, axis=1, prepend=before[:, COUNTS, None]) != 0
        last = np.maximum.accumulate(np.where(moved, np.arange(n), -1 - before[:, SILENT, None]), axis=1)
        silent = np.arange(n) - last
        judged = moved | (silent == monitor.patience)
        starting, distorted = ((rows.status & int(bits)) != 0 for bits in (Status.STARTING, Status.DISTORTED))
        at = {name: states.state[:, None] == name for name in (_STARTING, _WATCHING, _CANNOT_TELL)}
        sound = judged & ~distorted & at[_WATCHING]
        armed = np.logical_or.accumulate(np.column_stack([states.armed, sound]), axis=1)
        weighed = ~starting & moved & ~(distorted & armed[:, :-1])
        statistic, doubtful = monitor.weigh_deviations(
            rows.theta, rows.std, distorted, states.values[:, REFERENCE, None]
        )
        with np.errstate(invalid="ignore"):
            calm = weighed & ~doubtful & (statistic <= monitor.threshold)
        rest = ~starting & ~moved
        unsure = rest | (weighed & doubtful) | (starting & ~armed[:, :-1])
        quiet = np.where(at[_STARTING], starting, np.where(at[_WATCHING], calm, unsure))
        self._note(states, counts, rows.theta, (weighed & judged, statistic), sound, silent[:, -1])
        states.armed[:] = armed[:, -1]
        return np.asarray(np.all(quiet | ~judged, axis=1))

    def _note(
        self,
        states: EdgeStates,
        counts: Counts,
        theta: Floats,
        weighed: tuple[Flags, Floats],
        sound: Flags,
        silent: Places,
    ) -> None:
        """Write what the judgement of quiet axes leaves: numbers of samples, last statistic, last sound estimate."""
        n, rows = counts.shape[1], np.arange(len(counts))
        states.whole[:, SAMPLES] += n
        states.whole[:, SINCE] += n
        states.whole[:, SILENT], states.whole[:, COUNTS] = silent, counts[:, -1]
        for flags, values, target in (
            (*weighed, states.statistic),
            (sound, theta, states.values[:, BASE]),
        ):
            last = n - 1 - np.argmax(flags[:, ::-1], axis=1)
            some = flags.any(axis=1)
            target[some] = values[rows[some], last[some]]

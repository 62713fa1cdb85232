"""Monitors of many axes whose encoders give the instants of their edges; quiet axes are judged together."""

from __future__ import annotations

from collections.abc import Iterable
from copy import copy
from dataclasses import replace
from functools import partial

import numpy as np

from pmfid._stage import bars
from pmfid.monitor.axis_fleet import AxisFleet
from pmfid.monitor.edges import BASE, COUNTS, REFERENCE, SAMPLES, SILENT, SINCE, EdgeMonitor, EdgeStates
from pmfid.monitor.events import CANNOT_TELL, STARTING, STATES, WATCHING, FleetRows
from pmfid.status import Status
from pmfid.types import Counts, Flags, Floats, Places

#: Numbers of the states in which an axis can be quiet.
_STARTING, _WATCHING, _CANNOT_TELL = (STATES.index(state) for state in (STARTING, WATCHING, CANNOT_TELL))


class EdgeFleet(AxisFleet[EdgeMonitor, EdgeStates]):
    """Many axes with edge times, watched with the configuration of one monitor.

    Each axis has its own state. The results have the same bits as the results of a single `EdgeMonitor`.

    Parameters
    ----------
    monitor
        Monitor from whose present state all axes start; the monitor does not change.
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
    >>> from pmfid import Drive, Encoder, REdge
    >>> from pmfid.monitor import EdgeFleet, EdgeMonitor
    >>> from pmfid.simulation import CART, capture_edges, prbs, simulate_drive
    >>> u = prbs(500, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
    >>> counts, ages = capture_edges(simulate_drive(CART, np.repeat(u, 10), 1e-3), 0.0015, every=10, tick=1e-6)
    >>> estimator = REdge(Drive(CART.input_gain), Encoder(0.0015), 0.01, lines=64, tick=1e-6, memory=10.0)
    >>> fleet = EdgeFleet(EdgeMonitor(estimator, np.array([1.07, 12.8, 0.8])), axes=2)
    >>> rows = fleet.run([0, 1], *(np.tile(part, (2, 1)) for part in (u, counts, ages)))
    >>> rows.theta[:, -1].round(2)
    array([[ 1.07, 12.8 ,  0.8 ],
           [ 1.07, 12.8 ,  0.8 ]])
    """

    def _copy_monitor(self) -> EdgeMonitor:
        source = self._source
        return EdgeMonitor(replace(source.estimator), source.reference, copy(source.watch))

    def samples(self) -> Places:
        """`EdgeMonitor.samples` of each axis, (axes,)."""
        return self._all.whole[:, SAMPLES].copy()

    def _run(
        self, index: Places, u: Floats, counts: Counts, ages: Floats, rows: FleetRows, part: tuple[slice, slice]
    ) -> None:
        states = self._all.take_rows(index)
        found = FleetRows.empty(u.shape[0], u.shape[1], len(self.names))
        kept = np.isfinite(u).all(axis=1) & np.isin(states.state, (_STARTING, _WATCHING, _CANNOT_TELL))
        kept &= self._run_quiet(states, u, counts, ages, found)
        self._all.put(index[kept], states.take_rows(np.flatnonzero(kept)))
        for row in np.flatnonzero(~kept).tolist():
            samples = zip(u[row].tolist(), counts[row].tolist(), ages[row].tolist(), strict=True)
            self._with(int(index[row]), partial(_step, samples=samples, rows=found, row=row))
        rows.take(found, np.arange(part[0].start, part[0].start + index.size), part[1])

    def _run_quiet(self, states: EdgeStates, u: Floats, counts: Counts, ages: Floats, rows: FleetRows) -> Flags:
        """Step axes as if all stayed quiet, and return whether each axis did, (k,). Otherwise its results are void."""
        given = np.ascontiguousarray(u), np.ascontiguousarray(counts), np.ascontiguousarray(ages)
        found = self._scratch.estimator.kernel.run_many(states.recursion, *given)
        theta, variance, innovation, known, status = found
        rows.theta[:], rows.innovation[:], rows.status[:] = theta, innovation, status
        bars(variance, known, np.zeros_like(variance), rows.std)
        rows.state[:] = states.state[:, None]
        return self._judge(states, counts, rows)

    def _judge(self, states: EdgeStates, counts: Counts, rows: FleetRows) -> Flags:
        """Judge the estimates as `EdgeMonitor` does, and return whether each axis stayed in its state, (k,)."""
        n, before, monitor = counts.shape[1], states.whole, self._scratch
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


def _step(monitor: EdgeMonitor, samples: Iterable[tuple[float, int, float]], rows: FleetRows, row: int) -> None:
    """Step a monitor over samples, and write the results into a row."""
    for k, (u, counts, age) in enumerate(samples):
        estimate, events = monitor.step(u, counts, age)
        rows.theta[row, k], rows.std[row, k] = estimate.theta, estimate.theta_std
        rows.innovation[row, k], rows.status[row, k] = estimate.innovation, estimate.status
        rows.state[row, k] = STATES.index(monitor.state)
        rows.events.extend((row, k, event) for event in events)

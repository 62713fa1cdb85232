"""The fit of the simulated motion to counts and to the instants of the encoder's edges, off-line."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.configuration import check_arrays, check_edges, check_size
from pmfid.estimators.motion_fit import MotionFit
from pmfid.estimators.results import Fit
from pmfid.fit.edges import FEWEST, EdgeSearch, fit_edges
from pmfid.fit.fit import Fitted
from pmfid.fit.likelihood import Intervals
from pmfid.fit.machine import machine_of
from pmfid.fit.problem import FitProblem, ObservedStretch
from pmfid.fit.search import EXPLAINED
from pmfid.types import Counts, Flags, Floats

#: Largest relative excess of an age over the step of the clock.
EDGES_LATE = 1e-6
#: Relative accuracy to which times and forces are known. Crystals are made to 20 ppm.
EDGES_EXACT = 1e-5


@dataclass(frozen=True, eq=False)
class Edges:
    """The last edge of each sample. `instants` (m,) are times since the first sample [s], and `lines` (m,) are
    positions in counts. `samples` (m,) are the indices of the samples after the edges."""

    instants: Floats
    lines: Counts
    samples: Counts


def read_edges(t: Floats, counts: Counts, ages: ArrayLike) -> Edges:
    """Return the edges of `counts` (n,) at the times t (n,) [s].

    `ages` (n,) [s] do not count in samples without an edge, where a timer may go on. An axis that turns between two
    samples may leave an edge without a change of the counts. Such an edge has an unknown line, and the function leaves
    the edge out. Raises UsageError for ages that do not fit the counts.
    """
    given = np.asarray(ages, np.float64)
    if given.shape != counts.shape:
        raise UsageError(f"ages must have the shape of counts, {counts.shape}, got {given.shape}")
    step, change = np.diff(t, prepend=t[0]), np.diff(counts, prepend=counts[:1])
    there = np.isfinite(given) & (change != 0)
    wrong = there & ~((given >= 0) & (given <= step * (1 + EDGES_LATE)))
    if np.any(wrong):
        row = int(np.argmax(wrong))
        raise UsageError(
            f"the age in row {row + 1} is {given[row]:g} s, but only {step[row]:g} s have passed since "
            "the previous sample. An age is the time from the last edge to the sample; leave it empty or "
            "NaN if it is unknown. If the unit is not s, put it into the name of the column, for example "
            "age_us or age_ticks"
        )
    lines = np.where(change > 0, counts, counts + 1)
    return Edges((t - given)[there], lines[there], np.flatnonzero(there))


@dataclass(frozen=True)
class EdgeFit(MotionFit):
    """The fit of `MotionFit` with the instants of the encoder's edges, off-line.

    Parameters
    ----------
    model, encoder, dt, cutoff
        See `IV`.
    lines : int, optional
        Counts after which the lines repeat, for example the counts per revolution. None gives each count its own line,
        as on a linear scale.
    tick : float
        Period of the timer that takes the instants [s]. An instant may be late by one period of the timer.

    Notes
    -----
    At the instant of an edge, only the error of the encoder's line limits the accuracy of the position. `fit` takes the
    age of the last edge in each sample, in addition to the counts. The likelihood weighs each edge by the variance of
    the instants and the variance of the lines. Each line has the same error at all its edges, and all edges may be late
    by the same time.

    If the instants scatter so much that the counts alone make the mass surer, only the counts are used, with a note.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import Drive, EdgeFit, Encoder
    >>> from pmfid.simulation import CART, capture_edges, prbs, simulate_drive
    >>> u = prbs(1000, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
    >>> motion = simulate_drive(CART, np.repeat(u, 10), 1e-3)
    >>> counts, ages = capture_edges(motion, 0.0058, every=10, tick=1e-6)
    >>> method = EdgeFit(Drive(CART.input_gain), Encoder(0.0058), 0.01, 20.0, lines=16, tick=1e-6)
    >>> method.fit(u, counts, ages).theta.round(4)
    array([ 1.07, 12.8 ,  0.8 ])
    """

    method: ClassVar[str] = "edges"
    lines: int | None = field(default=None, kw_only=True)
    tick: float = field(default=0.0, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_edges(self.lines, self.tick, self.dt)

    def fit(self, u: ArrayLike, counts: ArrayLike, ages: ArrayLike | None = None) -> Fit:
        """Return the estimate from the input u (n,), counts (n,) and ages of the last edges (n,) [s].

        An age is NaN if no edge occurred since the preceding sample. Raises UsageError if the arrays do not fit each
        other, and NotIdentifiableError if the record cannot identify every parameter.
        """
        if ages is None:
            raise UsageError("EdgeFit needs the age of the last edge of each sample; without ages use MotionFit")
        fitted, notes = self.examine_edges(*check_arrays(u, counts), np.asarray(ages, np.float64))
        return replace(self.summarise(fitted), notes=notes)

    def examine_edges(
        self,
        u: Floats,
        counts: Counts,
        ages: Floats,
        there: Flags | None = None,
        temperature: Floats | None = None,
    ) -> tuple[Fitted, tuple[str, ...]]:
        """Return the fit of a record with its comparison of forces, and notes. `there` (n,) marks the counts in use,
        and friction may follow a `temperature` (n,).

        Raises NotIdentifiableError if the axis does not move, or if no motion of the model passes the edges.
        """
        check_size(u)
        self.steps_before(u.size)
        used = np.ones(u.size, bool) if there is None else there
        stretches, margins = self.with_edges(u, counts, ages, used, temperature)
        with np.errstate(all="ignore"):  # motions far from the record may overflow
            problem = FitProblem(machine_of(self.equation), stretches, self.encoder.resolution)
            fitted, search = fit_edges(problem, self.lines, margins)
            surer = self._try_counts((u, counts, used, temperature), fitted)
        notes = [f"{search.dropped} edges were left out, because no motion explains them"] if search.dropped else []
        if surer is not None:
            scatter = 100 * _typical(fitted)
            sentence = f"the edges scatter by {scatter:.2g} % of a step, so the counts alone are more precise and"
            return surer, (f"{sentence} only they were used",)
        if self.lines is not None:
            notes += _describe_lines(search, self.lines)
        sure = np.diag((EDGES_EXACT * fitted.theta) ** 2)
        half = np.hypot(fitted.half, 1.96 * EDGES_EXACT * np.abs(fitted.theta))
        return replace(fitted, covariance=fitted.covariance + sure, half=half), tuple(notes)

    def _try_counts(self, record: tuple[Floats, Counts, Flags, Floats | None], fitted: Fitted) -> Fitted | None:
        """Return the fit of the counts alone if their intervals make the leading parameter surer than the edges."""
        if _typical(fitted) < EXPLAINED:
            return None
        try:
            plain = MotionFit.examine(self, *record)
        except NotIdentifiableError:
            return None
        leading = self.equation.leading
        return plain if isinstance(plain.likelihood, Intervals) and plain.half[leading] < fitted.half[leading] else None

    def with_edges(
        self, u: Floats, counts: Counts, ages: Floats, there: Flags, temperature: Floats | None = None
    ) -> tuple[tuple[ObservedStretch, ...], list[Floats]]:
        """Return the stretches with their edges, and the time between each edge and the nearest sample [s]."""
        whole = np.floor(self.position(counts) / self.encoder.resolution).astype(np.int64)
        t = np.append(0.0, np.cumsum(np.broadcast_to(self.intervals, u.shape)[: u.size - 1]))
        edges = read_edges(t, whole, ages)
        used = there[edges.samples] & there[edges.samples - 1]
        p = len(self.names)
        if np.count_nonzero(used) < FEWEST * (p + 2):
            raise NotIdentifiableError(
                f"the record has {np.count_nonzero(used)} edges for {p} parameters: record a longer motion"
            )
        edges = Edges(edges.instants[used], edges.lines[used], edges.samples[used])
        parts = list(self.observe(u, counts, there, temperature))
        found = [_merge(one, t, edges, self.tick, int(whole[0]), self.encoder.resolution) for one in parts]
        return tuple(one for one, _ in found), [margin for _, margin in found]


def _merge(
    stretch: ObservedStretch, t: Floats, edges: Edges, tick: float, first: int, resolution: float
) -> tuple[ObservedStretch, Floats]:
    """Return a stretch with the edges as further rows, and the time between each edge and the nearest sample [s].

    An edge at the instant of a sample is left out. The timer rounds down, by half a tick in the mean.
    """
    times = t[stretch.first : stretch.first + stretch.drive.step.size + 1]
    inside = (edges.samples > stretch.first) & (edges.samples < stretch.first + times.size)
    instants = edges.instants + 0.5 * tick
    inside &= (instants > t[edges.samples - 1]) & (instants < t[edges.samples])
    instants, samples, lines = instants[inside], edges.samples[inside], edges.lines[inside]
    grid = np.unique(np.r_[times, instants])
    held = np.clip(np.searchsorted(times, grid, side="right") - 1, 0, stretch.drive.step.size - 1)[:-1]
    row = np.r_[np.searchsorted(grid, times)[stretch.drive.row], np.searchsorted(grid, instants)]
    y = np.r_[stretch.y, (lines - first - 0.5) * resolution]
    line = np.r_[np.full(stretch.y.size, -1), lines]
    drive = replace(
        stretch.drive,
        step=np.diff(grid),
        u=np.ascontiguousarray(stretch.drive.u[held]),
        row=row.astype(np.int32),
        columns=np.ascontiguousarray(stretch.drive.columns[:, held]),
    )
    counted = np.r_[np.ones(stretch.y.size, bool), np.zeros(samples.size, bool)]
    rows = np.argsort(row, kind="stable")
    whole = ObservedStretch(
        drive, y, np.full(row.size, 1 / 12), counted, np.zeros(row.size, bool), stretch.first, line.astype(np.intp)
    )
    margin = np.minimum(t[samples] - instants, instants - t[samples - 1])
    return _sort_rows(whole, rows), margin


def _sort_rows(stretch: ObservedStretch, rows: Counts) -> ObservedStretch:
    drive = replace(stretch.drive, row=np.ascontiguousarray(stretch.drive.row[rows]))
    line = None if stretch.line is None else stretch.line[rows]
    return ObservedStretch(
        drive, stretch.y[rows], stretch.variance[rows], stretch.counted[rows], stretch.rest[rows], stretch.first, line
    )


def _typical(fitted: Fitted) -> float:
    """Return the typical standard deviation of an edge without that of its line [counts]."""
    rows = np.concatenate([one.variance[~one.counted] for one in fitted.problem.stretches])
    return float(np.sqrt(np.median(rows)))


def _describe_lines(search: EdgeSearch, lines: int) -> Iterator[str]:
    """Yield a sentence about the line that is furthest from its even place."""
    if not search.spread > EXPLAINED:
        return
    away = search.means - np.mean(search.means)
    worst = int(np.argmax(np.abs(away)))
    yield f"the position error is largest at encoder line {worst} of {lines}: {100 * away[worst]:+.2g} % of a step"

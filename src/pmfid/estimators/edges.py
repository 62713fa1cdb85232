"""Least squares of the simulated motion at the instants of the encoder's edges, off-line."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.adequacy import Adequacy, weigh
from pmfid.estimators.configuration import check_arrays, check_edges, hold_last_input, like
from pmfid.estimators.likelihood import Best
from pmfid.estimators.motion import Difference, invert_information, least, rms
from pmfid.estimators.output_error import Following, IntervalML
from pmfid.estimators.results import Fit
from pmfid.estimators.tuning import TUNING
from pmfid.estimators.uncertainty import block_scatter, scatter
from pmfid.models.equation import ESTIMATE
from pmfid.status import Status
from pmfid.types import Counts, Floats


@dataclass(frozen=True, eq=False)
class Edges:
    """The last edge of each sample. `instants` (m,) are times since the first sample [s], and `lines` (m,) are
    positions in counts."""

    instants: Floats
    lines: Counts


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
    wrong = there & ~((given >= 0) & (given <= step * (1 + TUNING.edges_late)))
    if np.any(wrong):
        row = int(np.argmax(wrong))
        raise UsageError(
            f"the age in row {row + 1} is {given[row]:g} s, but only {step[row]:g} s have passed since "
            "the previous sample. An age is the time from the last edge to the sample; leave it empty or "
            "NaN if it is unknown. If the unit is not s, put it into the name of the column, for example "
            "age_us or age_ticks"
        )
    lines = np.where(change > 0, counts, counts + 1)
    return Edges((t - given)[there], lines[there])


@dataclass(frozen=True)
class EdgeDifference(Difference):
    """A `Difference` at the edges alone, in units of their standard deviations.

    The samples (n,) of `u` and `y` are the instants of the record and of the edges. `at` (m,) has the indices of the
    edges among these samples, and `samples` has the indices of the record. `line` (m,) has the number of each edge's
    line.

    `deviation` (m,) is the standard deviation of each edge [counts]. `spread` is the standard deviation of the lines
    around their even places [counts]. Each line has the same error at all its edges, and the difference is whitened for
    this error (Fuller and Battese 1974).

    All instants may be late by the same time, as those of an interrupt are. `late` (m,) is the effect of such a common
    delay, scaled to length 1. The difference excludes the effect of a common delay.

    `margin` (m,) is the time between an edge and the nearest sample [s], and `age` (m,) the time to the next sample
    [s]. `scatter` is the standard deviation of the instants [s]. `moved` counts the corrected lines.

    With `by_force`, the difference is that of the changes of velocity between edges. A random force makes these changes
    independent, with variances in proportion to the time. The position itself is then a drift that no encoder explains.
    """

    at: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, np.intp))
    line: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, np.intp))
    deviation: Floats = field(default_factory=lambda: np.ones(0))
    spread: float = 0.0
    late: Floats | None = None
    margin: Floats = field(default_factory=lambda: np.zeros(0))
    age: Floats = field(default_factory=lambda: np.zeros(0))
    scatter: float = 0.0
    moved: int = 0
    samples: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, np.intp))
    by_force: bool = False

    @property
    def rows(self) -> int:
        return self.at.size

    @property
    def explained(self) -> float:
        return 0.0

    def filter_signal(self, signal: Floats) -> Floats:
        if not self.by_force:
            return super().filter_signal(signal)
        instants = np.append(0.0, np.cumsum(self.intervals))[self.at]
        step = np.maximum(np.diff(instants), TUNING.edges_apart * self.dt)
        change = np.diff(np.diff(signal) / step)
        return np.concatenate((np.zeros(2), change / np.sqrt(step[1:] + step[:-1])))

    def observe(self, signal: Floats) -> Floats:
        white = self.whiten(self.filter_signal(signal[self.at] / self.resolution))
        return white if self.late is None else white - (white @ self.late) * self.late

    def read_velocity(self, q: Floats) -> Floats:
        return np.asarray(self.motion(q)[1][self.samples])

    def measure_misfit(self, q: Floats) -> float:
        place = self.y[self.at] / self.resolution
        motion = self.filter_signal(place - np.mean(place))
        return rms(self.filter_signal(self.left_at(q))) / max(rms(motion), TUNING.tiny)

    def left_at(self, q: Floats) -> Floats:
        """Return the position of each edge minus the simulated position (m,) [counts], not whitened."""
        return np.asarray((self.y[self.at] - self.motion(q)[0][self.at]) / self.resolution)

    def whiten(self, left: Floats) -> Floats:
        """Return the errors (m,) [counts] of the edges in their standard deviations, without the common error of each
        line.
        """
        z, weight = left / self.deviation, 1 / self.deviation
        if not self.spread:
            return np.asarray(z)
        power = np.bincount(self.line, weight**2)
        mean = np.bincount(self.line, weight * z) / np.where(power > 0, power, 1.0)
        part = 1 - 1 / np.sqrt(1 + self.spread**2 * power)
        return np.asarray(z - (part * mean)[self.line] * weight)

    def with_variances(self, q: Floats) -> EdgeDifference:
        """Return the difference with the variances that its edges show at q (q,).

        The variance of an edge is the variance of its place plus the squared velocity times the variance of its
        instant. The `spread` of the lines is the remaining scatter of the lines' mean errors.
        """
        left, speed = self.left_at(q), self.speed(q)
        count = np.bincount(self.line)

        def mean_of(values: Floats) -> Floats:
            return np.asarray(np.bincount(self.line, values) / np.maximum(count, 1))

        lateness = _ratio(left - mean_of(left)[self.line], speed - mean_of(speed)[self.line])
        left = left - lateness * speed
        mean = mean_of(left)
        within, often = left - mean[self.line], count[self.line] > 1
        shrink = 1 - 1 / np.maximum(count, 2)[self.line]
        squares, columns = within[often] ** 2 / shrink[often], np.c_[np.ones(left.size), speed**2][often]
        place, instant = _fit_variances(squares, columns)
        deviation = np.sqrt(np.maximum(place + instant * speed**2, TUNING.edges_finest**2))
        used = count > 0
        noise = np.mean(np.bincount(self.line, deviation**2)[used] / count[used] ** 2)
        spread = np.sqrt(max(0.0, float(np.var(mean[used])) - float(noise)))
        scatter = float(np.sqrt(instant))
        found = replace(self, deviation=deviation, spread=float(spread), late=None, scatter=scatter)
        if ESTIMATE in (self.equation.dead_time, self.equation.lag):
            return found
        effect = found.whiten(speed)
        size = np.linalg.norm(effect)
        if not size > 0:
            raise NotIdentifiableError("the simulated motion stands still at the edges")
        return replace(found, late=effect / size)

    def speed(self, q: Floats) -> Floats:
        """Return the simulated velocity (m,) at the edges [counts per s] for a constant input around each edge."""
        mean, steps = self.motion(q)[1], np.broadcast_to(self.intervals, self.y.size)
        before, after = steps[self.at - 1], steps[self.at]
        found = (after * mean[self.at - 1] + before * mean[self.at]) / (before + after)
        return np.asarray(found / self.resolution)

    def select(self, kept: NDArray[np.bool_]) -> EdgeDifference:
        """Return the difference at those edges that `kept` (m,) marks."""
        own = {name: getattr(self, name)[kept] for name in ("at", "line", "deviation", "margin", "age")}
        return replace(self, **own, late=None)

    def correct_lines(self, q: Floats, lines: int | None) -> EdgeDifference:
        """Return the difference with the lines that the motion at q (q,) passes.

        If an axis turns within a sample, its last edge may belong to a neighbouring line. After a lost count, all later
        edges belong to other lines. Each wrong line makes a step by a whole count from edge to edge, and no slow drift
        makes such a step. The lines repeat after `lines` counts.
        """
        wrong = np.append(0.0, np.cumsum(np.rint(np.diff(self.left_at(q)))))
        wrong -= np.rint(np.median(wrong))
        y, line = self.y.copy(), self.line - wrong.astype(np.intp)
        y[self.at] -= wrong * self.resolution
        line = line - line.min() if lines is None else line % lines
        return replace(self, y=y, line=line, moved=self.moved + int(np.count_nonzero(np.diff(wrong))))

    def drop_far(self, q: Floats) -> EdgeDifference:
        """Return the difference without the edges that lie far from every line at q (q,)."""
        left = self.left_at(q)
        return self.select(np.abs(left - np.median(left)) < TUNING.edges_between)

    def drop_truncated(self, q: Floats) -> EdgeDifference:
        """Return the difference without the edges whose sample depends on their lateness, at q (q,).

        A late instant may fall into the next sample. Edges close to a sample, and edges almost one step before a
        sample, are the last in their sample only if they are early or late.
        """
        spacing = 1 / np.maximum(np.abs(self.speed(q)), TUNING.tiny)
        margin = np.minimum(self.margin, np.abs(spacing - self.age))
        return self.select(margin >= TUNING.edges_truncated * self.scatter)


def _ratio(values: Floats, columns: Floats) -> float:
    power = float(columns @ columns)
    return float(values @ columns) / power if power > 0 else 0.0


def _fit_variances(squares: Floats, columns: Floats) -> tuple[float, float]:
    """Return two non-negative variances by least squares of the squared errors (k,) on the columns (k, 2)."""
    from scipy.optimize import nnls

    if squares.size == 0:
        return 1.0, 0.0
    place, instant = 0.0, 0.0
    weight = np.ones(squares.size)
    for _ in range(TUNING.edges_passes):  # the variance of a squared error is twice the square of its mean
        place, instant = nnls(columns * weight[:, None], squares * weight)[0].tolist()
        weight = 1 / np.maximum(columns @ [place, instant], TUNING.edges_finest**2)
    return place, instant


@dataclass(frozen=True)
class EdgeFit(Following):
    """Output error at the instants of the encoder's edges, off-line.

    Parameters
    ----------
    model, encoder, dt, cutoff
        See `IV`.
    lines : int, optional
        Counts after which the lines repeat, for example the counts per revolution. None gives each count its own line,
        as on a linear scale.
    tick : float
        Period of the timer that takes the instants [s]. An instant may be late by one period of the timer.
    initial : mapping, optional
        Start values by parameter name.

    Notes
    -----
    At the instant of an edge, only the error of the encoder's line limits the accuracy of the position. `fit` takes the
    age of the last edge in each sample, in addition to the counts. The least squares weigh each edge by the variance of
    the instants and the variance of the lines. Each line has the same error at all its edges.

    If the instants scatter so much that the counts alone make the mass surer, the estimate is the one of `IntervalML`,
    with a note.

    If the errors of the edges are correlated in time, the model leaves out an effect, and the fit has
    `Status.UNMODELLED`.

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
            raise UsageError("EdgeFit needs the age of the last edge of each sample; without ages use IntervalML")
        return self.examine(u, counts, ages)[0]

    def examine(self, u: ArrayLike, counts: ArrayLike, ages: ArrayLike) -> tuple[Fit, Adequacy | None]:
        """Return the estimate of `fit` and the adequacy of the model at the edges. The adequacy is None if the counts
        alone were used."""
        known, whole = check_arrays(u, counts)
        if not np.all(np.isfinite(known)):
            raise UsageError("EdgeFit does not accept gaps in u; split the record at the gap")
        found = self._pass_edges(known, whole, ages)
        if found and np.std(found[0].residual) < TUNING.edges_sharp * self.encoder.resolution:
            return found
        return self._try_counts(known, whole, found)

    def _pass_edges(self, u: Floats, counts: Counts, ages: ArrayLike) -> tuple[Fit, Adequacy] | None:
        """Return the estimate and its adequacy, or None if the simulated motion does not pass the edges."""
        difference, q, status = self._begin_nearer(u, counts, ages)
        drifting: tuple[EdgeDifference, Floats] | None = None
        with suppress(NotIdentifiableError):
            for part in TUNING.edges_slower:
                q = least(replace(difference, pole=part * self.cutoff), q)
                difference = difference.correct_lines(q, self.lines)
                drifting = drifting or (replace(difference, pole=self.cutoff), q)
            near = replace(difference, pole=0.0).drop_far(q)
            dropped = difference.rows - near.rows
            if dropped <= TUNING.edges_most_dropped * difference.rows:
                return self._conclude(*_settle(near, q), status, dropped)
        with suppress(NotIdentifiableError):
            if drifting:
                found, leading = self._conclude(*_fit_forces(*drifting), status, 0), self.equation.leading
                follows = found[0].relative_error < TUNING.edges_followed
                if follows and found[0].theta_std[leading] < found[0].theta[leading]:
                    return found
        return None

    def _try_counts(self, u: Floats, counts: Counts, found: tuple[Fit, Adequacy] | None) -> tuple[Fit, Adequacy | None]:
        """Return the estimate of the counts alone, or `found` if the edges make the mass surer."""
        try:
            fit = like(IntervalML, self).fit(u, counts)
        except NotIdentifiableError:
            if found is None:
                raise
            return found
        if found is None:
            status = int(Status.FALLBACK | Status.UNMODELLED)
            note = "the simulated motion does not pass the edges, so only the counts were used"
        else:
            edges, leading = found[0], self.equation.leading
            unsure = [one.theta_std[leading] / one.theta[leading] for one in (fit, edges)]
            if not unsure[0] < unsure[1]:
                return found
            status, scatter = edges.status, 100 * np.std(edges.residual) / self.encoder.resolution
            note = (
                f"the edges scatter by {scatter:.2g} % of a step, so the counts alone are more precise and "
                "only they were used"
            )
        return replace(fit, status=fit.status | status, notes=(note,)), None

    def _begin_nearer(self, u: Floats, counts: Counts, ages: ArrayLike) -> tuple[EdgeDifference, Floats, int]:
        """Return the difference, the start q (q,) and its status bits.

        The start comes from the counts, or from positions interpolated between the edges, whichever motion is nearer to
        the edges. Counts alone show no mass if the axis hardly moves by a count while it accelerates.
        """
        between = self._start_between(u, counts, ages)
        try:
            starts = (self._start(u, counts), between)
        except NotIdentifiableError:
            if between is None:
                raise
            starts = (between, None)
        found = [(*self._begin(start[0], u, counts, ages), start[1]) for start in starts if start]
        return min(found, key=lambda one: rms(one[0](one[1])))

    def _start_between(self, u: Floats, counts: Counts, ages: ArrayLike) -> tuple[Floats, int] | None:
        """Return the start from positions interpolated between the edges, or None if the positions show no start."""
        steps, parts = self.steps_before(u.size), TUNING.edges_parts
        t = np.append(0.0, np.cumsum(np.full(u.size - 1, self.dt) if steps is None else steps[1:]))
        edges = read_edges(t, counts, ages)
        if not edges.lines.size:
            return None
        between = np.rint(parts * np.interp(t, edges.instants, edges.lines)).astype(np.int64)
        encoder = replace(self.encoder, resolution=self.encoder.resolution / parts)
        try:
            return like(EdgeFit, self, encoder=encoder)._start(u, between)
        except NotIdentifiableError:
            return None

    def _begin(self, theta: Floats, u: Floats, counts: Counts, ages: ArrayLike) -> tuple[EdgeDifference, Floats]:
        """Return the difference at the edges, not yet whitened, and the start value q (q,)."""
        y = self.position(counts)
        own, q = self._prepare_difference(theta, u, y)
        steps = own.intervals if isinstance(own.intervals, np.ndarray) else np.full(u.size, self.dt)
        t = np.append(0.0, np.cumsum(steps[:-1]))
        edges = read_edges(t, counts, ages)
        if edges.lines.size < TUNING.edges_fewest * q.size:
            raise NotIdentifiableError(
                f"the record has {edges.lines.size} edges for {q.size - 2} parameters: record a longer motion"
            )
        instants = edges.instants + 0.5 * self.tick  # the timer rounds down
        grid = np.unique(np.r_[t, instants])
        held = hold_last_input(u)[np.searchsorted(t, grid, side="right") - 1]
        places = edges.lines * self.encoder.resolution
        at = np.searchsorted(grid, instants)
        line = edges.lines - edges.lines.min() if self.lines is None else edges.lines % self.lines
        values = {item.name: getattr(own, item.name) for item in fields(Difference)}
        values |= {"u": held, "y": np.interp(grid, instants, places), "dt": float(grid[-1]) / at.size}
        values["samples"] = np.searchsorted(grid, t)
        values["uneven"] = np.append(np.diff(grid), self.dt)
        after = t[np.searchsorted(t, edges.instants)]
        before = t[np.searchsorted(t, edges.instants) - 1]
        margin = np.minimum(after - edges.instants, edges.instants - before)
        return EdgeDifference(
            **values, at=at, line=line, deviation=np.ones(at.size), margin=margin, age=after - edges.instants
        ), q

    def _conclude(self, difference: EdgeDifference, q: Floats, status: int, dropped: int) -> tuple[Fit, Adequacy]:
        error = difference(q)
        sensitivity = difference.own_sensitivity(q)
        moves = sensitivity @ invert_information(sensitivity, self.names)
        covariance = scatter(moves * error[:, None])
        if difference.equation.shaped or difference.equation.lag:
            change = moves.T @ (difference.finer(q) - error)
            covariance = covariance + np.outer(change, change)
        left = difference.left_at(q)
        correlated = block_scatter(moves * error[:, None]) / np.sum((moves * error[:, None]) ** 2, axis=0)
        steady = np.diagonal(covariance) < (TUNING.edges_exact * q[: len(self.names)]) ** 2
        unlikely = max(dropped / TUNING.edges_few, difference.moved / TUNING.edges_moved) > left.size
        rough = unlikely or difference.by_force or np.std(left) > TUNING.edges_rough
        if rough or np.any((correlated > TUNING.edges_correlated) & ~steady):
            status |= int(Status.UNMODELLED)
        scale = difference.scale[: len(self.names)]
        relative = difference.measure_misfit(q)
        notes = [f"{dropped} edges were left out, because no motion explains them"] if dropped else []
        if difference.by_force:
            notes.append("the position drifts away from the simulated motion, so changes of velocity were fitted")
        if self.lines is not None and difference.spread > TUNING.edges_reported:
            notes.append(_describe_lines(difference, left, self.lines))
        covariance = covariance + np.diag((TUNING.edges_exact * q[: len(self.names)]) ** 2)
        theta, cov = q[: scale.size] * scale, covariance * np.outer(scale, scale)
        left *= self.encoder.resolution
        found = weigh(Best(difference, q, q, None, status))
        if found.missed and np.any(found.spread() > np.sqrt(np.diagonal(cov))[: found.moves.shape[0]]):
            status |= int(Status.UNMODELLED)
        fit = Fit(self.names, self.units, theta, cov, left.size, left, relative, status, notes=tuple(notes))
        return fit, found if rough else replace(found, noise=1.0)  # the edges' noise explains all errors of the motion


def _describe_lines(difference: EdgeDifference, left: Floats, lines: int) -> str:
    """Return a sentence about the line that is furthest from its even place, from the errors `left` (m,) [counts]."""
    count = np.bincount(difference.line, minlength=lines)
    places = np.bincount(difference.line, -left, lines) / np.maximum(count, 1)
    away = np.where(count > 0, places - np.mean(places[count > 0]), 0.0)
    worst = int(np.argmax(np.abs(away)))
    return f"the position error is largest at encoder line {worst} of {lines}: {100 * away[worst]:+.2g} % of a step"


def _fit_forces(difference: EdgeDifference, q: Floats) -> tuple[EdgeDifference, Floats]:
    """Return the difference of the changes of velocity and its least squares q (q,), with the motion amid the edges."""
    pushed = replace(difference, pole=0.0, by_force=True)
    q = least(pushed, q).copy()
    if not pushed.equation.place_matters:
        q[-2] += float(np.mean(pushed.left_at(q))) * pushed.resolution / pushed.scale[-2]
    return pushed, q


def _settle(difference: EdgeDifference, q: Floats) -> tuple[EdgeDifference, Floats]:
    """Return the whitened difference and its least squares q (q,)."""
    repeated = difference.rows / np.unique(difference.line).size
    if repeated > TUNING.edges_repeated:  # each line has its own place until the other errors are known
        q = least(replace(difference, spread=TUNING.edges_free), q)
    for _ in range(TUNING.edges_passes):
        difference = difference.with_variances(q).drop_truncated(q)
        if difference.rows <= q.size:
            raise NotIdentifiableError("too few edges lie far enough from the sample instants: record a longer motion")
        difference = difference.with_variances(q)
        q = least(difference, q)
    return difference, q

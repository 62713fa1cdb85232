"""The fit of a machine to a record with the instants of the encoder's edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import NotIdentifiableError
from pmfid.findings import MOVE
from pmfid.fit.build import build
from pmfid.fit.fit import Fitted, conclude
from pmfid.fit.likelihood import Gaussian
from pmfid.fit.machine import DELAY, LAGGING
from pmfid.fit.openings import begin
from pmfid.fit.problem import FitProblem, ObservedStretch
from pmfid.fit.search import ROUNDS, FitSearch, errors_of
from pmfid.fit.terms import ExtraForce
from pmfid.types import Flags, Floats

#: Smallest standard deviation of an edge [counts], the accuracy of the simulation.
FINEST = 1e-6
#: An edge that is further from every line belongs to no line [counts].
BETWEEN = 0.35
#: Fewest edges of a line with an error of its own, and of a parameter.
FEWEST = 5
#: Edges around an edge, of which `FEWEST` are more than half.
AROUND = 2 * FEWEST - 1
#: An edge within this many standard deviations of its instant from a sample may belong to the neighbouring sample.
TRUNCATED = 4.0


class EdgeSearch(FitSearch):
    """A search whose rows are counts and edges. An edge has the variance of its place [counts^2] plus the squared
    velocity times the variance of its instant, and the error of its line."""

    def __init__(self, problem: FitProblem, lines: int | None, margins: Sequence[Floats]) -> None:
        super().__init__(problem)
        self.lines, self.margins, self.instant = lines, margins, 0.0
        self.dropped, self.means = 0, np.zeros(0)
        self.late: list[int] = []
        if not np.any(problem.machine.lift[[DELAY, LAGGING]]):
            self.table.append(ExtraForce("late_edges", "edges that come late", "", self.sizes.step, late=True))
            self.late.append(len(self.table) - 1)

    @property
    def explains(self) -> bool:
        """Counts that are explained end no search, because the edges show more."""
        return False

    def forget_input(self) -> bool:
        """Keep all observations, which have margins of their own."""
        return False

    def estimate_noise(self, kinds: Sequence[str]) -> Gaussian:
        self.sharpen()
        return super().estimate_noise(kinds)

    def replace_stretches(self, stretches: Sequence[ObservedStretch]) -> None:
        """Replace the rows. The motion stays, whose start is relative to the first row and the mean step."""
        plain = replace(self.plain, stretches=tuple(stretches))
        first = [
            (old.y[0] - new.y[0]) / plain.resolution for old, new in zip(self.plain.stretches, stretches, strict=True)
        ]
        speed = [old / new for old, new in zip(self.plain.scales(), plain.scales(), strict=True)]
        self.starts = self.starts.copy()
        self.starts[:, 1::2] *= np.array(speed)[:, None]
        self.starts[:, 0] += first
        self.plain = plain
        self.problem = replace(self.problem, stretches=self.plain.stretches)

    def sharpen(self) -> None:
        """Estimate the variances of place and instant, and the spread of the lines, from the residuals."""
        motion, stretches = self.problem.motion(self.q, self.starts), self.plain.stretches
        rows = [~one.counted for one in stretches]
        speeds = [v[row] / self.plain.resolution for row, (_, v) in zip(rows, motion, strict=True)]
        errors = [e[row] for row, e in zip(rows, errors_of(self), strict=True)]
        lines = [line_of(one)[row] for row, one in zip(rows, stretches, strict=True)]
        times = [one.times[row] for row, one in zip(rows, stretches, strict=True)]
        self.means, count = line_means(lines, errors)
        inner = [e - self.means[line] for e, line in zip(errors, lines, strict=True)]
        place, self.instant = scatter(inner, speeds, times, [self._freedom(count)[line] for line in lines])
        sharp, noise = [], np.zeros(count.size)
        for row, one, v, line in zip(rows, stretches, speeds, lines, strict=True):
            variance = one.variance.copy()
            variance[row] = np.maximum(place + self.instant * v**2, FINEST**2)
            noise += np.bincount(line, variance[row], count.size)
            sharp.append(replace(one, variance=variance))
        self.spread = _spread(self.means, noise, count)
        self.replace_stretches(sharp)

    @staticmethod
    def _freedom(count: Floats) -> Floats:
        """Return the part (l,) of the variance that is left around the mean of a line."""
        return np.where(count >= FEWEST, 1 - 1 / np.maximum(count, 2), 1.0)

    def correct_lines(self) -> bool:
        """Move the edges to the lines that the motion passes, with the counts after them. Return whether any moved.

        If an axis turns within a sample, its last edge may belong to a neighbouring line. After a lost count, all later
        edges belong to other lines. Each wrong line makes a step by a whole count from edge to edge, and no slow drift
        makes such a step.
        """
        stretches, moved = [], False
        for one, e in zip(self.plain.stretches, errors_of(self), strict=True):
            edges = np.flatnonzero(~one.counted)
            if edges.size:
                wrong = np.cumsum(np.rint(np.diff(e[edges], prepend=e[edges[:1]])))
                wrong -= np.rint(np.median(wrong))
                moved |= bool(np.any(wrong))
                shift = wrong[np.maximum(np.searchsorted(edges, np.arange(one.y.size), side="right") - 1, 0)]
                line = np.where(one.counted, -1, line_of(one) + shift.astype(np.intp))
                one = replace(one, y=one.y + shift * self.plain.resolution, line=line)
            stretches.append(one)
        self.replace_stretches(_number_lines(stretches, self.lines))
        return moved

    def keep_edges(self) -> None:
        """Leave out edges far from the lines of the edges around them, and the counts.

        The rounding of a count between two edges is known, and no noise.
        """
        from scipy.ndimage import median_filter

        kept = []
        for one, e in zip(self.plain.stretches, errors_of(self), strict=True):
            near = ~one.counted
            slow = median_filter(e[near], AROUND, mode="nearest") if np.any(near) else 0.0
            near[~one.counted] = np.abs(e[~one.counted] - slow) < BETWEEN
            self.dropped += int(np.count_nonzero(~near & ~one.counted))
            kept.append(near)
        self.keep(kept)

    def keep(self, kept: Sequence[Flags]) -> None:
        """Keep some of the rows (k,) of each stretch. Raises NotIdentifiableError if no row is left."""
        pairs = list(zip(self.plain.stretches, kept, strict=True))
        self.margins = [m[row[~one.counted]] for m, (one, row) in zip(self.margins, pairs, strict=True)]
        self.margins = [m for m, (_, row) in zip(self.margins, pairs, strict=True) if np.any(row)]
        stretches = [np.any(row) for row in kept]
        if not any(stretches):
            raise NotIdentifiableError(f"no motion of the model passes the edges; {MOVE}")
        if not all(stretches):
            self.starts = self.starts[stretches]
            self.plain = replace(self.plain, stretches=tuple(one for one, row in pairs if np.any(row)))
        self.replace_stretches([one.keep(row) for one, row in pairs if np.any(row)])

    def drop_truncated(self) -> None:
        """Leave out edges whose sample depends on their lateness: a late instant may fall into the next sample."""
        kept = []
        for one, margin in zip(self.plain.stretches, self.margins, strict=True):
            rows = one.counted.copy()
            rows[~one.counted] = margin >= TRUNCATED * np.sqrt(self.instant)
            kept.append(rows)
        self.keep(kept)


def line_of(stretch: ObservedStretch) -> NDArray[np.intp]:
    """Return the numbers (k,) of the lines, -1 for counts."""
    return np.full(stretch.y.size, -1) if stretch.line is None else stretch.line


def _number_lines(stretches: Sequence[ObservedStretch], lines: int | None) -> list[ObservedStretch]:
    """Return the stretches with lines from 0, which repeat after `lines` counts."""
    first = min((int(np.min(line_of(one)[~one.counted], initial=0)) for one in stretches), default=0)
    return [
        replace(
            one,
            line=np.where(one.counted, -1, line_of(one) - first if lines is None else line_of(one) % lines),
        )
        for one in stretches
    ]


def line_means(lines: Sequence[NDArray[np.intp]], errors: Sequence[Floats]) -> tuple[Floats, Floats]:
    """Return the mean error of each line and its number of edges (l,), from the numbers and errors (m,) of the edges.

    The errors that neighbouring edges share are a disturbance that wanders, and no line's. A line with few edges has no
    mean, so that its error belongs to its edges.
    """
    from scipy.ndimage import uniform_filter1d

    line = np.concatenate(lines)
    count = np.bincount(line).astype(np.float64)
    means = np.zeros(count.size)
    for _ in range(4 * ROUNDS):
        left = [e - means[n] for e, n in zip(errors, lines, strict=True)]
        slow = [uniform_filter1d(e, AROUND, mode="nearest") if e.size else e for e in left]
        fast = np.concatenate([e - drift for e, drift in zip(errors, slow, strict=True)])
        means = np.where(count >= FEWEST, np.bincount(line, fast) / np.maximum(count, 1), 0.0)
    return means, count


def _spread(means: Floats, noise: Floats, count: Floats) -> float:
    """Return the standard deviation of the lines, whose means have the variances noise / count^2."""
    used = count >= FEWEST
    if np.count_nonzero(used) < 2:
        return 0.0
    return float(np.sqrt(max(0.0, float(np.var(means[used])) - float(np.mean(noise[used] / count[used] ** 2)))))


def scatter(
    errors: Sequence[Floats], speeds: Sequence[Floats], times: Sequence[Floats], freedom: Sequence[Floats]
) -> tuple[float, float]:
    """Return the variances of the place [counts^2] and of the instant [s^2] of edges.

    Each edge is compared with the line through its neighbours, so that a slow error of the motion adds nothing.
    `freedom` (m,) is the part of the variance that is left of each edge.
    """
    squares, columns = [], []
    for e, v, t, f in zip(errors, speeds, times, freedom, strict=True):
        if e.size < 3:
            continue
        part = (t[1:-1] - t[:-2]) / np.maximum(t[2:] - t[:-2], 1e-300)
        squares.append((e[1:-1] - (1 - part) * e[:-2] - part * e[2:]) ** 2)
        weights = np.array([(1 - part) ** 2 * f[:-2], f[1:-1], part**2 * f[2:]])
        columns.append(np.c_[np.sum(weights, 0), np.sum(weights * np.array([v[:-2], v[1:-1], v[2:]]) ** 2, 0)])
    if not squares:
        return 1 / 12, 0.0
    square, column = np.concatenate(squares), np.concatenate(columns)
    finite = np.isfinite(square) & np.all(np.isfinite(column), axis=1)  # the motion of a wrong force may overflow
    return _fit_variances(square[finite], column[finite]) if np.any(finite) else (1 / 12, 0.0)


def _fit_variances(squares: Floats, columns: Floats) -> tuple[float, float]:
    """Return two non-negative variances by least squares of the squared errors (k,) on the columns (k, 2)."""
    from scipy.optimize import nnls

    place, instant = 0.0, 0.0
    weight = np.ones(squares.size)
    for _ in range(ROUNDS):  # the variance of a squared error is twice the square of its mean
        place, instant = nnls(columns * weight[:, None], squares * weight)[0].tolist()
        weight = 1 / np.maximum(columns @ [place, instant], FINEST**2)
    return place, instant


def fit_edges(problem: FitProblem, lines: int | None, margins: Sequence[Floats]) -> tuple[Fitted, EdgeSearch]:
    """Fit a machine to counts and edges, and return the end of the search.

    `margins` has the time between each edge (m,) of a stretch and the nearest sample [s]. The lines repeat after
    `lines` counts.

    Raises NotIdentifiableError if the axis does not move, or if no motion of the machine passes the edges.
    """
    edges = sum(int(np.count_nonzero(~one.counted)) for one in problem.stretches)
    search = EdgeSearch(problem, lines, margins)
    begin(search)
    for _ in range(ROUNDS):
        if not search.correct_lines():
            break
        search.noise = Gaussian(search.plain.stretches)
        search.solve(search.noise)
    search.keep_edges()
    if 2 * search.dropped > edges:
        raise NotIdentifiableError(f"no motion of the model passes the edges; {MOVE}")
    search.noise = Gaussian(search.plain.stretches)
    search.choose([*search.chosen, *search.late])
    search.solve(search.noise)
    for number in range(ROUNDS):
        search.sharpen()
        if number == ROUNDS // 2:
            search.drop_truncated()
        search.noise = Gaussian(search.plain.stretches, spread=search.spread)
        search.solve(search.noise)
    return conclude(search, build(search)), search

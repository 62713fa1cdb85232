"""Start values of a search, and windows in which the search proceeds."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import NotIdentifiableError
from pmfid.estimators.motion import (
    WHITE,
    Difference,
    divide_sides,
    first_speed,
    least,
    rms,
    simulate_motions,
    sum_travel,
)
from pmfid.estimators.tuning import TUNING
from pmfid.models.equation import Equation
from pmfid.types import Floats

Found = TypeVar("Found")

#: Message for a record that the model does not follow at all.
LOST = (
    "no motion of the model follows the counts from any of many start values: check the columns, "
    "the sign of input_gain and the model, or record reversals and varying speed"
)
#: Filter time constants over which start speeds are read.
WITHIN = (1.0, TUNING.search_read)


def start_samples(dt: float, cutoff: float) -> int:
    """Return the number of samples that determine the start of a free run. `dt` is in [s], and `cutoff` in [rad/s]."""
    return max(2, math.ceil(TUNING.search_read / (cutoff * dt)))


def choose_start(difference: Difference, theta: Floats, cutoff: float, speeds: Sequence[float] = ()) -> Floats:
    """Return q (q,) for scaled parameters (p,), with the nearest of several starts.

    The candidates are the speeds that the counts show within 1 / cutoff [s] and within several times that, and the
    given `speeds`. A search within stiction could not find the speed of a moving axis.
    """
    shown = [first_speed(difference.y, difference.intervals, cutoff / part, difference.resolution) for part in WITHIN]
    places = [np.array([difference.y[0], speed]) / difference.scale[-2:] for speed in dict.fromkeys((*shown, *speeds))]
    starts = np.array([np.concatenate([theta, place]) for place in places])
    return np.asarray(starts[np.argmin([rms(error) for error in difference.differences(starts)])])


def fit_start(difference: Difference, q: Floats) -> Floats:
    """Return q (q,) with the least-squares start and unchanged parameters.

    From rest within stiction a velocity moves nothing. The start velocity therefore counts as known from q, to a few
    counts per filter time constant, as in every error bar.
    """
    prior = np.array([0.0, 1 / difference.start_velocity_std])
    speed, left = q[-1], _weigh_residual(difference, q, q[-1])
    for _ in range(TUNING.search_passes):
        slope = np.r_[WHITE * difference.jacobian(q, first=q.size - 2), prior[None]]
        if not (np.all(np.isfinite(slope)) and np.all(np.isfinite(left))):
            break  # no motion can be simulated with such parameters
        step = np.r_[np.zeros(q.size - 2), np.linalg.lstsq(slope, -left)[0]]
        before = float(left @ left)
        for part in (1.0, TUNING.search_shorter):
            trial = q + part * step
            found = _weigh_residual(difference, trial, speed)
            if float(found @ found) < before:
                q, left = trial, found
                break
        if not float(left @ left) < (1 - TUNING.settled_start) * before:
            break
    return q


def _weigh_residual(difference: Difference, q: Floats, speed: float) -> Floats:
    """Return the residual (n + 1,) of the position and the start velocity `speed`, in their standard deviations."""
    return np.append(WHITE * difference(q), (q[-1] - speed) / difference.start_velocity_std)


def find_least_from_start(
    difference: Difference, q: Floats, cutoff: float, tolerances: Sequence[float] | None = None
) -> Floats:
    """Return `least` from q (q,).

    If a force has a shape, the sum of squares has a minimum for each way to begin the travel. With such a force, the
    search begins at the start that the first samples show. If more remains than the encoder explains, a second search
    begins at q itself. Raises NotIdentifiableError if no search converges.
    """
    if not difference.equation.shaped:
        return least(difference, q, tolerances)
    found, refused = list[Floats](), NotIdentifiableError("no start value leads to a motion that follows the record")
    for begin in (read_start(difference, q, cutoff), q):
        try:
            found.append(least(difference, begin, tolerances))
        except NotIdentifiableError as error:
            refused = error
            continue
        if rms(difference(found[-1])) <= difference.explained:
            break
    if not found:
        raise refused
    return min(found, key=lambda one: rms(difference(one)))


def read_start(difference: Difference, q: Floats, cutoff: float) -> Floats:
    """Return q (q,) with a start from the first samples."""
    direct = replace(difference, pole=0.0)
    first = direct.part(0, min(start_samples(direct.dt, cutoff), direct.y.size))
    return fit_start(first, choose_start(first, q[:-2], cutoff))


def fit_at_speeds(
    usual: float, at: Callable[[float], Found], worse: Callable[[Found], float]
) -> list[tuple[float, Found]]:
    """Return promising Stribeck speeds with their results, the best first. `usual` is the speed of the motion, `at`
    fits with a known Stribeck speed, and `worse` rates a result. Raises NotIdentifiableError if no fit converges."""
    found = list[tuple[float, Found]]()
    refused = NotIdentifiableError("the estimate of the Stribeck speed does not converge: record more slow motion")
    for speed in (usual * np.array(TUNING.stribeck_speeds)).tolist():
        try:
            found.append((speed, at(speed)))
        except NotIdentifiableError as error:
            refused = error
    if not found:
        raise refused
    return sorted(found, key=lambda one: worse(one[1]))[: TUNING.most_speeds]


@dataclass(frozen=True)
class Windows(Difference):
    """A `Difference` over windows of a record, without a high-pass.

    The unknowns q = (theta, x0, v0, x0, v0, ...) / scale are the parameters (p,) and a start for each window. The
    samples are those of all windows in series. `pieces` are the windows, and `firsts` are their first samples in the
    record.
    """

    pieces: tuple[Difference, ...] = ()
    firsts: tuple[int, ...] = ()

    @classmethod
    def cover_stretches(
        cls,
        difference: Difference,
        stretches: Sequence[tuple[int, int]],
        length: int,
        hops: int = TUNING.search_hops,
    ) -> Windows:
        """Return windows of about `length` samples that fill stretches (first, last) of the record, without the sample
        `last`.

        With `hops` 1 the windows follow each other. With `hops` 2 each window begins in the middle of the preceding
        window.
        """
        edges = [edge for stretch in stretches for edge in _covering(*stretch, length, hops)]
        own = {field.name: getattr(difference, field.name) for field in fields(Difference)} | {"pole": 0.0}
        pieces = tuple(Difference(**own).part(first, last) for first, last in edges)
        own["scale"] = np.r_[difference.scale[:-2], np.tile(difference.scale[-2:], len(pieces))]
        return cls(**own, pieces=pieces, firsts=tuple(first for first, _ in edges))

    def start_windows(self, theta: Floats, cutoff: float) -> Floats:
        """Return q (q,) at scaled parameters (p,) with the best start of each window. The search for a start begins at
        the preceding window's speed there, or at the counts' speed within 1 / cutoff [s]."""
        places, speeds, before = [], np.zeros(0), 0
        for part, first in zip(self.pieces, self.firsts, strict=True):
            there = speeds[min(first - before, speeds.size - 1) :][:1].tolist()
            q = fit_start(part, choose_start(part, theta, cutoff, there))
            places.append(q[theta.size :])
            speeds, before = part.motion(q)[1], first
        return np.concatenate([theta, *places])

    def split_windows(self, q: Floats) -> list[tuple[Difference, Floats]]:
        """Return each window with its own part (..., p + 2) of q (..., q)."""
        p = self.parameters
        return [
            (part, np.concatenate([q[..., :p], q[..., p + 2 * k : p + 2 * k + 2]], axis=-1))
            for k, part in enumerate(self.pieces)
        ]

    def _split_rows(self, values: Floats) -> list[Floats]:
        """Split values (..., k n), with k parts per sample, into the values of each window."""
        ends = np.cumsum([part.y.size for part in self.pieces])
        return np.split(values, ends[:-1] * (values.shape[-1] // int(ends[-1])), axis=-1)

    def differences(self, qs: Floats) -> Floats:
        return np.concatenate(self.try_windows(np.array([own for _, own in self.split_windows(qs)])), axis=1)

    def try_windows(self, owns: Floats) -> list[Floats]:
        """Return the differences (m, n) of each window at m rows of its own q, for `owns` (windows, m, p + 2).

        If the input acts at once and the clock is even, motions of many windows are simulated side by side.
        """
        if self.breaks or self.uneven is not None or self.equation.dead_time or self.equation.lag:
            return [part.differences(own) for part, own in zip(self.pieces, owns, strict=True)]
        found = dict[int, Floats]()
        for parts in {part.parts for part in self.pieces}:
            alike = [k for k, part in enumerate(self.pieces) if part.parts == parts]
            size = owns.shape[1] * max(self.pieces[k].y.size for k in alike)
            together = max(1, TUNING.samples_together // size)
            for group in (alike[begin : begin + together] for begin in range(0, len(alike), together)):
                pieces = [self.pieces[k] for k in group]
                found |= zip(group, _differ_together(pieces, owns[group]), strict=True)
        return [found[k] for k in range(len(self.pieces))]

    def jacobians(self, q: Floats, width: float = TUNING.quotient_step) -> list[Floats]:
        """Return the derivatives (n, p + 2) of each window by its own part of q (q,)."""
        trials, apart = zip(*(part.spread_trials(own, width) for part, own in self.split_windows(q)), strict=True)
        return [divide_sides(found, own) for found, own in zip(self.try_windows(np.array(trials)), apart, strict=True)]

    def motions(self, qs: Floats, forces: Floats | None = None) -> tuple[Floats, Floats]:
        own = [None] * len(self.pieces) if forces is None else self._split_rows(forces)
        found = [part.motions(q, force) for (part, q), force in zip(self.split_windows(qs), own, strict=True)]
        position, velocity = zip(*found, strict=True)
        return np.concatenate(position, axis=1), np.concatenate(velocity, axis=1)

    def _join_slopes(self, blocks: Sequence[Floats]) -> Floats:
        """Join the derivatives (n, p + 2) of each window by its own q to one matrix (n, q)."""
        p, begin = self.parameters, 0
        joined = np.zeros((sum(map(len, blocks)), p + 2 * len(blocks)))
        for k, block in enumerate(blocks):
            rows = slice(begin, begin + len(block))
            joined[rows, :p], joined[rows, p + 2 * k : p + 2 * k + 2] = block[:, :p], block[:, p:]
            begin = rows.stop
        return joined

    def jacobian(self, q: Floats, width: float = TUNING.quotient_step, first: int = 0) -> Floats:
        return self._join_slopes(self.jacobians(q, width))[:, first:]

    def forward_jacobian(self, q: Floats, e: Floats, widths: Floats | float = TUNING.quotient_step) -> Floats:
        own, wide = (np.array([own for _, own in self.split_windows(values)]) for values in (q, widths + 0 * q))
        found = self.try_windows(own[:, None, :] + wide[:, None, :] * np.eye(own.shape[1]))
        rows = zip(found, self._split_rows(e), wide, strict=True)
        return self._join_slopes([np.asarray((values - left).T / width) for values, left, width in rows])

    def remove_nuisance(self, columns: Floats, nuisance: Floats, root: Floats | None = None) -> Floats:
        roots = [None] * len(self.pieces) if root is None else self._split_rows(root)
        rows = zip(self.pieces, self._split_rows(columns.T), self._split_rows(nuisance.T), roots, strict=True)
        return np.concatenate(
            [
                part.remove_nuisance(own.T, starts[2 * k : 2 * k + 2].T, weights)
                for k, (part, own, starts, weights) in enumerate(rows)
            ]
        )

    def own_sensitivity(self, q: Floats, root: Floats | None = None, width: float = TUNING.quotient_step) -> Floats:
        """Return the sensitivity of one window after another, because all columns would take much memory."""
        roots = [None] * len(self.pieces) if root is None else self._split_rows(root)
        rows = zip(self.split_windows(q), roots, strict=True)
        return np.concatenate([part.own_sensitivity(own, weights, width) for (part, own), weights in rows])

    def replace_equation(self, equation: Equation, scale: Floats) -> Windows:
        pieces = tuple(part.replace_equation(equation, scale) for part in self.pieces)
        return replace(self, equation=equation, scale=np.r_[scale, self.scale[self.parameters :]], pieces=pieces)

    def fine_at(self, theta: Floats) -> Windows:
        return replace(self, pieces=tuple(part.fine_at(theta) for part in self.pieces))

    @property
    def finer(self) -> Windows:
        return replace(self, pieces=tuple(part.finer for part in self.pieces))

    @property
    def restarts(self) -> bool:
        return True

    @property
    def parameters(self) -> int:
        return self.scale.size - 2 * len(self.pieces)

    def sum_by_sample(self, values: Floats) -> Floats:
        """Return the sums (n, ...) over all windows at each sample of the record."""
        total, begin = np.zeros((self.y.size, *values.shape[1:])), 0
        for part, first in zip(self.pieces, self.firsts, strict=True):
            total[first : first + part.y.size] += values[begin : begin + part.y.size]
            begin += part.y.size
        return total

    @property
    def lower(self) -> Floats:
        return np.concatenate([self.pieces[0].lower[:-2], np.full(2 * len(self.pieces), -np.inf)])

    @property
    def size_of_motion(self) -> float:
        """Root mean square [counts] about the mean of each window, which a start cannot follow."""
        return rms(np.concatenate([part.y - np.mean(part.y) for part in self.pieces]) / self.resolution)


def _differ_together(pieces: Sequence[Difference], owns: Floats) -> list[Floats]:
    """Return the differences (m, n) of windows with equal parts at `owns` (windows, m, p + 2), all simulated at once.
    The input of each window is its force on top of none."""
    first, (count, m, width), n = pieces[0], owns.shape, max(part.y.size for part in pieces)
    inputs = np.zeros((count, n))
    for row, part in zip(inputs, pieces, strict=True):
        row[: part.u.size] = part.u
    values = owns.reshape(-1, width) * first.scale
    starts = values[:, :-3:-1] - np.array([0.0, first.slack])
    thetas, on_top = values[:, :-2], np.repeat(inputs, m, axis=0)
    velocity, _ = simulate_motions(first.equation, thetas, first.dt, np.zeros(n), starts, first.parts, None, on_top)
    position = (values[:, -2:-1] + sum_travel(velocity, first.dt)).reshape(count, m, n)
    return [part.observe(part.y - own[:, : part.y.size]) for part, own in zip(pieces, position, strict=True)]


def is_lost(difference: Difference, q: Floats) -> bool:
    """Return whether the motion at q (q,) from a single start is far from the counts."""
    return not rms(difference(q)) < TUNING.restarts_lost * difference.size_of_motion


def fit_windows(difference: Difference, q: Floats, cutoff: float) -> tuple[Difference, Floats] | None:
    """Return a difference in as few windows as its motion needs, and its least squares (q,), starting from q (q,).

    The result has no high-pass. The function returns None if short windows do not explain the counts. Raises
    NotIdentifiableError if short windows leave most of the motion. If a controller holds an arm where gravity or a
    magnet pulls it away, errors of the simulation grow without bound. Short windows follow this motion (multiple
    shooting: Bock 1981).
    """
    p, coarse = difference.parameters, replace(difference, parts=1)
    counts = [count for count in TUNING.restarts_tried if difference.y.size >= count * TUNING.search_fewest]
    if not counts:
        return None
    found = _fit_in_windows(coarse, q[:-2], cutoff, counts[0], coarse.explained)
    if found.left > coarse.explained and counts[1:]:
        found = _fit_in_windows(coarse, q[:-2], cutoff, counts[-1], coarse.explained)
    if found.lost:
        raise NotIdentifiableError(LOST)
    if found.left > coarse.explained:  # longer windows leave at least as much as the shortest ones
        return None
    for count in counts[1:-1] if len(found.windows.pieces) == counts[-1] > counts[0] else ():
        other = _fit_in_windows(coarse, q[:-2], cutoff, count, coarse.explained)
        if other.left <= coarse.explained:
            found = other
            break
    shortest = found
    while len(found.windows.pieces) > 1:
        count = len(found.windows.pieces) // 2
        enough = _most_left(shortest, count)
        longer = _fit_in_windows(coarse, found.q[:p], cutoff, count, enough)
        if longer.left > enough:
            return found.windows, found.q
        found = longer
    fine = difference.fine_at(found.q[:p] * difference.scale[:p])
    return fine, least(fine, found.q)


@dataclass(frozen=True, eq=False)
class _FitInWindows:
    """Windows, their q (q,), and the root mean square that remains [counts]."""

    windows: Windows
    q: Floats
    left: float

    @property
    def lost(self) -> bool:
        """Whether most of the motion within the windows remains."""
        return self.left > max(TUNING.worst_fit * self.windows.size_of_motion, self.windows.explained)


def _most_left(shortest: _FitInWindows, count: int) -> float:
    """Return the root mean square [counts] that `count` longer windows may leave by chance. Longer windows have fewer
    starts. The limit excludes local minima, at which a sensitive motion nearly explains the counts."""
    freedom = 2 * (len(shortest.windows.pieces) - count)
    squares = freedom + TUNING.restarts_worse * math.sqrt(2 * freedom)
    more = math.sqrt(1 + squares / shortest.windows.y.size)
    return min(shortest.left * more, shortest.windows.explained)


def _fit_in_windows(difference: Difference, theta: Floats, cutoff: float, count: int, enough: float) -> _FitInWindows:
    """Return `count` windows of a record and their least squares, starting from scaled parameters theta (p,). The
    descent ends early if it is too slow to reach `enough` [counts]."""
    n = difference.y.size
    windows = Windows.cover_stretches(difference, [(0, n)], n // count, hops=1)
    windows = windows.fine_at(theta * difference.scale[: theta.size])
    q = descend(windows, windows.start_windows(theta, cutoff), TUNING.search_roughly, n * enough**2)
    return _FitInWindows(windows, q, rms(windows(q)))


def _covering(first: int, last: int, length: int, hops: int) -> list[tuple[int, int]]:
    count = max(1, round((last - first) / length))
    if hops == 1:  # no sample is left out
        return list(pairwise(np.linspace(first, last, count + 1).round().astype(int).tolist()))
    size = (last - first) // count
    begins = np.linspace(first, last - size, hops * (count - 1) + 1).round().astype(int)
    return [(begin, begin + size) for begin in begins.tolist()]


@dataclass(frozen=True)
class _Slope:
    """One window, linearised at its q.

    `left` (n,) is the residual, and `own` (n, p) is the parameters' own effect on the residual. `start` (2,) is the
    start's shift for the residual, and `moves` (2, p) is its shift for a unit of each parameter.
    """

    left: Floats
    own: Floats
    start: Floats
    moves: Floats


def _slope(part: Difference, jacobian: Floats, error: Floats) -> _Slope:
    """Linearise one window with the difference `error` (n,) and its derivatives `jacobian` (n, p + 2)."""
    effects, nuisance = np.column_stack([error, jacobian[:, :-2]]), jacobian[:, -2:]
    prior = np.array([[0.0, 1 / part.start_velocity_std]])
    targets = np.r_[WHITE * effects, np.zeros((1, effects.shape[1]))]
    moves = np.linalg.lstsq(np.r_[WHITE * nuisance, prior], targets)[0]
    apart = effects - nuisance @ moves
    return _Slope(apart[:, 0], apart[:, 1:], moves[:, 0], moves[:, 1:])


def descend(
    windows: Windows, q: Floats, settled: float = TUNING.settled_descent, enough: float | None = None
) -> Floats:
    """Return the least squares from q (q,) by damped Gauss-Newton steps, with the starts eliminated window by window.

    A step that would take a parameter below its bound leaves the parameter at the bound. A descent that is too slow to
    reach the sum of squares `enough` ends early.
    """
    low, p, damping = windows.lower, windows.parameters, 1e-3
    errors = [found[0] for found in windows.try_windows(np.array([[own] for _, own in windows.split_windows(q)]))]
    costs, slopes = [sum(map(_cost, errors))], _slopes(windows, q, errors)
    while len(costs) <= TUNING.max_steps and not (enough and _is_too_slow(costs, enough)):
        theta = np.maximum(q[:p] + _step(slopes, damping, q[:p] <= low[:p]), low[:p])
        trial, errors = _move_starts(windows, q, theta, slopes)
        cost, found = costs[-1], sum(map(_cost, errors))
        costs.append(min(cost, found))
        if found < cost:
            q, damping = trial, damping / 10
            if 1 - found / cost < settled:
                break
            slopes = _slopes(windows, q, errors)
        elif damping > TUNING.max_damping:
            break
        else:
            damping *= 10
    return q


def _is_too_slow(costs: Sequence[float], enough: float) -> bool:
    """Return whether a descent at the present pace misses the sum of squares `enough` within the remaining steps."""
    watched = TUNING.steps_watched
    if len(costs) <= watched or not enough < costs[-1] < np.inf:
        return False
    pace = math.log(costs[-1 - watched] / costs[-1]) / watched
    return pace * (TUNING.max_steps + 1 - len(costs)) < math.log(costs[-1] / enough)


def _slopes(windows: Windows, q: Floats, errors: Sequence[Floats]) -> list[_Slope]:
    return [_slope(*row) for row in zip(windows.pieces, windows.jacobians(q), errors, strict=True)]


def _move_starts(windows: Windows, q: Floats, theta: Floats, slopes: Sequence[_Slope]) -> tuple[Floats, list[Floats]]:
    """Return q for other parameters (p,), and the difference of each window.

    Each start moves as the linear model says, or stays. A start within stiction moves nothing until it moves much, and
    one such window must not stop all others.
    """
    trials, change = list[Floats](), theta - q[: theta.size]
    for (_, own), slope in zip(windows.split_windows(q), slopes, strict=True):
        along = slope.moves @ change
        moved = own[-2:] - np.array([slope.start + along, along, 0.0 * along])
        trials.append(np.column_stack([np.tile(theta, (3, 1)), moved]))
    places, errors = list[Floats](), list[Floats]()
    for own, found in zip(trials, windows.try_windows(np.array(trials)), strict=True):
        best = int(np.argmin([_cost(error) for error in found]))
        places.append(own[best, -2:])
        errors.append(found[best])
    return np.concatenate([theta, *places]), errors


def _step(slopes: Sequence[_Slope], damping: float, bound: NDArray[np.bool_]) -> Floats:
    """Return the step of the parameters (p,). A parameter at its bound only moves away from it."""
    normal = np.sum([slope.own.T @ slope.own for slope in slopes], axis=0)
    downhill = -np.sum([slope.own.T @ slope.left for slope in slopes], axis=0)
    free = ~(bound & (downhill < 0))
    normal = normal + damping * np.diag(np.maximum(np.diagonal(normal), TUNING.tiny))
    step = np.zeros(free.size)
    step[free] = np.linalg.solve(normal[np.ix_(free, free)], downhill[free])
    return step


def _cost(left: Floats) -> float:
    """Return the sum of squares, infinite after an excessive step."""
    with np.errstate(over="ignore", invalid="ignore"):
        total = float(left @ left)
    return total if total < np.inf else np.inf


@dataclass(frozen=True)
class WindowChoice:
    """The chosen window length.

    `samples` and `seconds` are the length of a window. `errors` has, for each tried length [s], the error of free runs
    over unfitted parts [unit of the resolution]. A length of infinity means the whole record. The error is the
    geometric mean of the root mean squares in one piece and in several.
    """

    samples: int
    seconds: float
    errors: dict[float, float]

    @property
    def says(self) -> str:
        """The reason in words."""
        chosen = "one window over the whole record" if math.isinf(self.seconds) else f"windows of {self.seconds:.3g} s"
        if len(self.errors) < 2:
            return f"{chosen}: the record is too short to choose their length from it"
        best = {length: error for length, error in self.errors.items() if length != self.seconds}
        other = min(best, key=lambda length: best[length])
        named = "one window" if math.isinf(other) else f"windows of {other:.3g} s"
        others = (
            f"by {best[other]:.3g} with {named}"
            if best[other] < math.inf
            else "windows of other lengths give no estimate"
        )
        return (
            f"{chosen}, chosen on this record: free runs over each third with the estimate of the other two are off by "
            f"{self.errors[self.seconds]:.3g}, {others}"
        )


def choose_window(difference: Difference, theta: Floats, cutoff: float) -> WindowChoice:
    """Return the window length for a difference without a high-pass, from scaled parameters (p,)."""
    n, dt = difference.y.size, difference.dt
    shortest = max(TUNING.search_fewest, math.ceil(TUNING.search_shortest / (cutoff * dt)))
    lengths = [n, *_halves(n * (TUNING.search_folds - 1) // TUNING.search_folds // 2, shortest)]
    errors = {_seconds(k, n, dt): predicted_elsewhere(difference, theta, cutoff, k) for k in lengths}
    best = min(errors.values())
    samples = next((length for length in lengths if errors[_seconds(length, n, dt)] <= (1 + TUNING.as_well) * best), n)
    return WindowChoice(samples, _seconds(samples, n, dt), errors)


def _seconds(length: int, n: int, dt: float) -> float:
    return math.inf if length >= n else length * dt


def _halves(length: int, shortest: int) -> Iterator[int]:
    while length >= shortest:
        yield length
        length //= 2


def predicted_elsewhere(difference: Difference, theta: Floats, cutoff: float, length: int) -> float:
    """Return the geometric mean error of free runs over unfitted parts of the record [unit of the resolution].

    Each part and each length of the runs has the same weight, even if one is hard to predict. The error is infinite if
    no estimate exists or if half of the motion remains.
    """
    n, logs = difference.y.size, []
    edges = np.linspace(0, n, TUNING.search_folds + 1).round().astype(int).tolist()
    for first, last in pairwise(edges):
        rest = [(a, b) for a, b in ((0, first), (last, n)) if b - a >= TUNING.search_fewest]
        try:
            windows = Windows.cover_stretches(difference, rest, length)
            q = descend(windows, windows.start_windows(theta, cutoff), TUNING.search_roughly)
        except (NotIdentifiableError, np.linalg.LinAlgError):
            return math.inf
        if not rms(windows(q)) < max(TUNING.worst_fit * windows.size_of_motion, windows.explained):
            return math.inf
        part, found = difference.part(first, last), q[: theta.size]
        logs += [_log_error(part, found, cutoff, pieces) for pieces in _pieces(part, cutoff)]
    return math.exp(float(np.mean(logs))) * difference.resolution


def _pieces(part: Difference, cutoff: float) -> list[int]:
    least = TUNING.search_worth * start_samples(part.dt, cutoff)
    return [count for count in TUNING.search_pieces if count == 1 or part.y.size // count >= least]


def _log_error(part: Difference, theta: Floats, cutoff: float, pieces: int) -> float:
    """Return the logarithm of the root mean square error [counts] of runs over the pieces of a part."""
    edges = np.linspace(0, part.y.size, pieces + 1).round().astype(int).tolist()
    runs = [free_run(part.part(first, last), theta, cutoff) for first, last in pairwise(edges)]
    left = rms(np.concatenate(runs))
    return math.log(max(left, TUNING.encoder_alone)) if left < math.inf else math.inf


def free_run(part: Difference, theta: Floats, cutoff: float) -> Floats:
    """Return the difference (n,) [counts] at scaled parameters (p,) with a start from the first samples."""
    read = part.part(0, min(start_samples(part.dt, cutoff), part.y.size))
    return part(fit_start(read, choose_start(read, theta, cutoff)))

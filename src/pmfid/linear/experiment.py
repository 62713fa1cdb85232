"""Records of a linear process, and exact propagation between their samples."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Real
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pmfid._stage import follow_states
from pmfid.errors import UsageError, check_choice
from pmfid.linear.tuning import TUNING
from pmfid.presentation import Presentable, Summary, plain
from pmfid.types import Floats


@dataclass(frozen=True)
class Grid:
    """The instants of one uninterrupted stretch of a record. `steps` (N-1,) are the times between neighbouring
    instants, or one number for equal steps. `size` is the number N of instants."""

    steps: Floats | float
    size: int

    @property
    def uniform(self) -> bool:
        return isinstance(self.steps, float)

    @property
    def duration(self) -> float:
        """The time from the first instant to the last."""
        return float(np.sum(self.steps)) * (self.size - 1 if self.uniform else 1)

    @property
    def instants(self) -> Floats:
        """The instants (N,), starting at 0."""
        steps = np.full(self.size - 1, self.steps) if isinstance(self.steps, float) else self.steps
        return np.concatenate([[0.0], np.cumsum(steps)])

    @property
    def reversed(self) -> Grid:
        """Return the grid in reverse order."""
        return Grid(self.steps if isinstance(self.steps, float) else self.steps[::-1], self.size)


@dataclass(frozen=True)
class Transition:
    """The transition x[k+1] = phi x[k] + now w[k] + change (w[k+1] - w[k]). On a uniform grid, the arrays belong to
    every step. On an uneven grid, the arrays hold one entry for each step."""

    phi: Floats
    now: Floats
    change: Floats


def transition(F: Floats, g: Floats, grid: Grid) -> Transition:
    """Return the exact transition for F (n, n), g (n,) and a signal w that is linear between instants. If w is held,
    its change is 0."""
    from scipy.linalg import expm  # slow to import

    n = F.shape[0]
    steps = np.atleast_1d(np.asarray(grid.steps, float))
    distinct, back = np.unique(steps, return_inverse=True)
    whole = np.zeros((distinct.size, n + 2, n + 2))
    whole[:, :n, :n] = F * distinct[:, None, None]
    whole[:, :n, n] = g * distinct[:, None]
    whole[:, n, n + 1] = 1.0
    found = expm(whole[0]) if grid.uniform else _exponential(whole)[back.ravel()]
    return Transition(found[..., :n, :n], found[..., :n, n], found[..., :n, n + 1])


def respond(F: Floats, g: Floats, grid: Grid, w: Floats, start: Floats, *, held: bool) -> Floats:
    """Return the states (n, channels, N) for the signals w (channels, N) and the initial states (n, channels).

    If `held`, w is constant within a step. The states are NaN if a step of the process exceeds the range of numbers, as
    for a very poor estimate.
    """
    step = transition(F, g, grid)
    if not np.all(np.isfinite(step.phi)):
        return np.full((*start.shape, w.shape[1]), np.nan)
    n, change = F.shape[0], np.zeros(step.now.shape) if held else step.change
    return follow_states(step.phi.reshape(-1, n, n), step.now.reshape(-1, n), change.reshape(-1, n), w, start)


def _exponential(matrices: Floats) -> Floats:
    """Return the exponential of each of the matrices (k, n, n) by scaling, series and squaring. The function of SciPy
    processes the matrices one by one."""
    size = float(np.max(np.sum(np.abs(matrices), axis=-1)))
    squarings = max(0, int(np.ceil(np.log2(max(size, 1e-300) / TUNING.series_norm))))
    scaled = matrices / 2.0**squarings
    unit = np.eye(matrices.shape[-1])
    result = unit + scaled / TUNING.series_terms
    for term in range(TUNING.series_terms - 1, 0, -1):
        result = unit + scaled @ result / term
    for _ in range(squarings):
        result = result @ result
    return np.asarray(result)


Hold = Literal["zoh", "foh"]
HOLDS: tuple[Hold, ...] = get_args(Hold)


@dataclass(frozen=True, eq=False, repr=False)
class Experiment(Presentable):
    """One record of a process.

    Parameters
    ----------
    u, y : array_like (N,)
        Input and output at the same instants. A missing y is NaN. An unknown u is NaN and ends a stretch.
    dt : float
        Sample period [s]. Either dt or t is needed.
    t : array_like (N,)
        Rising instants [s] with any spacing.
    hold : {"zoh", "foh"}
        The input keeps its value until the next instant, or follows a straight line to the next instant.
    gap : float, optional
        A longer step [s] separates two stretches with unknown initial conditions. By default 1.75 median steps.
    reference : array_like (N,), optional
        The set point of a controller, which does not correlate with the noise. In closed loop, the instruments come
        from the set point.
    name : str

    Raises
    ------
    UsageError
        The arrays contradict each other, the time does not rise, or both dt and t are missing.

    Examples
    --------
    >>> from pmfid import Experiment
    >>> Experiment([0.0, 1.0, 1.0], [0.0, 0.0, 0.3], t=[0.0, 0.1, 0.25]).times
    array([0.  , 0.1 , 0.25])
    """

    u: Floats
    y: Floats
    dt: float | None = None
    t: Floats | None = None
    hold: Hold = "zoh"
    gap: float | None = None
    reference: Floats | None = None
    name: str = "record"

    def __post_init__(self) -> None:
        u, y = _numbers("u", self.u), _numbers("y", self.y)
        if u.ndim != 1 or u.shape != y.shape or u.size < 2:
            raise UsageError(f"u and y must be two arrays of the same length, got {u.shape} and {y.shape}")
        if np.any(np.isinf(u)) or np.any(np.isinf(y)):
            raise UsageError("u or y is infinite somewhere; write NaN where a sample is missing")
        check_choice("hold", self.hold, HOLDS)
        if self.gap is not None and not (isinstance(self.gap, Real) and self.gap > 0):
            raise UsageError(f"gap must be a positive time in s, or None for 1.75 median steps, got {self.gap!r}")
        if (self.dt is None) == (self.t is None):
            raise UsageError("dt and t exclude each other; give either the sample period dt in s, or the instants t")
        object.__setattr__(self, "u", u)
        object.__setattr__(self, "y", y)
        self._check_time(u.size)
        if self.reference is not None:
            reference = _numbers("reference", self.reference)
            if reference.shape != u.shape or not np.all(np.isfinite(reference)):
                raise UsageError(f"reference must be finite and as long as u, got shape {reference.shape}")
            object.__setattr__(self, "reference", reference)

    def _check_time(self, size: int) -> None:
        if self.t is None:
            if not (isinstance(self.dt, Real) and math.isfinite(self.dt) and self.dt > 0):
                raise UsageError(f"dt must be positive and finite, got {self.dt!r}; give the sample period in s")
            return
        t = _numbers("t", self.t)
        if t.shape != (size,):
            raise UsageError(f"t must be as long as u, got shape {t.shape}")
        _check_rising(t)
        object.__setattr__(self, "t", t)

    def summary(self) -> Summary:
        span = f"{self.times[-1] - self.times[0]:.4g} s, about {self.period:.4g} s apart"
        title = f"{self.name}: {self.u.size} samples over {span}, {self.hold}"
        signals = {
            key: values for key, values in self.columns().items() if key != "t" and isinstance(values, np.ndarray)
        }
        rows = [(key, *_range(values), str(np.count_nonzero(~np.isfinite(values)))) for key, values in signals.items()]
        lines = [f"{key} from {low} to {high}" + f", {gone} missing" * (gone != "0") for key, low, high, gone in rows]
        return Summary(title, ("signal", "lowest", "highest", "missing"), rows, lines)

    def columns(self) -> dict[str, object]:
        """Return the columns of a table with one row for each sample."""
        found: dict[str, object] = {"t": self.times, "u": self.u, "y": self.y}
        return found if self.reference is None else found | {"reference": self.reference}

    def to_dict(self) -> dict[str, object]:
        """Return the settings, and lists over the samples."""
        own = {"name": self.name, "hold": self.hold, "gap": self.gap, "dt": self.dt}
        return {key: plain(value) for key, value in (own | self.columns()).items()}

    def cut(self, samples: int) -> Experiment:
        """Return at most a number of samples, from the first change of the input on."""
        first = int(np.argmax(self.u != self.u[0]))
        first = max(0, min(first - 1, self.u.size - samples))
        kept = slice(first, first + samples)
        t, reference = (None if column is None else column[kept] for column in (self.t, self.reference))
        return replace(self, u=self.u[kept], y=self.y[kept], t=t, reference=reference)

    @cached_property
    def times(self) -> Floats:
        """The instants (N,) [s]."""
        return np.asarray(np.arange(self.u.size) * (self.dt or 1.0)) if self.t is None else self.t

    @cached_property
    def period(self) -> float:
        """The median step [s], or the mean step if the spacing is even up to rounding."""
        steps = np.diff(self.times)
        median = float(np.median(steps))
        mean = float(np.mean(steps))
        even = self.times[0] + mean * np.arange(self.times.size)
        return mean if np.max(np.abs(self.times - even)) < TUNING.experiment_even * mean else median

    @cached_property
    def explained_input(self) -> Floats | None:
        """The part of the input (N,) that an impulse response from the reference explains (Van den Hof and Schrama
        1993).

        The signal resembles the input without the noise that the controller feeds back. Schwarz's criterion selects the
        length of the impulse response, because each further coefficient restores some of the noise.
        """
        if self.reference is None:
            return None
        known = np.isfinite(self.u)
        reference = self.reference * _shrinking(self.reference)  # the impulse response grows by the same factor
        length = max(1, min(TUNING.experiment_response, self.u.size // TUNING.samples_per_coefficient))
        lagged = np.lib.stride_tricks.sliding_window_view(np.r_[np.zeros(length - 1), reference], length)
        columns = np.column_stack([np.ones(self.u.size), lagged[:, ::-1]])  # the latest input comes first
        kept = _count_columns(columns[known], self.u[known])
        response = np.linalg.lstsq(columns[known, :kept], self.u[known], rcond=None)[0]
        return np.asarray(columns[:, :kept] @ response)

    def stretches(self, delay: int = 0) -> list[RecordStretch]:
        """Return the uninterrupted parts, with an input that is `delay` periods late. Parts without a measured output
        are left out."""
        u, t = self.u, self.times
        limit = TUNING.experiment_gap * self.period if self.gap is None else self.gap
        known = np.isfinite(u)
        broken = np.flatnonzero(~known[:-1] | (np.diff(t) > limit)) + 1
        parts = []
        for part in np.split(np.arange(u.size), broken):
            # The output at the first instant without an input still counts, unless the input changes linearly up to
            # that instant.
            part = part[known[part]] if self.hold == "foh" else part
            if part.size and known[part[0]]:
                parts.append(self._stretch(part, delay))
        return [part for part in parts if part is not None and part.rows.size > 1]

    def _stretch(self, part: NDArray[np.int64], delay: int) -> RecordStretch | None:
        u, y, t = self.u[part], self.y[part], self.times[part]
        reference = None if self.explained_input is None else self.explained_input[part]
        held = self.hold == "zoh"
        measured = np.isfinite(y)
        if part.size < delay + 2 or not np.any(measured[delay:]):
            return None
        even = t[0] + self.period * np.arange(t.size)
        if np.max(np.abs(t - even)) < TUNING.experiment_even * self.period:
            filled = np.interp(even, even[measured], y[measured])
            cut = slice(None, u.size - delay)
            rows = np.flatnonzero(measured[delay:])
            grid = Grid(self.period, u.size - delay)
            inputs = [u[cut]] + ([] if reference is None else [reference[cut]])
            return RecordStretch(grid, np.array(_finite(inputs)), filled[delay:], rows, part[delay:][rows], held)
        return self._uneven(part, t, u, y, reference, delay, held)

    def _uneven(
        self,
        part: NDArray[np.int64],
        t: Floats,
        u: Floats,
        y: Floats,
        reference: Floats | None,
        delay: int,
        held: bool,
    ) -> RecordStretch | None:
        """Return a stretch whose grid has the instants of the output and the instants at which the late input
        changes.
        """
        measured = np.isfinite(y)
        late = t + delay * self.period
        inside = (t >= late[0] - TUNING.experiment_same) & (t <= late[-1])
        merged = np.union1d(t[inside], late[late <= t[-1]])
        grid_t = merged[np.r_[True, np.diff(merged) > TUNING.experiment_same * self.period]]
        rows_of = np.searchsorted(grid_t, t - TUNING.experiment_same * self.period)
        rows = np.flatnonzero(measured & inside & (rows_of < grid_t.size))
        if grid_t.size < 2 or rows.size < 2:
            return None
        filled = np.interp(grid_t, t[measured], y[measured])
        signals = _finite([u] + ([] if reference is None else [reference]))
        if held:
            index = np.searchsorted(late, grid_t + TUNING.experiment_same * self.period, side="right") - 1
            inputs = [signal[index] for signal in signals]
        else:
            inputs = [np.interp(grid_t, late, signal) for signal in signals]
        return RecordStretch(
            Grid(np.diff(grid_t), grid_t.size), np.array(inputs), filled, rows_of[rows], part[rows], held
        )


def _range(values: Floats) -> tuple[str, str]:
    known = values[np.isfinite(values)]
    return (f"{known.min():.4g}", f"{known.max():.4g}") if known.size else ("unknown", "unknown")


def _shrinking(signal: Floats) -> float:
    """Return a power of two that scales a signal to about one, so that its squares are finite floats."""
    largest = float(np.max(np.abs(signal), initial=0.0))
    return math.ldexp(1.0, -min(max(math.frexp(largest)[1], -1000), 1000))


def _count_columns(columns: Floats, target: Floats) -> int:
    """Return how many of the first columns (N, p) explain the target (N,) best by Schwarz's criterion, at least two."""
    target = target * _shrinking(target)
    size = np.linalg.norm(columns, axis=0)
    Q, _ = np.linalg.qr(columns / np.where(size > 0, size, 1.0))
    left = float(target @ target) - np.cumsum((Q.T @ target) ** 2)
    floor = np.finfo(float).eps * float(target @ target) + 1e-300
    criterion = target.size * np.log(np.maximum(left, floor)) + np.arange(1, left.size + 1) * np.log(target.size)
    return 2 + int(np.argmin(criterion[1:]))


def _numbers(name: str, values: object) -> Floats:
    """Return a copy as float64."""
    try:
        if values is not None and np.asarray(values).dtype.kind in "biufO":
            return np.array(np.ma.filled(np.ma.asarray(values, float), np.nan))  # masked values are missing
    except (TypeError, ValueError):
        pass
    raise UsageError(f"{name} must be an array of numbers, NaN where one is missing")


def _check_rising(t: Floats) -> None:
    """Raise UsageError for instants (N,) that are missing, repeated or out of order, with the row counted from 1."""
    missing = np.flatnonzero(~np.isfinite(t))
    if missing.size:
        rows = f"{missing.size} row{'s' * (missing.size > 1)}"
        raise UsageError(
            f"t is missing, NaN or infinite in {rows}, first in row {missing[0] + 1}; leave out all rows without a time"
        )
    back = np.flatnonzero(np.diff(t) <= 0)
    if back.size:
        k = int(back[0])
        what = "a duplicate; drop one of the two rows, or write t with more digits" if t[k + 1] == t[k] else "sort them"
        raise UsageError(f"t does not rise: row {k + 2} ({t[k + 1]:.9g}) follows {t[k]:.9g}: {what}")


@dataclass(frozen=True, eq=False)
class RecordStretch:
    """An uninterrupted part of a record on a grid of M instants.

    `inputs` (1 or 2, M) holds the late input and, with a reference, the part of the input that the reference explains.
    The output y (M,) follows a straight line between measured instants. `rows` are the numbers of the measured instants
    on the grid, and `samples` are their numbers in the record. `held` says whether the input is constant within a step.
    `record` is the number of the record.
    """

    grid: Grid
    inputs: Floats
    y: Floats
    rows: NDArray[np.int64]
    samples: NDArray[np.int64]
    held: bool
    record: int = 0

    def scale_time(self, rate: float) -> RecordStretch:
        """Return the stretch with time in units of 1/rate."""
        return replace(self, grid=Grid(self.grid.steps * rate, self.grid.size))


def _finite(signals: list[Floats]) -> list[Floats]:
    """Return the signals with zeros in place of unknown values. Only the last value of a stretch may be unknown, and no
    sample follows it."""
    return [np.where(np.isfinite(signal), signal, 0.0) for signal in signals]

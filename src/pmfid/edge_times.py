"""The instants at which a motion passes the lines of an encoder."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import UsageError
from pmfid.types import Counts, Floats


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Instants `t` (n,) [s], positions `x` (n,) and velocities `v` (n,) of a motion.

    Between the instants, the position is the cubic of both positions and velocities.
    """

    t: Floats
    x: Floats
    v: Floats

    @classmethod
    def sample(cls, x: Floats, dt: float) -> Trajectory:
        """Return the trajectory through positions x (n,) at every dt [s]. Its velocities are central differences."""
        change: Floats = np.diff(x) / dt
        v = np.r_[change[:1], 0.5 * (change[1:] + change[:-1]), change[-1:]]
        return cls(np.asarray(dt * np.arange(x.size)), x, v)

    def interpolate(self, k: NDArray[np.intp], part: Floats) -> Floats:
        """Return the position at a part in [0, 1] of the intervals k (m,), by Hermite's cubic."""
        x, v = self.x, self.v
        travel, step = x[k + 1] - x[k], self.t[k + 1] - self.t[k]
        bend = step * (v[k] * (1.0 - part) - v[k + 1] * part) + travel * (2.0 * part - 1.0)
        return np.asarray(x[k] + part * travel + part * (1.0 - part) * bend)


@dataclass(frozen=True, eq=False)
class Lattice:
    """The lines of an encoder: `step` per count, position `phase` at the start, and repeating `errors` of the lines."""

    step: float
    phase: float
    errors: Floats

    def place(self, numbers: Counts) -> Floats:
        """Return the positions of lines from their numbers in counts."""
        return np.asarray(numbers * self.step - self.phase + self.errors[numbers % self.errors.size])

    def count(self, x: Floats) -> Counts:
        """Return the counts (n,) at positions x (n,)."""
        counts = np.floor((x + self.phase) / self.step).astype(np.int64)
        counts -= x < self.place(counts)
        counts += x >= self.place(counts + 1)
        return counts


def sample_edges(
    instants: ArrayLike, counts: ArrayLike, dt: float, samples: int, start: float = 0.0
) -> tuple[Counts, Floats]:
    """Turn a list of edges into the counts and the age of the last edge of each sample.

    Parameters
    ----------
    instants : array_like (m,)
        Rising instants of the edges [s], as a timer captures them.
    counts : array_like (m,)
        Counts after each edge.
    dt : float
        Sample period [s].
    samples : int
        Number of samples n.
    start : float
        Instant of the first sample [s], by the same clock.

    Returns
    -------
    counts, ages : ndarray (n,)
        Counts of each sample, and the time from the last edge to it [s], NaN without an edge since the sample before.
        Samples before the first edge have its counts.

    Raises
    ------
    UsageError
        The lists are empty or differ in length, or the instants are not finite and rising.

    Examples
    --------
    >>> from pmfid import sample_edges
    >>> counts, ages = sample_edges([0.004, 0.013, 0.018], [5, 6, 7], dt=0.01, samples=4)
    >>> counts.tolist(), ages.round(3).tolist()
    ([5, 5, 7, 7], [nan, 0.006, 0.002, nan])
    """
    t, known = np.asarray(instants, np.float64), np.asarray(counts, np.int64)
    if t.ndim != 1 or t.shape != known.shape or not t.size:
        raise UsageError(f"instants and counts must be lists (m,) of the same edges, got {t.shape} and {known.shape}")
    wrong = ~np.isfinite(t) | (np.diff(t, prepend=-np.inf) < 0)
    if np.any(wrong):
        row = int(np.argmax(wrong))
        what = "is before the previous edge; sort the edges" if np.isfinite(t[row]) else "is not finite; drop this edge"
        raise UsageError(f"the instant {t[row]:g} s of edge {row} {what}")
    now = start + dt * np.arange(samples)
    last = np.searchsorted(t, now, "right") - 1
    fresh = np.diff(last, prepend=-1) > 0
    fresh[:1] &= last[:1] >= 0
    ages = np.where(fresh, now - t[np.maximum(last, 0)], np.nan)
    ages[:1] = np.where(ages[:1] <= dt, ages[:1], np.nan)
    return known[np.maximum(last, 0)], ages


def read_edge_times(path: Trajectory, lines: Lattice, every: int = 1, tick: float = 0.0) -> tuple[Counts, Floats]:
    """Return the counts of each sample, and the age of the last edge in each sample [s].

    A sample is each `every`-th instant of the path. `tick` is the period of the timer [s]; 0 means no ticks. An age is
    NaN without an edge since the previous sample.
    """
    counts = lines.count(path.x)
    instants = _find_edges(path, counts, lines)
    samples = np.arange(0, counts.size, every)
    latest = np.maximum.accumulate(np.where(np.isnan(instants), -np.inf, instants))[samples]
    now = path.t[samples]
    in_sample = latest > np.concatenate(([-np.inf], now[:-1]))
    ages = np.full(samples.size, np.nan)
    if tick:
        whole = (1.0 + 4.0 * np.finfo(np.float64).eps) / tick  # a sample at a whole tick is not a rounding before it
        now, latest = (tick * np.floor(t * whole) for t in (now, latest))
    ages[in_sample] = now[in_sample] - latest[in_sample]
    return counts[samples], ages


def _find_edges(path: Trajectory, counts: Counts, lines: Lattice) -> Floats:
    """Return the instant [s] of the last edge in the interval before each instant of the path (n,), or NaN without an
    edge."""
    change = np.diff(counts)
    k = np.flatnonzero(change)
    line = lines.place(np.where(change[k] > 0, counts[k + 1], counts[k + 1] + 1))
    side = np.sign(change[k])
    low, high = np.zeros(k.size), np.ones(k.size)
    for _ in range(np.finfo(np.float64).nmant + 1):  # halvings, until the width is below the resolution of a double
        middle = 0.5 * (low + high)
        before = side * (path.interpolate(k, middle) - line) < 0.0
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    instants = np.full(counts.size, np.nan)
    instants[k + 1] = path.t[k] + high * (path.t[k + 1] - path.t[k])
    return instants

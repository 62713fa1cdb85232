"""The segments of one axis as a series: estimates with standard errors, their mean, and their scatter beyond the
standard errors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pmfid.status import Status
from pmfid.types import Flags, Floats

if TYPE_CHECKING:
    import polars as pl

#: An estimate with one of these at its end says nothing.
UNUSABLE = int(Status.STARTING | Status.SETTLING | Status.POOR_EXCITATION | Status.COMPENSATION_HELD | Status.RESET)
#: Bits of a segment that are no `Status`: it moved forward or backward alone, where a load looks like friction; its
#: input had one size alone, where saturation or a dead zone looks like another force per input; it had a second look,
#: by which an unmodelled force may move it.
FORWARD, BACKWARD, ONE_SIZE, LOOKED_AT, MOVED = 1 << 31, 1 << 30, 1 << 29, 1 << 28, 1 << 27
#: Batches whose means show what lasts, at least.
BATCHES = 4
#: Standard deviations that segments are known to be too sure or unsure by, at least: of few, their own word counts.
LEAST_NOISE, FEW = 0.7, 20
#: Segments that tell what they share, at least.
LEAST_SHARED = 4
#: Median of the absolute value of a normal number, in standard deviations.
MEDIAN = 0.6745


@dataclass(frozen=True)
class Series:
    """n segments with p parameters. start, end: (n,) [s]; samples: (n,); lost: (n,) part filled in; dt: (n,) [s];
    status: (n,); theta, std: (n, p)."""

    start: Floats
    end: Floats
    samples: NDArray[np.int64]
    lost: Floats
    dt: Floats
    status: NDArray[np.uint32]
    theta: Floats
    std: Floats

    def __getitem__(self, kept: Flags | slice) -> Series:
        return Series(*(getattr(self, name)[kept] for name in self.__dataclass_fields__))

    @property
    def usable(self) -> Flags:
        """(n,) which segments count: of those that say something the ones in which the equation holds, if they are
        most. A change within a segment, or a bad start, makes it another one."""
        clean = self.known & ((self.status & int(Status.UNMODELLED)) == 0)
        return clean if 2 * np.count_nonzero(clean) > np.count_nonzero(self.known) else self.known

    @property
    def known(self) -> Flags:
        """(n,) segments with a usable estimate: by the method itself if there are any, else by its fallback, whose
        standard errors are less reliable."""
        known = ((self.status & UNUSABLE) == 0) & np.all(np.isfinite(self.std) & (self.std > 0), axis=1)
        own = known & ((self.status & int(Status.FALLBACK)) == 0)
        return np.asarray(own if np.any(own) else known, bool)


def series_of(rows: pl.DataFrame, names: tuple[str, ...]) -> Series:
    """Of the segments of one axis, in the order of time."""
    theta, std = (np.stack([rows[name + end].to_numpy() for name in names], axis=1) for end in ("", "_std"))
    start, end, lost, dt = (rows[name].to_numpy() for name in ("start", "end", "lost", "dt"))
    return Series(start, end, rows["samples"].to_numpy(), lost, dt, rows["status"].to_numpy(), theta, std)


def widen_errors(series: Series) -> Series:
    """The series with standard errors widened by the scatter between neighbouring usable segments (n, p) beyond them.
    All segments share this scatter, so no segment with too small a standard error dominates (random effects;
    DerSimonian and Laird, 1986, with medians, which a few steps do not move)."""
    used = series[series.usable]
    if used.start.size < LEAST_SHARED:
        return series
    apart = np.median(np.abs(np.diff(used.theta, axis=0)), axis=0) / MEDIAN
    known = np.median(used.std[1:] ** 2 + used.std[:-1] ** 2, axis=0)
    shared = np.sqrt(np.maximum(apart**2 - known, 0.0) / 2)
    return replace(series, std=np.hypot(series.std, shared))


def mean_of(series: Series) -> tuple[Floats, Floats]:
    """Weighted mean (p,) and its standard deviation: by the standard errors, or by the scatter of batches of segments,
    weighted or not, if this is larger. NaN and infinite without segments."""
    p = series.theta.shape[1]
    if not series.start.size:
        return np.full(p, np.nan), np.full(p, np.inf)
    weight = 1 / series.std**2
    total = weight.sum(axis=0)
    mean = (weight * series.theta).sum(axis=0) / total
    std = total**-0.5
    by_errors = std * np.maximum(1.0, lasting((series.theta - mean) / series.std))
    alike = lasting(series.theta - mean) / np.sqrt(series.start.size)
    return mean, np.maximum(by_errors, alike)


def lasting(apart: Floats) -> Floats:
    """(p,): root mean square of deviations (n, p), as inferred from means of batches for independent segments; the
    largest over all lengths with several batches."""
    found, size = np.zeros(apart.shape[1]), 1
    while apart.shape[0] // size >= BATCHES:
        many = apart.shape[0] // size
        means = apart[-many * size :].reshape(many, size, -1).mean(axis=1)
        found = np.maximum(found, np.sqrt(size * np.mean(means**2, axis=0)))
        size *= 2
    return found


def noise_of(series: Series) -> Floats:
    """(p,): differences of neighbours, relative to their standard errors; not moved by a few steps."""
    stds = np.hypot(series.std[1:], series.std[:-1])
    found = np.median(np.abs(np.diff(series.theta, axis=0)) / stds, axis=0) / MEDIAN
    return np.maximum(found, LEAST_NOISE if len(stds) >= FEW else 1.0)

"""Estimates over time, and their periods."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import polars as pl
from numpy.typing import NDArray

from pmfid.fleet.missing_forces import ModelError, model_error
from pmfid.fleet.source import SECONDS, TEMPERATURE, seconds
from pmfid.fleet.tuning import TUNING
from pmfid.records.outliers import NORMAL_MEDIAN
from pmfid.status import Status
from pmfid.types import Flags, Floats

#: An estimate with one of these bits at its end is not used.
UNUSABLE = int(Status.STARTING | Status.SETTLING | Status.POOR_EXCITATION | Status.COMPENSATION_HELD | Status.RESET)
#: Bits of a segment beyond `Status`. The first two mean motion in only one direction, where a load looks like friction.
#: The third means an input of only one size, where saturation or a dead zone looks like another force per input.
FORWARD, BACKWARD, ONE_SIZE = 1 << 31, 1 << 30, 1 << 29
#: Column of the forces that the model of a segment may lack.
FORCES = "missing forces"


@dataclass(frozen=True)
class Series:
    """The n segments of an axis with p parameters.

    `start`, `end` and `dt` (n,) are in s. `samples` is (n,). `lost` (n,) is the imputed part of the samples. `status`
    is (n,), and `theta` and `std` are (n, p). `temperature` (n,) is that of each segment, if
    the friction follows one. `forces` (n, k, 2 + p) are those that the model may lack, NaN for most segments.
    """

    start: Floats
    end: Floats
    samples: NDArray[np.int64]
    lost: Floats
    dt: Floats
    status: NDArray[np.uint32]
    theta: Floats
    std: Floats
    temperature: Floats | None = None
    forces: Floats | None = None

    def __getitem__(self, kept: Flags | slice) -> Series:
        if not isinstance(kept, slice) and kept.all():
            return self

        def cut(column: Any) -> Any:
            return None if column is None else column[kept]

        return Series(*(cut(getattr(self, name)) for name in self.__dataclass_fields__))

    @cached_property
    def usable(self) -> Flags:
        """The segments that count, as flags (n,).

        A usable segment counts if its equation holds. If segments with a valid equation are a minority, all usable
        segments count. The equation fails in a segment with a change or a bad start.
        """
        clean = self.known & ((self.status & int(Status.UNMODELLED)) == 0)
        return clean if 2 * np.count_nonzero(clean) > np.count_nonzero(self.known) else self.known

    @cached_property
    def model_error(self) -> ModelError:
        """The error of the parameters by forces that the model may lack. All segments share this error."""
        p = self.theta.shape[1]
        if self.forces is None or not self.forces.size:
            return ModelError(np.zeros(p), np.zeros(p))
        return model_error(self.forces[np.isfinite(self.forces).all(axis=(1, 2))], p)

    @cached_property
    def known(self) -> Flags:
        """The segments with a usable estimate, as flags (n,).

        An estimate must come from the method itself if such estimates exist, otherwise from the fallback. The standard
        errors of a fallback are less reliable.
        """
        known = ((self.status & UNUSABLE) == 0) & np.all(np.isfinite(self.std) & (self.std > 0), axis=1)
        own = known & ((self.status & int(Status.FALLBACK)) == 0)
        return np.asarray(own if np.any(own) else known, bool)


def series_of(rows: pl.DataFrame, names: tuple[str, ...]) -> Series:
    """Return the series of one axis' segments, in the order of time."""
    theta, std = (np.stack([rows[name + end].to_numpy() for name in names], axis=1) for end in ("", "_std"))
    start, end, lost, dt = (rows[name].to_numpy() for name in ("start", "end", "lost", "dt"))
    status = rows["status"].to_numpy().astype(np.uint32)
    warm = rows[TEMPERATURE].to_numpy()
    temperature = warm if np.all(np.isfinite(warm)) else None
    whole = start, end, rows["samples"].to_numpy(), lost, dt, status, theta, std, temperature
    return Series(*whole, _forces_of(rows[FORCES], len(names)))


def _forces_of(column: pl.Series, p: int) -> Floats:
    """Return the forces (n, k, 2 + p) of all segments, NaN where the segment was not searched."""
    values = column.to_list()
    size = max((len(one) for one in values if one is not None), default=0)
    forces = np.full((len(values), size), np.nan)
    for k, one in enumerate(values):
        if one is not None:
            forces[k] = one
    return forces.reshape(len(values), -1, 2 + p) if size else forces.reshape(len(values), 0, 2 + p)


def widen_errors(series: Series) -> Series:
    """Return the series with standard errors widened by the excess scatter of neighbouring usable segments (n, p).

    All segments share this scatter, so no segment with too small a standard error dominates. The method is random
    effects (DerSimonian and Laird, 1986), with medians, which a few steps do not move.
    """
    used = series[series.usable]
    if used.start.size < TUNING.series_batches:
        return series
    apart = np.median(np.abs(np.diff(used.theta, axis=0)), axis=0) / NORMAL_MEDIAN
    known = np.median(used.std[1:] ** 2 + used.std[:-1] ** 2, axis=0)
    shared = np.sqrt(np.maximum(apart**2 - known, 0.0) / 2)
    return replace(series, std=np.hypot(series.std, shared))


def mean_of(series: Series) -> tuple[Floats, Floats]:
    """Return the weighted mean (p,) and its standard deviation, NaN and infinite without segments.

    The standard deviation comes from the standard errors, or from the scatter of batches of segments, weighted or not,
    if this is larger.
    """
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
    """Return the root mean square (p,) of deviations (n, p), from means of batches, as for independent segments.

    The result is the largest value over all lengths of a batch with several batches.
    """
    found, size = np.zeros(apart.shape[1]), 1
    while apart.shape[0] // size >= TUNING.series_batches:
        many = apart.shape[0] // size
        # `np.mean` takes longer than these few numbers.
        means = np.add.reduce(apart[-many * size :].reshape(many, size, -1), axis=1) / size
        found = np.maximum(found, np.sqrt(size * (np.add.reduce(means**2, axis=0) / many)))
        size *= 2
    return found


def noise_of(series: Series) -> Floats:
    """Return the differences of neighbours (p,) relative to their standard errors, which a few steps do not move."""
    stds = np.hypot(series.std[1:], series.std[:-1])
    found = np.median(np.abs(np.diff(series.theta, axis=0)) / stds, axis=0) / NORMAL_MEDIAN
    return np.maximum(found, TUNING.least_noise if len(stds) >= TUNING.series_few else 1.0)


#: Length and start of the named periods [s].
NAMED = {"day": (SECONDS["d"], 0.0), "shift": (8 * SECONDS["h"], 6 * SECONDS["h"])}
#: Status bits that a period reports if at least half of its segments have them.
REPORTED = (Status.FALLBACK, Status.UNMODELLED, Status.FEEDBACK, Status.DEAD_TIME)
#: Findings with which an error may exceed the standard error. A period with a change has two true values.
DOUBT = {"missing", "changed", "one_way", "one_size", *(str(bit.name).lower() for bit in REPORTED)}
#: Number and part of the segments with a status bit from which the bit belongs to the axis, not to a time. A right
#: model is unmodelled in one of fifty segments, and late or under feedback in up to one of ten. A change affects one or
#: two more segments.
SEVERAL, SHARE = 3, {Status.UNMODELLED: 0.1, Status.DEAD_TIME: 0.25, Status.FEEDBACK: 0.25, Status.FALLBACK: 0.5}


@dataclass(frozen=True)
class Periods:
    """The periods of a history.

    `name` is the user's name of the periods. `length` and `start` are in s. The length is None for runs.
    """

    name: str
    length: float | None
    start: float = 0.0

    @classmethod
    def from_name(cls, name: str) -> Self:
        """Return the periods by their name, which is "day", "shift" (8 hours from 06:00), "run", or a duration.

        Raises UsageError for any other name.
        """
        if name == "run":
            return cls(name, None)
        return cls(name, *NAMED[name]) if name in NAMED else cls(name, seconds(name))

    def numbers(self, series: Series, segment: float) -> NDArray[np.int64]:
        """Return the number (n,) of the period of each segment. `segment` is the length of a segment [s]."""
        if self.length is None:
            pauses = series.start[1:] - series.end[:-1] > max(TUNING.settings_segment, segment)
            return np.concatenate([[0], np.cumsum(pauses)]).astype(np.int64)[: series.start.size]
        middle = (series.start + series.end) / 2
        return np.floor((middle - self.start) / self.length).astype(np.int64)

    def begin(self, number: int, first: float) -> float:
        """Return the begin of a period [s]. `first` is the time of its first sample."""
        return first if self.length is None else self.start + number * self.length


def period_rows(
    axis: str,
    kind: str,
    series: Series,
    names: Sequence[str],
    periods: Periods,
    segment: float,
    codes: Collection[tuple[float, str]],
) -> Iterator[dict[str, object]]:
    """Yield a row for each period of an axis.

    `kind` is the type of the axis. `codes` has times [s] and names of findings in its rows.
    """
    numbers, always, error = periods.numbers(series, segment), standing(series), series.model_error.std
    for number in np.unique(numbers):
        part = series[numbers == number]
        begin = periods.begin(int(number), float(part.start[0]))
        end = float(part.end[-1]) if periods.length is None else begin + periods.length
        own = always | {code for at, code in codes if not at < begin and at < end}
        yield _row(axis, kind, part, names, begin, own, error)


def _row(
    axis: str, kind: str, part: Series, names: Sequence[str], begin: float, codes: set[str], error: Floats
) -> dict[str, object]:
    used = part[part.usable]
    theta, std = mean_of(used)
    std = np.hypot(std, error)
    lost = float(np.average(part.lost, weights=part.samples))
    findings = codes | codes_of(part)
    row: dict[str, object] = {"axis": axis, "type": kind, "period": begin}
    row |= {"first": float(part.start[0]), "last": float(part.end[-1]), "samples": int(part.samples.sum())}
    row |= {"segments": int(used.start.size), "lost": lost, "dt": float(np.median(part.dt))}
    for i, name in enumerate(names):
        row |= {name: float(theta[i]), f"{name}_std": float(std[i])}
    return row | {"quality": quality_of(int(used.start.size), findings), "findings": " ".join(sorted(findings))}


def quality_of(segments: int, codes: Collection[str]) -> str:
    """Return the quality of an estimate from a number of usable segments with these findings."""
    return "none" if not segments else "doubt" if DOUBT.intersection(codes) else "good"


def standing(series: Series) -> set[str]:
    """Return the findings of a whole axis. A wrong equation shows by chance, and only in some moves."""
    used = series[series.known]
    many = {bit: np.count_nonzero(used.status & int(bit)) for bit in REPORTED}
    which = (bit for bit in REPORTED if many[bit] >= max(SEVERAL, SHARE[bit] * used.start.size))
    names = {str(bit.name).lower() for bit in which} | ({"one_way"} if _uneven(used) else set())
    moved = series.model_error.likely > TUNING.model_tolerance * np.abs(mean_of(used)[0])
    return names | ({"unmodelled"} if np.any(moved) else set())


def _uneven(used: Series) -> bool:
    """Return whether only one direction exists, or segments of one direction contradict those of the other, as with a
    load.
    """
    for bit in (FORWARD, BACKWARD):
        own = (used.status & bit) != 0
        if np.all(own) and own.size:
            return True
        if np.any(own):
            (one, std), (rest, other) = mean_of(used[own]), mean_of(used[~own])
            apart = np.abs(one - rest)
            if np.any(
                (apart > TUNING.series_agrees * np.hypot(std, other)) & (apart > TUNING.model_tolerance * np.abs(rest))
            ):
                return True
    return False


def codes_of(part: Series) -> set[str]:
    """Return the findings of some segments."""
    used = part[part.usable]
    found = {"missing"} if np.average(part.lost, weights=part.samples) > TUNING.series_lost else set()
    if np.ptp(part.dt) > TUNING.series_same * np.max(part.dt):
        found.add("mixed_dt")
    many = {bit: np.count_nonzero(used.status & int(bit)) for bit in REPORTED}
    found |= {str(bit.name).lower() for bit in REPORTED if many[bit] and 2 * many[bit] >= used.start.size}
    found |= {"one_size"} if np.all(part.status & ONE_SIZE) else set()
    if not used.start.size:
        occurred = int(np.bitwise_or.reduce(part.status))
        found |= {str(bit.name).lower() for bit in Status if bit & occurred}
    return found

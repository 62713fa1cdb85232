"""A series of estimates, one number for each visit to a machine: its steps and drifts, in both directions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from pmfid.errors import UsageError, did_you_mean
from pmfid.fleet.changes import levels_of, partition_series, trend_of, weigh_against_wander
from pmfid.fleet.series import Series, mean_of, noise_of, widen_errors
from pmfid.fleet.source import SECONDS, seconds_of
from pmfid.fleet.tuning import TUNING
from pmfid.fleet.verdicts import CHANGED, DRIFTS, AxisVerdict, chance_limit, follow_axis, sentence, visible_step
from pmfid.io.reading import read_table
from pmfid.types import Floats

#: The limits are those of a fleet of this many axes: chance names one of a hundred series.
AS_MANY = 30


@dataclass(frozen=True)
class Visits:
    """Values (n,) of one parameter at rising times (n,) [s], and their standard errors (n,), or None if unknown."""

    name: str
    time: Floats
    values: Floats
    std: Floats | None = None

    @property
    def can_tell(self) -> bool:
        """Return whether there are enough visits, and values that differ, to separate a change from scatter."""
        return self.values.size >= TUNING.verdicts_sure and bool(np.ptp(self.values))


def read_visits(path: Path, column: str | None) -> Visits:
    """Read a table whose first column is the time, as a number of seconds or a date.

    `column` names the values, by default the second column. The column NAME_std has their standard errors, if it is
    there. Rows without a time or a value are left out. Raises UsageError for a table without these columns or rows.
    """
    frame = pl.DataFrame(dict(read_table(path)))
    if frame.width < 2:
        raise UsageError(f"{path}: one column alone is no series; give the time in the first column, then the values")
    first, name = frame.columns[0], column or frame.columns[1]
    if name not in frame.columns[1:]:
        known = frame.columns[1:]
        raise UsageError(
            f"{path} has no column {name!r}; its columns are {', '.join(known)}{did_you_mean(name, known)}"
        )
    std = f"{name}_std" if f"{name}_std" in frame.columns else None
    numbers = {"value": pl.col(name), "std": pl.col(std) if std else pl.lit(0.0)}
    read = [one.cast(pl.Float64, strict=False).alias(key) for key, one in numbers.items()]
    rows = frame.select(seconds_of(pl.col(first), first, frame.schema[first], 1.0).alias("time"), *read)
    rows = rows.filter(pl.all_horizontal(pl.all().is_finite())).sort("time")
    if not rows.height or rows["time"].n_unique() < rows.height:
        what = "repeats a time" if rows.height else "has no row with a time and a number"
        raise UsageError(f"{path} {what}; give one row for each visit, with its time or date first")
    return Visits(name, rows["time"].to_numpy(), rows["value"].to_numpy(), rows["std"].to_numpy() if std else None)


def find_changes(visits: Visits, tolerance: float) -> list[AxisVerdict]:
    """Return the steps, or the drift, of a series. `tolerance` is a relative change that does not count.

    Steps and drift count if they explain more than chance, and more than a random walk.
    """
    if not visits.can_tell:
        return []
    series, names, n = _series(visits), (visits.name,), visits.values.size
    trend = trend_of(series, names, tolerance)
    assert trend is not None  # there are enough visits
    limit = chance_limit(AS_MANY * n, n - 2)
    places = partition_series(series.theta, series.std * noise_of(series), limit**2)
    steps = [_measure(visits, series, *ends) for ends in zip([0, *places], places, [*places[1:], n], strict=False)]
    level = levels_of(series.theta, series.std, places)[:, 0]
    shapes = np.stack([level, visits.time - visits.time[0]], axis=1)
    stepped, drifted = weigh_against_wander(series.theta, series.std, shapes - shapes.mean(axis=0))
    misfit = float(np.sum((visits.values - level) ** 2 / series.std[:, 0] ** 2))
    clear = [one for one in steps if abs(one.size) - tolerance > limit * one.std]
    by_steps = misfit + len(places) * limit**2 * float(noise_of(series)[0]) ** 2
    if clear and stepped > limit * np.sqrt(len(places)) and (by_steps < trend.misfit or drifted < limit):
        return clear
    days = trend.span / SECONDS["d"]
    line = chance_limit(AS_MANY, n - 2)
    if min(trend.score, drifted) > line:
        return [AxisVerdict(DRIFTS, trend.score / line, trend.cause, trend.size / days, trend.std / days, days=days)]
    return []


def _measure(visits: Visits, series: Series, first: int, place: int, end: int) -> AxisVerdict:
    """Return the step at `place`, between the parts of a series from `first` and to `end`."""
    (old, before), (new, after) = (mean_of(series[slice(*part)]) for part in ((first, place), (place, end)))
    noise = float(noise_of(series)[0])
    size, std = float((new - old)[0] / abs(old[0])), noise * float(np.hypot(before, after)[0] / abs(old[0]))
    return AxisVerdict(
        CHANGED, abs(size) / std, visits.name, size, std, float(visits.time[place - 1]), float(visits.time[place])
    )


def describe_changes(visits: Visits, tolerance: float) -> Iterator[dict[str, object]]:
    """Yield the changes as plain objects with a sentence each, and at the end what the series can show."""
    for one in find_changes(visits, tolerance):
        text = sentence(one).replace("all friction", "friction")
        size = {"size": one.size, "std": one.std} | (
            {"since": one.since, "until": one.until} if one.kind == CHANGED else {}
        )
        yield {"event": one.kind, "parameter": visits.name, **size, "text": text}
    least = np.inf
    if visits.can_tell:
        whole = follow_axis("", "", _series(visits), (visits.name,), tolerance)
        least = visible_step(whole, AS_MANY, tolerance)
    can = np.isfinite(least)
    text = (
        f"{visits.values.size} visits: a step of {100 * least:.2g} % in their middle would be found"
        if can
        else f"{visits.values.size} visits cannot show a change: {TUNING.verdicts_sure} or more with different values "
        "are needed"
    )
    yield {"event": "end", "visits": visits.values.size, "visible": float(least) if can else None, "text": text}


def _series(visits: Visits) -> Series:
    n = visits.values.size
    noise = np.abs(np.diff(visits.values)).max(initial=0.0) if n else 0.0
    std = np.full(n, max(1e-6 * noise, np.finfo(float).tiny)) if visits.std is None else visits.std
    whole, nothing = np.ones(n, np.int64), np.zeros(n)
    time, theta = visits.time, visits.values[:, None]
    return widen_errors(Series(time, time, whole, nothing, np.ones(n), nothing.astype(np.uint32), theta, std[:, None]))

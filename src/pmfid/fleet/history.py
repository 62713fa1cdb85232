"""The history of a fleet, from a data set of any size to verdicts and estimates for each axis and period."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from pmfid.config.axis import Axis, AxisSections, read_axis
from pmfid.durable import replace_file
from pmfid.errors import UsageError, printable
from pmfid.fleet.evaluate import Work, longest_tables, split_results
from pmfid.fleet.local import Files, Progress
from pmfid.fleet.series import Periods, Series, period_rows, series_of, widen_errors
from pmfid.fleet.settings import Settings, choose, make_settings
from pmfid.fleet.source import AXIS, RESULTS, SECONDS, TYPE, SourceColumns, SparkFrame, is_spark, parts_of
from pmfid.fleet.survey import HOUR, ROWS, RowProblem
from pmfid.fleet.tuning import TUNING
from pmfid.fleet.verdicts import (
    CHANGED,
    UNKNOWN,
    AxisVerdict,
    Follow,
    follow_axis,
    judge_axes,
    ranking,
    sentence,
    sorts_by_type,
)
from pmfid.fleet.warmth import remove_warmth
from pmfid.io.tables import Frame
from pmfid.presentation import plain_dict

#: Finding for an axis in which a step of this relative size may go unnoticed.
LITTLE, SOUGHT = "little_information", 0.1

if TYPE_CHECKING:
    from pmfid.fleet.spark import SparkRows


def _report_mixed_periods(axis: str, series: Series) -> list[RowProblem]:
    """Return a problem for an axis whose sample period changes."""
    low, high = float(series.dt.min()), float(series.dt.max())
    if high - low <= TUNING.series_same * high:
        return []
    at = float(series.start[np.flatnonzero(series.dt != series.dt[0])[0]])
    text = (
        f"the sample period changes between {low:.6g} and {high:.6g} s: each stretch is estimated with its own period"
    )
    return [RowProblem(axis, "", "mixed_dt", text, at)]


def _sorts(follows: Sequence[Follow], names: Sequence[str], tolerance: float) -> list[RowProblem]:
    """Return a problem for each type that contains several kinds of machines."""
    found = []
    for kind, sorts in sorts_by_type(follows, tolerance).items():
        if len(sorts) > 1:
            middles = np.array([np.median([follows[k].theta for k in members], axis=0) for members in sorts])
            least = np.maximum(np.abs(middles).min(axis=0), np.finfo(float).tiny)
            i = int(np.argmax(np.ptp(middles, axis=0) / least))
            each = ", ".join(
                f"{len(own)} around {middle:.3g}" for own, middle in zip(sorts, middles[:, i], strict=True)
            )
            text = (
                f"{len(sorts)} kinds of machines differ in {names[i].replace('_', ' ')}: {each}; each axis is "
                "compared only with its own kind: give each kind its own type, with --type"
            )
            found.append(RowProblem("", f"type {kind}" if kind else "all axes", "several_sorts", text))
    return found


def _nothing(
    axes: Sequence[str], types: Mapping[str, str], codes: Mapping[str, set[tuple[float, str]]]
) -> list[dict[str, object]]:
    """Return a row for each axis without any estimate, so that no axis is missing in the result."""
    return [
        {
            "axis": axis,
            "type": types[axis],
            "period": min((at for at, _ in codes[axis] if math.isfinite(at)), default=math.nan),
            "samples": 0,
            "segments": 0,
            "quality": "none",
            "findings": " ".join(sorted({code for _, code in codes[axis]})),
        }
        for axis in axes
    ]


def _period_schema(names: Sequence[str]) -> dict[str, pl.DataType]:
    kinds: dict[str, pl.DataType] = {"axis": pl.String(), "type": pl.String(), "period": pl.Float64()}
    kinds |= {"first": pl.Float64(), "last": pl.Float64(), "samples": pl.Int64(), "segments": pl.Int64()}
    kinds |= {"lost": pl.Float64(), "dt": pl.Float64()}
    for name in names:
        kinds |= {name: pl.Float64(), f"{name}_std": pl.Float64()}
    return kinds | {"quality": pl.String(), "findings": pl.String()}


def _axes(follows: Sequence[Follow], verdicts: Sequence[AxisVerdict], names: Sequence[str]) -> pl.DataFrame:
    """Return a table of the axes, where axes with need of attention come first."""
    rows = []
    for k in ranking(verdicts):
        one, verdict = follows[k], verdicts[k]
        row: dict[str, object] = {"axis": one.axis, "type": one.type, "named": verdict.named, "kind": verdict.kind}
        row |= {"score": verdict.score, "cause": verdict.cause, "size": verdict.size, "std": verdict.std}
        row |= {"since": verdict.since, "until": verdict.until, "why": sentence(verdict), "segments": one.segments}
        codes = one.codes | ({LITTLE} if not verdict.visible < SOUGHT else set())
        row |= {"quality": one.quality, "findings": " ".join(sorted(codes)), "visible": verdict.visible}
        whole = np.hypot(one.std, one.error)
        for i, name in enumerate(names):
            deviation = float(verdict.deviation[i]) if verdict.deviation.size else math.nan
            changed = math.nan if one.step is None else float(one.step.relative[i])
            row |= {name: float(one.theta[i]), f"{name}_std": float(whole[i])}
            row |= {f"{name}_deviation": deviation, f"{name}_change": changed}
            slope, std = (math.nan, math.nan) if one.trend is None else (one.trend.slopes[i], one.trend.stds[i])
            row |= {f"{name}_slope": float(slope) * SECONDS["d"], f"{name}_slope_std": float(std) * SECONDS["d"]}
        rows.append(row)
    return pl.DataFrame(rows, infer_schema_length=None)


def _problems(problems: Sequence[RowProblem]) -> pl.DataFrame:
    """Return each kind of problem once for an axis or a file, with its number and its first time."""
    found: dict[tuple[str, str, str], list[RowProblem]] = defaultdict(list)
    for problem in problems:
        found[problem.axis, problem.part, problem.code].append(problem)
    rows = []
    for (axis, part, code), group in sorted(found.items()):
        first = min(group, key=lambda one: (math.inf if math.isnan(one.at) else one.at, one.text))
        rows.append(
            {"axis": axis, "file": part, "code": code, "times": len(group), "from": first.at, "text": first.text}
        )
    kinds = {"axis": pl.String, "file": pl.String, "code": pl.String, "times": pl.Int64, "from": pl.Float64}
    return pl.DataFrame(rows, schema=kinds | {"text": pl.String})


@dataclass(frozen=True)
class History:
    """The history of a fleet.

    `periods` has a row for each axis and period. `axes` has a row for each axis, where axes with need of attention come
    first. `problems` has the unusable rows and files, with reasons. `names` and `units` belong to the parameters.
    `samples` is the number of samples in the estimates. `segment` is the length of one estimate [s].
    """

    periods: pl.DataFrame
    axes: pl.DataFrame
    problems: pl.DataFrame
    names: tuple[str, ...]
    units: tuple[str, ...]
    samples: int
    segment: float
    period: str

    def to_frame(self) -> pl.DataFrame:
        return self.periods

    @property
    def named(self) -> pl.DataFrame:
        """The axes that need attention, with the clearest first."""
        return self.axes.filter(pl.col("named"))

    @property
    def unknown(self) -> pl.DataFrame:
        return self.axes.filter(pl.col("kind") == UNKNOWN)

    @property
    def title(self) -> str:
        """A sentence on how many axes need attention, have no estimate, or have too few periods to exclude a change."""
        many, named, unknown = self.axes.height, self.named.height, self.unknown.height
        dark = f", {unknown} {'has' if unknown == 1 else 'have'} no estimate" if unknown else ""
        blind = self.axes.filter((pl.col("kind") != UNKNOWN) & pl.col("visible").is_infinite()).height
        short = f", {blind} {'has' if blind == 1 else 'have'} too few periods to exclude a change" if blind else ""
        return f"{named} of {many} axes need{'s' * (named == 1)} attention{dark}{short}"

    def __str__(self) -> str:
        lines = [f"  {printable(row['axis'])}: {row['why']}" for row in self.named.head(8).iter_rows(named=True)]
        return "\n".join([self.title, *lines, *(["  ..."] if self.named.height > 8 else [])])

    def to_json(self) -> dict[str, object]:
        """Return the numbers for programs, without the periods, which are a table."""
        named = self.named.select("axis", "type", "kind", "cause", "size", "std", "since", "score", "why")
        return {
            "axes": self.axes.height,
            "samples": self.samples,
            "segment": self.segment,
            "period": self.period,
            "units": dict(zip(self.names, self.units, strict=True)),
            "attention": [plain_dict(row) for row in named.iter_rows(named=True)],
            "problems": [plain_dict(row) for row in self.problems.iter_rows(named=True)],
        }


def summarise(
    rows: pl.DataFrame,
    types: Mapping[str, str],
    problems: Sequence[RowProblem],
    settings: Settings,
    periods: Periods,
    tolerance: float,
) -> History:
    """Judge the segments of all axes.

    `rows` are sorted by axis and time. `types` has the type of every existing axis. The other arguments are as in
    `estimate`.
    """
    names, segment = settings.estimator.names, settings.segment
    codes: dict[str, set[tuple[float, str]]] = defaultdict(set)
    for problem in problems:
        if problem.axis:
            codes[problem.axis].add((problem.at, problem.code))
    problems, follows, listed = list(problems), dict[str, Follow](), list[dict[str, object]]()
    for (axis,), own in rows.partition_by(AXIS, maintain_order=True, as_dict=True).items():
        estimates = series_of(own, names)
        series, same = widen_errors(estimates), widen_errors(remove_warmth(estimates, names))
        problems += _report_mixed_periods(axis, series)
        follows[axis] = follow = follow_axis(axis, types[axis], same, names, tolerance)
        dated = codes[axis] | ({(follow.step.since, CHANGED)} if follow.step is not None and follow.stepped else set())
        listed += period_rows(axis, types[axis], series, names, periods, segment, dated)
    missing = [axis for axis in sorted(types) if axis not in follows]
    nan, infinite = np.full(len(names), np.nan), np.full(len(names), np.inf)
    follows |= {axis: Follow(axis, types[axis], 0, nan, infinite, None, None) for axis in missing}
    everyone = [follows[axis] for axis in sorted(types)]
    problems += _sorts(everyone, names, tolerance)
    axes = _axes(everyone, judge_axes(everyone, names, tolerance), names)
    listed += _nothing(missing, types, codes)
    whole = pl.DataFrame(listed, schema=_period_schema(names)).sort(AXIS, "period")
    facts = int(rows["samples"].sum()), segment, periods.name
    return History(whole, axes, _problems(problems), names, settings.estimator.units, *facts)


def estimate(
    data: Frame | pl.LazyFrame | SparkFrame | Path | str,
    *,
    axis: Axis | AxisSections | Path | str,
    by: str,
    period: str = "day",
    type: str | None = None,
    workers: int | None = None,
    out: Path | str | None = None,
    segment: float | None = None,
    tolerance: float | None = None,
    progress: Progress | None = None,
) -> History:
    """Estimate every axis and period of a data set, and find the axes that need attention.

    `data` is a folder of Parquet or Arrow files in any partition, a file of any format, or a frame. The frame may come
    from pandas, Polars (lazy, too), Arrow or Spark. The data have a row for each sample of each axis, in any order.
    `axis` is the path of an AXIS.toml, or a dict with its sections. The sections name the columns of time, input and
    counts, and describe the common properties of all axes. `by` is the column, or the key of the folders, with the
    names of the axes. `period` is "day", "shift", "run" or a duration such as "10min". `type` is the column with the
    types of the axes. Axes are compared within a type. `workers` is the number of threads of this machine, by default
    one for each processor. A Spark DataFrame is processed by its own session. `out` is a folder for the tables.
    `segment` is the length of one estimate [s], the unit in which changes are found. The default is 60 s, or a length
    that fits [estimator] forgetting. `tolerance` is the relative deviation that does not count, by default the
    tolerance of [monitor].

    Unusable axes, times and files appear in the `problems` and in the findings of the periods. All other data are
    processed. Raises UsageError for missing columns, methods that are not recursive, and data without a moving axis.
    """
    own = read_axis(axis)
    columns, periods = SourceColumns.from_axis(own, by, type), Periods.from_name(period)
    tolerance = own.monitor.tolerance if tolerance is None else tolerance
    if not 0 <= tolerance < math.inf:
        raise UsageError(
            f"tolerance = {tolerance} is not valid: give a relative deviation of 0 or more, for example 0.05"
        )
    tell = progress or (lambda done: None)
    if out is not None:
        prepare_folder(out := Path(out))  # before any file is created
    found = _estimate(own, _rows_of(data, columns, out, workers), periods, segment, tolerance, tell)
    if out is not None:
        for name in ("periods", "axes", "problems"):
            frame: pl.DataFrame = getattr(found, name)
            _write_table(out / f"{name}.parquet", frame)
    return found


def _rows_of(data: object, columns: SourceColumns, out: Path | None, workers: int | None) -> Files | SparkRows:
    if not is_spark(data):
        return Files(parts_of(data, out), columns, out, workers)
    from pmfid.fleet.spark import SparkRows

    return SparkRows(data, columns)


def _estimate(
    axis: Axis, data: Files | SparkRows, periods: Periods, segment: float | None, tolerance: float, tell: Progress
) -> History:
    survey = data.survey()
    chosen = choose(axis, longest_tables(data.read(_samples(survey.rows)), data.given))
    settings = make_settings(axis, chosen, min(SECONDS["h"] / 2, periods.length or SECONDS["h"]), segment)
    work = Work(settings, data.given)
    rows, problems = split_results(data.evaluate(work, tell))
    # If an axis has several types, the first by name counts.
    types = dict(survey.rows.group_by(AXIS).agg(pl.col(TYPE).min()).sort(AXIS).iter_rows())
    problems = [*survey.problems, *_several(survey.rows), *problems]
    return summarise(rows, types, problems, settings, periods, tolerance)


def _samples(rows: pl.DataFrame) -> pl.DataFrame:
    """Return the first hour of some axes, which decide on the filters."""
    first = rows.group_by(AXIS, HOUR).agg(pl.sum(ROWS)).sort(AXIS, HOUR).unique(AXIS, keep="first", maintain_order=True)
    fitting = first.filter(pl.col(ROWS).cum_sum() <= TUNING.plan_rows)
    return (fitting if fitting.height else first.head(1)).head(TUNING.tried_axes).select(AXIS, HOUR)


def _several(rows: pl.DataFrame) -> Iterator[RowProblem]:
    """Yield a problem for each axis that has several types."""
    kinds = rows.filter(pl.col(TYPE) != "").group_by(AXIS).agg(pl.col(TYPE).unique().sort())
    for axis, types in kinds.filter(pl.col(TYPE).list.len() > 1).sort(AXIS).iter_rows():
        yield RowProblem(axis, "", "types", f"its rows have the types {', '.join(types)}: only the first type is used")


#: Files that a history writes into its folder.
OWN = RESULTS | {"fleet.html", "fleet.json"}


def prepare_folder(folder: Path) -> None:
    """Make the folder. Raises UsageError if it is a file, contains other things, or cannot be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        strangers = sorted(path.name for path in folder.iterdir() if path.name not in OWN)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"{folder}: {reason}; choose a writable folder for the history") from None
    if strangers:
        raise UsageError(f"{folder}: contains other files, for example {strangers[0]}; give an empty or new folder")


def _write_table(path: Path, frame: pl.DataFrame) -> None:
    from polars.exceptions import PolarsError  # the error that polars raises for a full disk

    try:
        replace_file(path, frame.write_parquet)
    except (OSError, PolarsError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"{path}: {reason}; free some space, or choose another folder") from None

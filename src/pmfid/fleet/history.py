"""The history of a fleet, from a data set of any size to verdicts and estimates for each axis and period."""

from __future__ import annotations

import json
import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from pmfid.config.axis import Axis, read_axis
from pmfid.config.keys import AxisKeys
from pmfid.errors import UsageError, printable
from pmfid.fleet.data import Engine, Local, Parts, Work
from pmfid.fleet.plan import RowProblem, RowShard, shards_of, slice_length
from pmfid.fleet.series import Periods, Series, period_rows, series_of, widen_errors
from pmfid.fleet.settings import Chosen, choose, make_settings
from pmfid.fleet.source import AXIS, TYPE, SourceColumns, SparkFrame, is_spark, parts_of
from pmfid.fleet.store import Keep, Kept, Store, check_folder, digest, whole
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
from pmfid.io.tables import Frame
from pmfid.presentation import plain_dict

#: Finding for an axis in which a step of this relative size may go unnoticed.
LITTLE, SOUGHT = "little_information", 0.1

if TYPE_CHECKING:
    from pmfid.fleet.spark.frame import SparkRows


@dataclass(frozen=True)
class Outcome:
    """The result, with the fields of `History`."""

    periods: pl.DataFrame
    axes: pl.DataFrame
    problems: pl.DataFrame
    samples: int


def outcome_of(
    groups: Iterable[pl.DataFrame],
    types: Mapping[str, str],
    problems: Sequence[RowProblem],
    names: tuple[str, ...],
    periods: Periods,
    segment: float,
    tolerance: float,
) -> Outcome:
    """Judge the segments of all axes.

    `groups` yields the segments of some axes at a time. `types` has the type of every existing axis. `segment` is in s.
    The other arguments are as in `history.estimate`.
    """
    codes: dict[str, set[tuple[float, str]]] = defaultdict(set)
    for problem in problems:
        if problem.axis:
            codes[problem.axis].add((problem.at, problem.code))
    problems, follows = list(problems), dict[str, Follow]()
    frames, seen = list[pl.DataFrame](), 0
    for group in groups:
        rows: list[dict[str, object]] = []
        for part in group.partition_by(AXIS, maintain_order=True):
            axis, series = str(part[AXIS][0]), widen_errors(series_of(part, names))
            seen += int(series.samples.sum())
            problems += _report_mixed_periods(axis, series)
            follows[axis] = follow_axis(axis, types[axis], series, names, tolerance)
            step = follows[axis].step
            dated = codes[axis] | ({(step.since, CHANGED)} if step is not None and follows[axis].stepped else set())
            rows += period_rows(axis, types[axis], series, names, periods, segment, dated)
        frames.append(pl.DataFrame(rows, schema=_period_schema(names)))
    problems += _others(follows.values())
    missing = [axis for axis in sorted(types) if axis not in follows]
    frames.append(pl.DataFrame(_nothing(missing, types, codes), schema=_period_schema(names)))
    nan, infinite = np.full(len(names), np.nan), np.full(len(names), np.inf)
    follows |= {axis: Follow(axis, types[axis], 0, nan, infinite, None, None) for axis in missing}
    everyone = [follows[axis] for axis in sorted(types)]
    problems += _sorts(everyone, names, tolerance)
    axes = _axes(everyone, judge_axes(everyone, names, tolerance), names)
    whole = pl.concat(frames).sort(AXIS, "period")
    return Outcome(whole, axes, _problems(problems), seen)


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


def _others(follows: Iterable[Follow]) -> list[RowProblem]:
    """Return a problem for each axis with another sample period than most axes."""
    known = [one for one in follows if one.segments]
    if not known:
        return []
    usual = float(np.quantile([one.dt for one in known], 0.5, method="lower"))
    text = "the sample period is {:.6g} s, but {:.6g} s for most axes: this axis is estimated with its own period"
    return [
        RowProblem(one.axis, "", "other_dt", text.format(one.dt, usual))
        for one in known
        if abs(one.dt - usual) > TUNING.series_same * usual
    ]


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
        for i, name in enumerate(names):
            deviation = float(verdict.deviation[i]) if verdict.deviation.size else math.nan
            changed = math.nan if one.step is None else float(one.step.relative[i])
            row |= {name: float(one.theta[i]), f"{name}_std": float(one.std[i])}
            row |= {f"{name}_deviation": deviation, f"{name}_change": changed}
            slope, std = (math.nan, math.nan) if one.trend is None else (one.trend.slopes[i], one.trend.stds[i])
            row |= {f"{name}_slope": float(slope) * TUNING.plan_day, f"{name}_slope_std": float(std) * TUNING.plan_day}
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


#: A function that is called with the completed part of the work, 0 to 1.
Progress = Callable[[float], None]


@dataclass(frozen=True)
class History:
    """The history of a fleet.

    `periods` has a row for each axis and period. `axes` has a row for each axis, where axes with need of attention come
    first. `problems` has the unusable rows and files, with reasons. `names` and `units` belong to the parameters.
    `samples` is the number of samples in the estimates. `segment` is the length of one estimate [s]. `shards` is the
    number of shards, and `reused` the number of shards known from an earlier call. `engine` is the name of the engine.
    """

    periods: pl.DataFrame
    axes: pl.DataFrame
    problems: pl.DataFrame
    names: tuple[str, ...]
    units: tuple[str, ...]
    samples: int
    segment: float
    period: str
    shards: int
    reused: int
    engine: str

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
        """A sentence on how many axes need attention, have no estimate, or have too few periods to show a change."""
        many, named, unknown = self.axes.height, self.named.height, self.unknown.height
        dark = f", {unknown} {'has' if unknown == 1 else 'have'} no estimate" if unknown else ""
        blind = self.axes.filter((pl.col("kind") != UNKNOWN) & pl.col("visible").is_infinite()).height
        short = f", {blind} {'has' if blind == 1 else 'have'} too few periods to show a change" if blind else ""
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
            "engine": self.engine,
            "shards": self.shards,
            "reused": self.reused,
            "units": dict(zip(self.names, self.units, strict=True)),
            "attention": [plain_dict(row) for row in named.iter_rows(named=True)],
            "problems": [plain_dict(row) for row in self.problems.iter_rows(named=True)],
        }


def data_of(data: object, columns: SourceColumns, engine: Engine | None, out: Path | None) -> Parts | SparkRows:
    """Return the object that reads the rows. Raises UsageError for an engine that cannot reach the rows."""
    if is_spark(data):
        from pmfid.fleet.spark.frame import SparkRows

        return SparkRows(data, columns, engine)
    if engine is not None and engine.name != Local.name and not isinstance(data, str | Path):
        raise UsageError(
            f"a frame in memory stays on this machine, but the engine {engine.name} would send it to "
            "other machines: leave out the engine, or give a folder of files or a Spark DataFrame"
        )
    return Parts(parts_of(data, out), columns, engine or Local())


def estimate(
    data: Frame | pl.LazyFrame | SparkFrame | Path | str,
    *,
    axis: Axis | AxisKeys | Path | str,
    by: str,
    period: str = "day",
    type: str | None = None,
    engine: Engine | None = None,
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
    types of the axes. Axes are compared within a type. `engine` is by default this machine, `Local()`, or the session
    of a Spark DataFrame. `out` is a folder that keeps finished work. A second call with the same folder processes only
    new or changed data. `segment` is the length of one estimate [s], the unit in which changes are found. The default
    is 60 s, or a length that fits [estimator] forgetting. `tolerance` is the relative deviation that does not count,
    by default the tolerance of [monitor].

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
    if out is None:
        return _Run(own, columns, data_of(data, columns, engine, None), None, tell).outcome(periods, segment, tolerance)
    out = Path(out)
    check_folder(out)  # before any file is created
    there = data_of(data, columns, engine, out)
    with closing(Store(out)) as store:
        found = _Run(own, columns, there, store, tell).outcome(periods, segment, tolerance)
        for name in ("periods", "axes", "problems"):
            frame: pl.DataFrame = getattr(found, name)
            whole(out / f"{name}.parquet", frame.write_parquet)
    return found


class _Run:
    """The survey, the plan and the store of one call of `estimate`."""

    def __init__(
        self, axis: Axis, columns: SourceColumns, data: Parts | SparkRows, store: Store | None, tell: Progress
    ) -> None:
        self.axis, self.columns, self.data, self.store, self.tell = axis, columns, data, store, tell
        self.keep = Keep(store)
        self.survey = data.survey(self.keep)

    def outcome(self, periods: Periods, segment: float | None, tolerance: float) -> History:
        length = slice_length(self.survey.rows, periods.length)
        shards = shards_of(self.survey.rows, length)
        folder = None if self.store is None else self.store.folder
        with self.data.prepare_shards(shards, self.survey, length, folder):
            return self._outcome(shards, length, periods, segment, tolerance)

    def _outcome(
        self, shards: Sequence[RowShard], length: float, periods: Periods, segment: float | None, tolerance: float
    ) -> History:
        chosen = self._choose_filters(shards, length)
        most = min(length / 2, periods.length or length)
        settings = make_settings(self.axis, chosen, most, segment)
        work = Work(settings, self.columns, length)
        before, names = self.keep.reused, settings.estimator.names
        known = str((self.axis.model_dump(warnings=False), chosen, settings.segment, length))
        solved = self._solve_shards(shards, work, known)
        lost = (problem for one in solved for problem in one.problems)
        problems = [*self.survey.problems, *self._several(), *lost]
        groups = self._groups(shards, solved)
        # If an axis has several types, the first by name counts.
        types = dict(self.survey.rows.group_by(AXIS).agg(pl.col(TYPE).min()).sort(AXIS).iter_rows())
        found: Outcome = outcome_of(groups, types, problems, names, periods, settings.segment, tolerance)
        if self.store is not None:
            self.store.keep(self.keep.keys)
        units = settings.estimator.units
        reused = self.keep.reused - before
        facts = (found.samples, settings.segment, periods.name, len(shards), reused, self.data.engine)
        return History(found.periods, found.axes, found.problems, names, units, *facts)

    def _choose_filters(self, shards: Sequence[RowShard], length: float) -> Chosen:
        """Choose the filters by the first moving axis.

        A stored choice stays, so that new data change no old estimate.
        """
        tables = self.data.tables(shards, length)
        if self.store is None:
            return choose(self.axis, tables)
        key = digest("chosen", self.axis.model_dump(warnings=False), self.columns)
        self.keep.keys.append(key)
        path = self.store.path(key).with_suffix(".json")
        try:
            raw = json.loads(path.read_text(encoding="utf-8"))
            zeros = None if raw["zeros"] is None else (raw["zeros"][0], raw["zeros"][1])
            return Chosen(raw["cutoff"], zeros, raw["dt"], raw["resolution"])
        except (OSError, ValueError, KeyError, TypeError):
            chosen = choose(self.axis, tables)
        whole(path, lambda part: part.write_text(json.dumps(asdict(chosen)), encoding="utf-8"))
        return chosen

    def _solve_shards(self, shards: Sequence[RowShard], work: Work, signature: str) -> list[Kept]:
        """Return the segments of every shard, in order. The rows stay on the disk if a folder is given."""
        found, done, rows = list[Kept](), 0, sum(shard.rows for shard in shards)
        keys = [
            digest("segments", signature, one.axes, one.first, one.last, self.data.stamp(one, work.length))
            for one in shards
        ]
        kept = self.keep.fetch(keys, lambda missing: self.data.segments(work, [shards[k] for k in missing]))
        for shard, one in zip(shards, kept, strict=True):
            found.append(one)
            done += shard.rows
            self.tell(done / max(rows, 1))
        return found

    def _groups(self, shards: Sequence[RowShard], solved: Sequence[Kept]) -> Iterator[pl.DataFrame]:
        """Yield the segments of some axes at a time, in the order of axes and time."""
        places: dict[str, list[int]] = defaultdict(list)
        for k, shard in enumerate(shards):
            for name in shard.axes:
                places[name].append(k)
        names = sorted(places)
        for start in range(0, len(names), TUNING.history_together):
            group = names[start : start + TUNING.history_together]
            wanted = sorted({k for name in group for k in places[name]})
            frames = [solved[k].rows().filter(pl.col(AXIS).is_in(group)) for k in wanted]
            yield pl.concat(frames).sort(AXIS, "start")

    def _several(self) -> Iterator[RowProblem]:
        """Yield a problem for each axis that has several types in its files or days."""
        kinds = self.survey.rows.filter(pl.col(TYPE) != "").group_by(AXIS).agg(pl.col(TYPE).unique().sort())
        for axis, types in kinds.filter(pl.col(TYPE).list.len() > 1).sort(AXIS).iter_rows():
            yield RowProblem(
                axis, "", "types", f"its rows have the types {', '.join(types)}: only the first type is used"
            )

"""From segments to the tables of a history: periods, axes in the order of attention, problems."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pmfid.fleet.plan import RowProblem
from pmfid.fleet.series import Periods, Series, period_rows, series_of, widen_errors
from pmfid.fleet.source import AXIS
from pmfid.fleet.tuning import TUNING
from pmfid.fleet.verdicts import CHANGED, AxisVerdict, Follow, follow_axis, judge_axes, ranking, sentence, sorts_by_type

if TYPE_CHECKING:
    import polars as pl


#: Said of an axis in which a step of this size might be overlooked.
LITTLE, SOUGHT = "little_information", 0.1


@dataclass(frozen=True)
class Outcome:
    """As in `History`."""

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
    """groups: the segments of some axes each; types: of every axis that there is; segment: [s]; others: as in
    `history.estimate`."""
    import polars as pl

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
    everyone = [follows.get(axis) or _unknown(axis, types[axis], len(names)) for axis in sorted(types)]
    problems += _sorts(everyone, names, tolerance)
    axes = _axes(everyone, judge_axes(everyone, names, tolerance), names)
    whole = pl.concat(frames).sort(AXIS, "period")
    return Outcome(whole, axes, _problems(problems), seen)


def _report_mixed_periods(axis: str, series: Series) -> list[RowProblem]:
    """A problem for an axis whose sample period changes."""
    low, high = float(series.dt.min()), float(series.dt.max())
    if high - low <= TUNING.series_same * high:
        return []
    at = float(series.start[np.flatnonzero(series.dt != series.dt[0])[0]])
    text = f"sample periods from {low:.6g} to {high:.6g} s: each is estimated with its own"
    return [RowProblem(axis, "", "mixed_dt", text, at)]


def _others(follows: Iterable[Follow]) -> list[RowProblem]:
    """Axes that are sampled otherwise than most."""
    known = [one for one in follows if one.segments]
    if not known:
        return []
    usual = float(np.quantile([one.dt for one in known], 0.5, method="lower"))
    text = "sampled every {:.6g} s, most axes every {:.6g} s: it is estimated with its own"
    return [
        RowProblem(one.axis, "", "other_dt", text.format(one.dt, usual))
        for one in known
        if abs(one.dt - usual) > TUNING.series_same * usual
    ]


def _sorts(follows: Sequence[Follow], names: Sequence[str], tolerance: float) -> list[RowProblem]:
    """Types that hold several sorts of machines."""
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
                f"{len(sorts)} sorts of machines, by {names[i].replace('_', ' ')}: {each}; each axis is compared "
                "with its own sort: give them types of their own, --type"
            )
            found.append(RowProblem("", f"type {kind}" if kind else "all axes", "several_sorts", text))
    return found


def _unknown(axis: str, kind: str, parameters: int) -> Follow:
    return Follow(axis, kind, 0, np.full(parameters, np.nan), np.full(parameters, np.inf), None, None)


def _nothing(
    axes: Sequence[str], types: Mapping[str, str], codes: Mapping[str, set[tuple[float, str]]]
) -> list[dict[str, object]]:
    """A row for each axis without any estimate, so that none goes missing in silence."""
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
    import polars as pl

    kinds: dict[str, pl.DataType] = {"axis": pl.String(), "type": pl.String(), "period": pl.Float64()}
    kinds |= {"first": pl.Float64(), "last": pl.Float64(), "samples": pl.Int64(), "segments": pl.Int64()}
    kinds |= {"lost": pl.Float64(), "dt": pl.Float64()}
    for name in names:
        kinds |= {name: pl.Float64(), f"{name}_std": pl.Float64()}
    return kinds | {"quality": pl.String(), "findings": pl.String()}


def _axes(follows: Sequence[Follow], verdicts: Sequence[AxisVerdict], names: Sequence[str]) -> pl.DataFrame:
    """Those that need attention first."""
    import polars as pl

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
    """Each kind once for an axis or a file, with how often and from when on."""
    import polars as pl

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

"""Verdicts on axes, and the sentences that state them."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

import numpy as np
from scipy.special import ndtri, stdtrit

from pmfid.estimators.facts import INPUT_GAIN
from pmfid.fleet.changes import Beyond, Step, Trend, compare_with_wander, sorts_of, step_of, trend_of
from pmfid.fleet.series import Series, codes_of, mean_of, quality_of, standing
from pmfid.fleet.source import SECONDS
from pmfid.fleet.tuning import TUNING
from pmfid.records.clock import CLOCK_EPOCHS
from pmfid.types import Floats

#: Kinds of verdicts, in words.
CHANGED, DRIFTS, DIFFERS, WANDERS, UNKNOWN = "changed", "drifts", "differs", "wanders", "no estimate"
STOPPED = "stopped"


@dataclass(frozen=True)
class Follow:
    """The findings on one axis without regard to other axes.

    `theta` and `std` (p,) are the estimate at the end, since the last step. `segments` is the number of usable
    segments. `wander` is the evidence of step and trend beyond wandering, or None if neither is clear. `codes` has the
    findings on theta. `last` is the end of the data, and `pause` the longest pause [s]. `error` (p,) is the error of
    theta by forces that the model may lack.
    """

    axis: str
    type: str
    segments: int
    theta: Floats
    std: Floats
    step: Step | None
    trend: Trend | None
    wander: Beyond | None = None
    codes: frozenset[str] = frozenset()
    last: float = math.nan
    pause: float = math.inf
    error: Floats | float = 0.0

    @property
    def quality(self) -> str:
        return quality_of(self.segments, self.codes)

    @property
    def stepped(self) -> bool:
        """Whether the axis has a certain step, without regard to other axes."""
        clear = self.step is not None and self.step.score > TUNING.verdicts_clear
        return clear and self.wander is not None and self.wander.step > TUNING.verdicts_clear


@dataclass(frozen=True)
class AxisVerdict:
    """The verdict on an axis.

    `kind` is one of the kinds of verdicts, or empty. `score` is the ratio of the evidence to the evidence that chance
    explains. From 1 upwards the axis is named. `cause` is a parameter, FRICTION or INPUT_GAIN. `size` and `std` are
    relative. A drift has a size per day. A wandering axis has the root mean square about its mean. `since` and `until`
    are the limits of the time of the change [s]. `days` is the length of the history. `deviation` (p,) is relative to
    the median of the axis' kind, NaN for too few axes. `visible` is the relative step of any parameter in the middle of
    the history that would be named, infinite for too few segments. `silent` is the time [s] since which the axis has
    delivered no motion although most axes have, otherwise NaN.
    """

    kind: str
    score: float
    cause: str = ""
    size: float = math.nan
    std: float = math.nan
    since: float = math.nan
    until: float = math.nan
    days: float = 0.0
    deviation: Floats = field(default_factory=lambda: np.empty(0))
    visible: float = math.inf
    silent: float = math.nan

    @property
    def weight(self) -> float:
        """The rank of a finding, which is the size if the evidence is sufficient, otherwise the evidence."""
        return abs(self.total) if self.kind and math.isfinite(self.total) else self.score

    @property
    def total(self) -> float:
        """The relative change over the history."""
        return self.size * self.days if self.kind == DRIFTS else self.size

    @property
    def named(self) -> bool:
        """Whether the axis needs attention."""
        return self.kind in (CHANGED, DRIFTS, DIFFERS, STOPPED)


def follow_axis(axis: str, kind: str, series: Series, names: Sequence[str], tolerance: float) -> Follow:
    """Return step, trend and final estimate from the segments (n,) of an axis.

    `kind` is the type of the axis. `tolerance` is the relative change that does not count.
    """
    used = series[series.usable]
    step, trend = step_of(used, names, tolerance), trend_of(used, names, tolerance)
    clear = step is not None and trend is not None and max(step.score, trend.score) > TUNING.looked_at
    wander = None
    if step is not None and clear:
        whole = (used.start < step.since) | (used.start >= step.settled)  # without mixed segments
        wander = compare_with_wander(used[whole], step.settled)
    late = used if step is None or not step.score > 0 else used[used.start >= step.settled]
    late = late if late.start.size else used
    theta, std = mean_of(late)
    codes = frozenset(standing(series) | (codes_of(late) if late.start.size else set()))
    last = float(series.end.max()) if series.end.size else math.nan
    pauses = series.start[1:] - series.end[:-1]
    pause = float(np.max(pauses, initial=0.0)) if series.end.size >= TUNING.verdicts_sure else math.inf
    facts = axis, kind, int(used.start.size), theta, std, step, trend, wander, codes, last, pause
    return Follow(*facts, series.model_error.std)


def judge_axes(follows: Sequence[Follow], names: Sequence[str], tolerance: float) -> list[AxisVerdict]:
    """Return the verdict on each axis, in order."""
    deviations = _deviations(follows, tolerance)
    limit = chance_limit(len(follows) * max(1, len(names)), math.inf)
    found = (
        _verdict(one, names, deviation, excess, len(follows), limit)
        for one, (deviation, excess) in zip(follows, deviations, strict=True)
    )
    trials, silent = len(follows) * len(names), _silent_since(follows)
    return [
        _stop(replace(verdict, visible=visible_step(one, trials, tolerance)), since)
        for one, verdict, since in zip(follows, found, silent, strict=True)
    ]


def _silent_since(follows: Sequence[Follow]) -> list[float]:
    """Return the time [s] since which each axis has been silent, NaN for an axis that still delivers.

    An axis has stopped if it has been silent for more than twice its longest pause, while most axes still delivered.
    """
    ends = np.array([one.last for one in follows if math.isfinite(one.last)])
    usual = float(np.median(ends)) if ends.size else math.nan
    return [one.last if usual - one.last > 2 * max(one.pause, TUNING.settings_segment) else math.nan for one in follows]


def _stop(verdict: AxisVerdict, since: float) -> AxisVerdict:
    """Return a verdict with the time since which the axis has been silent, if any."""
    silent = replace(verdict, silent=since)
    return (
        replace(silent, kind=STOPPED, cause="", size=math.nan, std=math.nan, since=since)
        if math.isfinite(since) and not verdict.named
        else silent
    )


def visible_step(one: Follow, trials: int, tolerance: float) -> float:
    """Return the relative step in the middle of the history that would be named, infinite for too few segments.

    `trials` is the number of axes times parameters.
    """
    if one.step is None or one.segments < TUNING.verdicts_sure:
        return math.inf
    return tolerance + chance_limit(trials * one.segments, one.segments - 2) * float(np.max(one.step.middle))


def _verdict(
    one: Follow, names: Sequence[str], deviation: Floats, excess: Floats, axes: int, limit: float
) -> AxisVerdict:
    if not one.segments:
        return AxisVerdict(UNKNOWN, 0.0, deviation=deviation)
    found = [_judge_deviation(names, deviation, excess, limit), *judge_past(one, names, axes)]
    best = max(found, key=lambda verdict: (verdict.named and verdict.score >= 1, verdict.score))
    return replace(best, kind=best.kind if best.score >= 1 else "", deviation=deviation)


def judge_past(one: Follow, names: Sequence[str], axes: int) -> list[AxisVerdict]:
    """Return the verdict on the step or the trend of an axis, whichever explains more.

    The step or trend counts only if it explains more than wandering does.
    """
    step, trend = one.step, one.trend
    if step is None or trend is None:
        return []
    trials, free, days = axes * len(names), one.segments - 2, trend.span / SECONDS["d"]
    least = chance_limit(trials * one.segments, free)
    stepped, drifted = step.score / least, trend.score / chance_limit(trials, free)
    changed = AxisVerdict(CHANGED, max(stepped, 0.0), step.cause, step.size, step.std, step.since, step.until)
    drifts = AxisVerdict(DRIFTS, drifted, trend.cause, trend.size / days, trend.std / days, days=days)
    first = drifted < 1 or step.misfit <= trend.misfit
    clear = [verdict for verdict in ((changed, drifts) if first else (drifts, changed)) if verdict.score >= 1]
    if not clear or one.wander is None:
        return [changed]
    sure = {
        CHANGED: one.wander.step >= least,
        DRIFTS: one.wander.line >= -float(stdtrit(max(free, 1), TUNING.verdicts_line / 2)),
    }
    return [next((verdict for verdict in clear if sure[verdict.kind]), _wandering(clear[0], one.wander, names))]


def _wandering(verdict: AxisVerdict, wander: Beyond, names: Sequence[str]) -> AxisVerdict:
    """Return a verdict of wandering for an axis whose step or drift explains no more than wandering does."""
    own = [size for size, name in zip(wander.size, names, strict=True) if verdict.cause in name]
    return AxisVerdict(WANDERS, verdict.score, verdict.cause, float(max(own or wander.size)))


def _judge_deviation(names: Sequence[str], deviation: Floats, excess: Floats, limit: float) -> AxisVerdict:
    if not np.any(np.isfinite(excess)):
        return AxisVerdict(DIFFERS, 0.0)
    i = int(np.nanargmax(excess))
    return AxisVerdict(DIFFERS, max(0.0, float(excess[i]) / limit), names[i], float(deviation[i]), math.nan)


def chance_limit(trials: float, free: float) -> float:
    """Return the standard deviations that chance exceeds `by_chance` times in `trials` trials, on either side.

    `free` is the degrees of freedom of the standard deviation.
    """
    part = TUNING.by_chance / (2 * max(trials, 1))
    return float(-ndtri(part) if math.isinf(free) else -stdtrit(max(free, 1), part))


def sorts_by_type(follows: Sequence[Follow], tolerance: float) -> dict[str, list[list[int]]]:
    """Return the places of the axes of each type that have an estimate, divided into kinds."""
    groups: dict[str, list[int]] = defaultdict(list)
    for k, one in enumerate(follows):
        if one.segments:
            groups[one.type].append(k)
    found = {}
    for kind, members in groups.items():
        theta, _ = _estimates(follows, members)
        sorts = sorts_of(_logarithms(theta)[0], TUNING.verdicts_sure, tolerance)
        found[kind] = [[members[k] for k in own] for own in sorts]
    return found


def _estimates(follows: Sequence[Follow], members: Sequence[int]) -> tuple[Floats, Floats]:
    theta, std = (np.array([getattr(follows[k], name) for k in members]) for name in ("theta", "std"))
    return theta, std


def _deviations(follows: Sequence[Follow], tolerance: float) -> list[tuple[Floats, Floats]]:
    """Return the relative deviation (p,) of each axis from the median of its kind, and the excess over the tolerance.

    The excess is in spreads. Deviation and excess are NaN for too few axes, or if the sign differs.
    """
    p = follows[0].theta.size if follows else 0
    found = [(np.full(p, np.nan), np.full(p, np.nan)) for _ in follows]
    for sorts in sorts_by_type(follows, tolerance).values():
        for members in sorts:
            if len(members) >= TUNING.verdicts_sure:
                for k, *pair in zip(members, *_compare_axes(*_estimates(follows, members), tolerance), strict=True):
                    found[k] = (pair[0], pair[1])
    return found


def _compare_axes(theta: Floats, std: Floats, tolerance: float) -> tuple[Floats, Floats]:
    """Return the deviations (m, p) of the axes of one kind, and their excess over the tolerance.

    The deviations are relative, the excess is in standard deviations.
    """
    apart, ratio, size = _logarithms(theta)
    spread = spread_of(apart)
    scale = np.hypot(spread, std / size)
    return ratio - 1, np.maximum(np.abs(apart) - tolerance, 0.0) / np.maximum(scale, np.finfo(float).tiny)


def _logarithms(theta: Floats) -> tuple[Floats, Floats, Floats]:
    """Return logarithms of theta (m, p) over the median, the ratios, and the sizes (p,) of the medians.

    Parameters of machines differ by factors. If a parameter is not positive everywhere, the result has its relative
    differences in place of logarithms.
    """
    middle = np.median(theta, axis=0)
    size = np.maximum(np.abs(middle), np.finfo(float).tiny)
    ratio = theta / size * np.where(middle < 0, -1.0, 1.0)
    positive = np.all(ratio > 0, axis=0)
    return np.where(positive, np.log(np.where(positive, ratio, 1.0)), ratio - 1), ratio, size


def spread_of(apart: Floats) -> Floats:
    """Return the standard deviation (p,) of most of the distances (m, p) from the median.

    The result is the largest value from several parts of the distances. Tails heavier than normal therefore count, and
    outliers in a tenth of the axes do not.
    """
    sizes = np.abs(apart)
    return np.asarray(
        np.max([np.quantile(sizes, part, axis=0) / ndtri((1 + part) / 2) for part in TUNING.verdicts_parts], axis=0)
    )


def ranking(verdicts: Iterable[AxisVerdict]) -> list[int]:
    """Return the places of the verdicts, where axes with need of attention come first."""
    order = {CHANGED: 0, DRIFTS: 0, DIFFERS: 0, STOPPED: 0, UNKNOWN: 1, WANDERS: 2, "": 3}
    pairs = enumerate(verdicts)
    return [k for k, one in sorted(pairs, key=lambda pair: (order[pair[1].kind], -pair[1].weight, pair[0]))]


#: Names of the parameters in a sentence.
_WORDS = {INPUT_GAIN: "force per input", "friction": "all friction"}


def when(time: float) -> str:
    """Format a time [s] as a date (UTC) if plausible, otherwise as hours, minutes and seconds from zero."""
    if not math.isfinite(time):
        return ""
    if CLOCK_EPOCHS[0] <= time < CLOCK_EPOCHS[1]:
        return datetime.fromtimestamp(time, UTC).strftime("%Y-%m-%d %H:%M:%S")
    minutes, second = divmod(round(time), 60)
    hours, minute = divmod(minutes, 60)
    return f"{hours}:{minute:02}:{second:02}"


def format_span(since: float, until: float) -> str:
    """Return the words for a span from `since` to `until` [s], with a common date only once."""
    first, last = when(since), when(until)
    same = " " in first and first.partition(" ")[0] == last.partition(" ")[0]
    return f"between {first} and {last.partition(' ')[2] if same else last}"


def with_error(size: float, std: float) -> str:
    """Format a relative size in %, with the digits that its standard error justifies."""
    if not math.isfinite(std):
        return f"{100 * size:+.2g} %"
    digits = min(2, max(0, -math.floor(math.log10(max(100 * std, 1e-4)))))
    return f"{100 * size:+.{digits}f} % ± {max(100 * std, 0.01):.{digits}f} %"


def sentence(verdict: AxisVerdict) -> str:
    """Return the reason for attention, or another remark on the axis. The text may be empty."""
    silent = f"no motion in the log since {when(verdict.silent)}" if math.isfinite(verdict.silent) else ""
    return "; ".join(part for part in (_finding(verdict), silent) if part)


def _finding(verdict: AxisVerdict) -> str:
    what = _WORDS.get(verdict.cause, verdict.cause.replace("_", " "))
    if verdict.kind == CHANGED:
        return f"{what} {with_error(verdict.size, verdict.std)} {format_span(verdict.since, verdict.until)}"
    if verdict.kind == DRIFTS:
        if verdict.days >= 1:
            return f"{what} drifts by {with_error(verdict.size, verdict.std)} per day"
        span = when(verdict.days * SECONDS["d"])
        return f"{what} drifts by {with_error(verdict.total, verdict.std * verdict.days)} within {span}"
    if verdict.kind == WANDERS:
        return f"{what} wanders by {100 * verdict.size:.2g} % about its mean"
    if verdict.kind == DIFFERS:
        return f"{what} {100 * verdict.size:+.0f} % from the median of its type"
    return "no estimate: see its findings" if verdict.kind == UNKNOWN else ""

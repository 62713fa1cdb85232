"""A survey of a history, and the plan of its work."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import polars as pl
from numpy.typing import NDArray

from pmfid.errors import UsageError
from pmfid.fleet.source import AXIS, TIME, TYPE, Part, SourceColumns, other_unit
from pmfid.fleet.tuning import TUNING
from pmfid.io.safety import readable
from pmfid.types import Floats

PART, ROWS, LOST, FIRST, LAST, EXTENT = "part", "rows", "lost", "first", "last", "extent"
#: Number of the first row in the part.
START = "start"
_PLACE, _END, _FINITE, _KNOWN = "place in the part", "end", "finite time", "known"


@dataclass(frozen=True)
class RowProblem:
    """Rows or a file that cannot be used.

    `axis` is empty if the problem concerns a file, and `part` is empty if it concerns an axis. `at` is the time [s] at
    which the problem begins. `code` is the name of the problem among the findings.
    """

    axis: str
    part: str
    code: str
    text: str
    at: float = float("nan")


@dataclass(frozen=True)
class Survey:
    """The axes and days in the parts of a data set.

    `rows` has a row for each axis and day in each part. The columns of `rows` are the part's name, number of rows,
    first and last time [s], type, place of the first row, and extent in rows. `problems` has parts that are left out,
    and peculiarities of other parts.
    """

    rows: pl.DataFrame
    problems: tuple[RowProblem, ...]


def survey_part(part: Part, columns: SourceColumns) -> Survey:
    """Return the survey of one part. A part that cannot be read has no rows and a problem."""
    try:
        with readable("data"):
            count = _count_window if part.sliced else _count_whole
            windows = [count(one, columns) for one in part.windows()]
            found, odd = _together(pl.concat(windows)), part.other_types(columns)
    except UsageError as error:
        return Survey(_empty(), (RowProblem("", part.name, "unreadable", " ".join(str(error).split())),))
    said = part.constants.get(columns.axis)
    others = found.filter(found[AXIS] != said)[AXIS] if said else found[AXIS][:0]
    if others.len():
        odd.append(f"its folder says {columns.axis} = {said}, but its column says {others[0]}: the column is used")
    return survey_of(part.name, found, odd, columns.factor)


def _count_whole(part: Part, columns: SourceColumns) -> pl.DataFrame:
    """Count the rows of a part of any size, as `count_rows` does, with the places of the first and last row."""
    place, rows = pl.col(_PLACE).cast(pl.Int64), part.rows(columns).with_row_index(_PLACE, offset=part.first)
    counted = count_rows(rows, columns, place.min().alias(START), place.max().alias(_END))
    return counted.collect(engine="streaming")


def _count_window(part: Part, columns: SourceColumns) -> pl.DataFrame:
    """Count the rows of a part that fits into memory, for each run of rows of one axis, type and day.

    Files usually have few runs, and a run is counted by its ends.
    """
    names = [AXIS, *([TYPE] if columns.type else [])]
    frame = part.rows(columns).select(*names, TIME).collect(engine="streaming")
    time = frame[TIME].to_numpy()
    ended = [frame[name].rle().struct.field("len").cum_sum().to_numpy() for name in names]
    edges = np.unique(np.concatenate([[0], *ended, _find_days(time)]).astype(np.int64))
    starts, ends = edges[:-1], edges[1:]
    finite = np.isfinite(time[starts])
    axis, kind = (frame[name].gather(starts) for name in (names[0], names[-1]))
    known, rows = finite & axis.is_not_null().to_numpy(), ends - starts
    counted = {AXIS: axis, "day": np.floor(time[starts] / TUNING.plan_day)}
    counted |= {ROWS: np.where(known, rows, 0), LOST: np.where(known, 0, rows)}
    times = np.minimum.reduceat(time, starts), np.maximum.reduceat(time, starts)
    counted |= dict(zip((FIRST, LAST), (np.where(finite, one, np.nan) for one in times), strict=True))
    counted |= {START: starts + part.first, _END: ends - 1 + part.first}
    types = kind.fill_null("") if columns.type else pl.lit("")
    return pl.DataFrame(counted).with_columns(pl.col(FIRST, LAST).fill_nan(None), types.alias(TYPE))


def _find_days(time: Floats) -> NDArray[np.intp]:
    """Return the rows (k,) whose day differs from the day of the preceding row, from times (n,) [s]."""
    ends = np.floor(np.array([time.min(initial=np.inf), time.max(initial=-np.inf)]) / TUNING.plan_day)
    if ends[0] == ends[1]:
        return np.empty(0, np.intp)
    days = np.floor(time / TUNING.plan_day)
    return np.flatnonzero(days[1:] != days[:-1]) + 1


def _together(windows: pl.DataFrame) -> pl.DataFrame:
    """Return the rows of all windows of a file, by axis and day."""
    kind = pl.col(TYPE).filter(pl.col(TYPE) != "").min().fill_null("")
    ends = (pl.min(FIRST), pl.max(LAST), pl.min(START))
    extent = (pl.max(_END) - pl.min(START) + 1).alias(EXTENT)
    rows = windows.group_by(AXIS, "day").agg(pl.sum(ROWS, LOST), *ends, kind, extent)
    return rows.sort(AXIS, "day", nulls_last=True)


def count_rows(rows: pl.LazyFrame, columns: SourceColumns, *more: pl.Expr) -> pl.LazyFrame:
    """Count the rows and the lost rows of each axis and day.

    The result also has first and last time, type, and the further columns `more`. The rows come from `Part.rows`.
    """
    finite = pl.when(pl.col(TIME).is_finite()).then(pl.col(TIME))
    kind = pl.col(TYPE).min() if columns.type else pl.lit("")
    rows = rows.with_columns(finite.alias(_FINITE), (pl.col(AXIS).is_not_null() & finite.is_not_null()).alias(_KNOWN))
    known = pl.col(_KNOWN).sum().cast(pl.Int64)
    return rows.group_by(AXIS, (pl.col(TIME) / TUNING.plan_day).floor().alias("day")).agg(
        known.alias(ROWS),
        (pl.len().cast(pl.Int64) - known).alias(LOST),
        pl.col(_FINITE).min().alias(FIRST),
        pl.col(_FINITE).max().alias(LAST),
        kind.fill_null("").alias(TYPE),
        *more,
    )


def survey_of(name: str, found: pl.DataFrame, odd: Sequence[str], factor: float) -> Survey:
    """Return the survey from the counts of the part `name`.

    A part without an order has no extent for its axes. `odd` has peculiarities of the part's columns. `factor` is the
    number of seconds per unit of its times.
    """
    problems = [RowProblem("", name, "type", text) for text in odd]
    if not found.height:
        problems.append(RowProblem("", name, "empty", "the file has no rows"))
    if EXTENT not in found.columns:
        found = found.with_columns(pl.lit(0, pl.Int64).alias(START), pl.col(ROWS).alias(EXTENT))
    lost = int(found[LOST].sum())
    if lost:
        problems.append(
            RowProblem("", name, "rows_lost", f"{lost} rows have no axis, or no valid time: these rows are left out")
        )
    found = found.filter(pl.col(AXIS).is_not_null() & (pl.col(ROWS) > 0))
    if found.height and (text := other_unit(cast(float, found[FIRST].min()), cast(float, found[LAST].max()), factor)):
        problems.append(RowProblem("", name, "time_unit", text))
    return Survey(found.select(pl.lit(name).alias(PART), AXIS, ROWS, FIRST, LAST, TYPE, START, EXTENT), tuple(problems))


def mixture(columns: SourceColumns) -> pl.Expr:
    """Return a number for each row of `Part.rows`, whose sum depends on the content of the rows, not on their order.

    The number has 32 bits, so that a sum of rows stays whole.
    """
    names = [*columns.carried, *([TYPE] if columns.type else [])]
    return (pl.struct(names).hash() // 2**32).cast(pl.Int64)


def content(part: Part, columns: SourceColumns) -> str:
    """Return the stamp of a part without a date, which depends on all its rows. An unreadable part gives ""."""
    try:
        with readable("data"):
            found = part.rows(columns).select(pl.len(), mixture(columns).sum().alias("sum")).collect(engine="streaming")
    except UsageError:
        return ""
    return f"{found.item(0, 0)}-{found.item(0, 1)}"


def join_surveys(surveys: Sequence[Survey]) -> Survey:
    rows = pl.concat([_empty(), *(one.rows for one in surveys)])
    return Survey(rows, tuple(problem for one in surveys for problem in one.problems))


def _empty() -> pl.DataFrame:
    kinds = {PART: pl.String, AXIS: pl.String, ROWS: pl.Int64, FIRST: pl.Float64, LAST: pl.Float64}
    return pl.DataFrame(schema=kinds | {TYPE: pl.String, START: pl.Int64, EXTENT: pl.Int64})


@dataclass(frozen=True)
class RowShard:
    """The axes of the slices first <= k < last, and the parts that contain their rows. `rows` is an approximate
    number."""

    axes: tuple[str, ...]
    first: int
    last: int
    parts: tuple[str, ...]
    rows: int


def slice_length(rows: pl.DataFrame, period: float | None) -> float:
    """Return the length of a slice [s].

    With a period [s], the length is a fraction or a multiple of the period. The usual sample rate of the axes decides,
    and the rows of the fastest axis must fit a shard.
    """
    step = (pl.col(LAST) - pl.col(FIRST)) / (pl.col(ROWS) - 1)
    steps = rows.filter(pl.col(LAST) > pl.col(FIRST)).select(step.alias("dt"))["dt"].to_numpy()
    if not steps.size:
        raise UsageError(
            "no axis has two rows at different times on one day; check --axis, and [record] time and time_unit"
        )
    dt = float(np.median(steps))
    fastest = _fastest(rows)
    fits = (
        length
        for length in TUNING.plan_lengths
        if length / dt <= TUNING.most_samples and length * fastest <= TUNING.plan_budget
    )
    longest = next(fits, TUNING.plan_lengths[-1])
    if period is None:
        return longest
    return period / math.ceil(period / longest - 1e-9) if period > longest else period * math.floor(longest / period)


def _fastest(rows: pl.DataFrame) -> float:
    """Return the rows per second of the fastest axis among axes with more rows than a shard.

    A few close rows never make a large slice, so smaller axes do not count.
    """
    span, many = (pl.col(LAST) - pl.col(FIRST)).sum(), (pl.col(ROWS) - 1).sum()
    axes = rows.group_by(AXIS).agg(span.alias("span"), many.alias("many"))
    large = axes.filter((pl.col("many") > TUNING.plan_budget) & (pl.col("span") > 0))
    return float(large.select((pl.col("many") / pl.col("span")).max()).item() or 0.0)


def shards_of(rows: pl.DataFrame, length: float) -> list[RowShard]:
    """Return all shards, ordered by time and axis.

    The rows come from the `Survey`. `length` is the duration of a slice [s].
    """
    blocks: dict[int, dict[str, dict[str, float]]] = defaultdict(lambda: defaultdict(dict))
    for part, axis, count, first, last in rows.select(PART, AXIS, ROWS, FIRST, LAST).iter_rows():
        for block, share in _blocks(first, last, length * TUNING.plan_block):
            # A block may hold several days of a part.
            own = blocks[block][axis]
            own[part] = own.get(part, 0.0) + count * share
    found: list[RowShard] = []
    for block in sorted(blocks):
        for axes in _pack_axes(blocks[block]):
            found += _cut(axes, blocks[block], block * TUNING.plan_block, (block + 1) * TUNING.plan_block)
    return found


def _blocks(first: float, last: float, length: float) -> Iterator[tuple[int, float]]:
    """Yield the blocks of time from first to last [s], each with its part of the rows, if the rows are even in time."""
    low, high = math.floor(first / length), math.floor(last / length)
    span = max(last - first, 1e-9)
    for block in range(low, high + 1):
        inside = min(last, (block + 1) * length) - max(first, block * length)
        yield block, 1.0 if low == high else max(0.0, inside / span)


def _pack_axes(block: Mapping[str, Mapping[str, float]]) -> Iterator[tuple[str, ...]]:
    """Yield the axes of a block in groups of at most `plan_rows` rows, or of one axis."""
    group: list[str] = []
    total = 0.0
    for axis in sorted(block):
        size = sum(block[axis].values())
        if group and total + size > TUNING.plan_rows:
            yield tuple(group)
            group, total = [], 0.0
        group.append(axis)
        total += size
    if group:
        yield tuple(group)


def _cut(
    axes: Sequence[str], block: Mapping[str, Mapping[str, float]], first: int, last: int, share: float = 1.0
) -> list[RowShard]:
    """Return the slices of a group of axes, halved until their rows fit. `share` is the part of the block's rows."""
    total = share * sum(sum(block[axis].values()) for axis in axes)
    if total > TUNING.plan_rows and last - first > 1:
        middle = (first + last) // 2
        return _cut(axes, block, first, middle, share / 2) + _cut(axes, block, middle, last, share / 2)
    parts = sorted({part for axis in axes for part in block[axis]})
    return [RowShard(tuple(axes), first, last, tuple(parts), round(total))]


class Places:
    """The places of rows in the parts `names`, which can be read in windows.

    The rows come from the `Survey`. Small files are read as a whole.
    """

    def __init__(self, names: Set[str], rows: pl.DataFrame) -> None:
        large = pl.col(ROWS).sum().over(PART) > TUNING.plan_small
        found = rows.filter(pl.col(PART).is_in(list(names)) & large)
        groups = found.partition_by(PART, as_dict=True, include_key=False)
        self._rows = {str(key[0]): group for key, group in groups.items()}

    def narrow(self, part: Part, shard: RowShard, length: float) -> Part:
        """Limit a part to the rows from the first to the last one that may belong to the shard.

        `length` is the duration of a slice [s].
        """
        if part.name not in self._rows:
            return part
        inside = (pl.col(LAST) >= shard.first * length) & (pl.col(FIRST) < shard.last * length)
        own = self._rows[part.name].filter(pl.col(AXIS).is_in(list(shard.axes)) & inside)
        if not own.height:
            return replace(part, first=0, many=0)
        first, last = own.select(pl.min(START), (pl.col(START) + pl.col(EXTENT)).max().alias("end")).row(0)
        return replace(part, first=first, many=last - first)

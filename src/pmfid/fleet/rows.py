"""The rows of a shard: in order, each sample once, cut where an axis, a slice or the recording ends."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import UsageError
from pmfid.fleet.aside import Aside
from pmfid.fleet.plan import RowProblem, RowShard
from pmfid.fleet.source import AXIS, INPUT, MASK, OUTPUT, TIME, Columns, Part
from pmfid.fleet.tuning import TUNING
from pmfid.io.safety import readable
from pmfid.io.tables import Table
from pmfid.types import Flags, Floats

if TYPE_CHECKING:
    import polars as pl

#: Problem of a file that changed while it was read; the next call reads the file again, because its stamp has changed.
REWRITTEN = "was written to while it was read: call again when it is whole"
#: Columns of rows by their name in `source`.
_Columns = Mapping[str, NDArray[np.generic]]


@dataclass(frozen=True)
class ShardRows:
    """n rows in order. axis: (n,) number of the axis in `axes`; time: (n,) [s]; others: (n,) by their name in the
    data."""

    axes: tuple[str, ...]
    axis: NDArray[np.uint32]
    time: Floats
    others: dict[str, Floats]

    def __getitem__(self, kept: Flags | NDArray[np.intp] | slice) -> ShardRows:
        others = {name: values[kept] for name, values in self.others.items()}
        return ShardRows(self.axes, self.axis[kept], self.time[kept], others)


@dataclass(frozen=True)
class RecordPiece:
    """Rows of one axis, one slice and no gap. start: of its first sample [s]; table: of columns by their name in the
    data, the time from the start on."""

    axis: str
    start: float
    table: Table


def read_rows(
    shard: RowShard, parts: Mapping[str, Part], columns: Columns, length: float, aside: Aside | None = None
) -> tuple[ShardRows, tuple[RowProblem, ...]]:
    """The rows of a shard in order, of those that stand twice one, and of those that contradict each other none;
    length: of a slice [s]; aside: where the rows of some parts are. Parts that cannot be read have problems in place of
    rows."""
    frames, problems = list[_Columns](), list[RowProblem]()
    if aside is not None:
        aside.prepare(shard)
    for name in shard.parts:
        try:
            if aside is not None and name in aside:
                frames.append(aside.read(name, shard))
            else:
                with readable("data"):
                    frames += _read(parts[name], shard, columns, length)
        except UsageError as error:
            problems.append(RowProblem("", name, "unreadable", " ".join(str(error).split())))
        if parts[name].rewritten:
            problems.append(RowProblem("", name, "rewritten", REWRITTEN))
    rows, found = unique(_sort_rows(_arrays(frames, shard.axes, columns)))
    return rows, (*problems, *found)


def _read(part: Part, shard: RowShard, columns: Columns, length: float) -> list[_Columns]:
    """Whole or not at all."""
    return [_columns(_window(one, shard, columns, length)) for one in part.windows()]


def _window(part: Part, shard: RowShard, columns: Columns, length: float) -> pl.DataFrame:
    import polars as pl

    axis, time = pl.col(AXIS), pl.col(TIME)
    inside = (time >= shard.first * length) & (time < shard.last * length)
    frame = part.rows(columns).filter(inside)
    if columns.axis not in part.constants:
        frame = frame.filter(axis.is_in(list(shard.axes)))
    named = axis.cast(pl.Enum(list(shard.axes)), strict=False).to_physical().alias(AXIS)
    wanted = [named, TIME, INPUT, OUTPUT, *([MASK] if columns.mask else [])]
    return frame.select(wanted).drop_nulls(AXIS).collect(engine="streaming")


def _columns(frame: pl.DataFrame) -> _Columns:
    return {name: frame[name].to_numpy() for name in frame.columns}


def _arrays(frames: Sequence[_Columns], axes: tuple[str, ...], columns: Columns) -> ShardRows:
    def join(name: str) -> Floats:
        parts = [frame[name] for frame in frames]
        return np.asarray(np.concatenate(parts) if parts else np.empty(0))

    named = columns.named
    others = {named[own]: join(own) for own in (INPUT, OUTPUT, *([MASK] if columns.mask else []))}
    return ShardRows(axes, join(AXIS).astype(np.uint32), join(TIME), others)


def rows_of(frame: pl.DataFrame, columns: Columns) -> tuple[ShardRows, tuple[RowProblem, ...]]:
    """The same of a frame with the columns of `source`, in any order."""
    import polars as pl

    axes = tuple(sorted(frame[AXIS].drop_nulls().unique().to_list()))
    named = pl.col(AXIS).cast(pl.Enum(list(axes))).to_physical()
    known = frame.filter(pl.col(TIME).is_finite()).drop_nulls(AXIS).with_columns(named)
    return unique(_sort_rows(_arrays([_columns(known)], axes, columns)))


def _sort_rows(rows: ShardRows) -> ShardRows:
    """Rows sorted by axis, time, and then by all values, so that the order of files has no effect."""
    if _increasing(rows):
        return rows
    by_axis = rows[np.argsort(rows.axis, kind="stable")]  # enough for axes that are mixed, each in order
    if _increasing(by_axis):
        return by_axis
    keys: list[Floats] = [*rows.others.values(), rows.time, rows.axis.astype(np.float64)]
    return rows[np.lexsort(keys)]


def _increasing(rows: ShardRows) -> bool:
    same, step = np.diff(rows.axis.astype(np.int64)), np.diff(rows.time)
    return bool(np.all((same > 0) | ((same == 0) & (step > 0))))


def unique(rows: ShardRows) -> tuple[ShardRows, tuple[RowProblem, ...]]:
    """Rows in order without those that say the same again, and without all of one time that say different things."""
    again = np.r_[False, (np.diff(rows.axis) == 0) & (np.diff(rows.time) == 0)]
    if not np.any(again):
        return rows, ()
    equal = np.ones(again.size, bool)
    for values in rows.others.values():
        equal[1:] &= (values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
    group = np.cumsum(~again)
    contradicted = np.isin(group, group[again & ~equal])
    problems = _report_rows(
        rows, again & ~contradicted, "duplicates", "rows stand there again, the same: one of each counts"
    )
    problems += _report_rows(
        rows, contradicted, "contradictions", "rows have the time of another and other values: left out"
    )
    return rows[~again & ~contradicted], tuple(problems)


def _report_rows(rows: ShardRows, which: Flags, code: str, text: str) -> list[RowProblem]:
    numbers, first, count = np.unique(rows.axis[which], return_index=True, return_counts=True)
    times = rows.time[which][first]
    return [
        RowProblem(rows.axes[number], "", code, f"{many} {text}", at)
        for number, many, at in zip(numbers.tolist(), count.tolist(), times.tolist(), strict=True)
    ]


def pieces_of(rows: ShardRows, columns: Columns, length: float) -> Iterator[RecordPiece]:
    """The pieces of rows in order; length: of a slice [s]."""
    if not rows.time.size:
        return
    place = np.floor(rows.time / length)
    ends = np.flatnonzero((np.diff(rows.axis) != 0) | (np.diff(place) != 0)) + 1
    for first, last in zip([0, *ends], [*ends, rows.time.size], strict=True):
        steps = np.diff(rows.time[first:last])
        cuts = np.flatnonzero(steps > TUNING.rows_apart * np.median(steps)) + 1 + first if steps.size else ends[:0]
        for low, high in zip([first, *cuts], [*cuts, last], strict=True):
            time = rows.time[low:high]
            others = {name: values[low:high] for name, values in rows.others.items()}
            yield RecordPiece(rows.axes[rows.axis[low]], float(time[0]), {columns.time: time - time[0], **others})

"""The rows of a shard, in order and each sample once, cut at the end of an axis, a slice or the recording."""

from __future__ import annotations

import shutil
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Lock

import numpy as np
import polars as pl
from numpy.typing import NDArray

from pmfid.errors import UsageError
from pmfid.fleet.plan import EXTENT, PART, ROWS, RowProblem, RowShard
from pmfid.fleet.source import AXIS, TIME, Part, SourceColumns
from pmfid.fleet.tuning import TUNING
from pmfid.io.safety import readable
from pmfid.io.tables import Table
from pmfid.types import Flags, Floats

#: Prefix of the folders that keep rows by shard during a call.
ASIDE = "aside-"


def find_mixed_parts(rows: pl.DataFrame, shards: Sequence[RowShard]) -> set[str]:
    """Return the names of the parts whose rows are kept by shard. The rows come from the `Survey`.

    The shard of an axis reads the whole stretch of a file that contains rows of the axis. No shard reads more than the
    whole file.
    """
    readers = Counter(name for shard in shards for name in shard.parts)
    many = rows.group_by(PART).agg(pl.col(EXTENT).sum() / pl.col(ROWS).sum().alias("times"))
    return {name for name, times in many.iter_rows() if min(times, readers[name]) > TUNING.aside_times}


@dataclass(frozen=True)
class _Laid:
    """The stored rows of a part.

    `axes` has the names by number. `places` maps a shard to the first row and the number of rows of each stretch.
    `error` is the reason if no rows are stored.
    """

    path: Path
    axes: tuple[str, ...]
    places: Mapping[RowShard, Sequence[tuple[int, int]]]
    error: UsageError | None = None


class Aside:
    """A store on the disk for rows of files that mix many axes row by row.

    Each file is read once, and its rows are kept by shard. Without these folders every shard would read every file that
    mixes axes as a whole. The rows are raw, and are removed after the last shard that needs them. `folder` contains the
    folder of the rows. None takes the folder for temporary files. The caller must close this object. `length` is the
    duration of a slice [s].
    """

    def __init__(
        self,
        parts: Mapping[str, Part],
        shards: Sequence[RowShard],
        columns: SourceColumns,
        length: float,
        folder: Path | None,
    ) -> None:
        self._parts, self._columns, self._length = parts, columns, length
        self._kind = np.dtype([(AXIS, np.uint32), *((name, np.float64) for name in columns.carried[1:])])
        self._lock = Lock()
        self._laid: dict[str, _Laid] = {}
        self._waiting: dict[str, list[RowShard]] = defaultdict(list)
        for shard in shards:
            for name in set(shard.parts) & parts.keys():
                self._waiting[name].append(shard)
        self._readers = {name: len(waiting) for name, waiting in self._waiting.items()}
        self._folder = Path(tempfile.mkdtemp(prefix=ASIDE, dir=folder))

    def close(self) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)

    def __contains__(self, name: str) -> bool:
        return name in self._waiting

    def prepare(self, shard: RowShard) -> None:
        """Store the rows that the shard needs. Raises UsageError if the disk is full.

        For a part that cannot be read, the error is raised when its rows are requested.
        """
        for name in shard.parts:
            if name in self:
                with self._lock:  # only one part at a time, so that the memory does not depend on the number of threads
                    if name not in self._laid:
                        self._laid[name] = self._lay(name)

    def only(self, shards: Sequence[RowShard]) -> None:
        """Note that only rows of these shards will be requested."""
        wanted = set(shards)
        for one in {shard for waiting in self._waiting.values() for shard in waiting} - wanted:
            self.release(one)

    def release(self, shard: RowShard) -> None:
        """Remove the rows for which this shard was the last reader."""
        for name in shard.parts:
            if name in self:
                with self._lock:
                    self._readers[name] -= 1
                    if not self._readers[name] and name in self._laid:
                        self._laid[name].path.unlink(missing_ok=True)

    def read(self, name: str, shard: RowShard) -> dict[str, NDArray[np.generic]]:
        """Return the rows of a shard from one part whose rows are kept by shard.

        The rows have the number of the axis in the shard, and the columns of `source`. Raises UsageError if the part
        could not be read.
        """
        laid = self._laid[name]
        if laid.error is not None:
            raise UsageError(str(laid.error))
        places = laid.places.get(shard, ())
        rows = np.empty(sum(many for _, many in places), self._kind)
        filled = 0
        with laid.path.open("rb") as file:
            for first, many in places:
                file.seek(first * self._kind.itemsize)
                rows[filled : filled + many] = np.fromfile(file, self._kind, many)
                filled += many
        numbers = np.zeros(len(laid.axes), np.uint32)
        own = {axis: k for k, axis in enumerate(shard.axes)}
        numbers[:] = [own.get(axis, 0) for axis in laid.axes]
        found: dict[str, NDArray[np.generic]] = {field: rows[field].copy() for field in self._kind.names or ()}
        return found | {AXIS: numbers[rows[AXIS]]}

    def _lay(self, name: str) -> _Laid:
        part, waiting = self._parts[name], self._waiting[name]
        path = self._folder / f"{len(self._laid)}.rows"
        target = ShardTable(waiting, self._length)
        places: dict[RowShard, list[tuple[int, int]]] = defaultdict(list)
        written = 0
        try:
            with path.open("wb") as file:
                for batch in _batches(part, target, self._columns):
                    numbers = target.find(batch[AXIS], batch[TIME])
                    order = np.argsort(numbers, kind="stable")
                    order = order[np.searchsorted(numbers[order], 0) :]
                    for shard, many in zip(waiting, np.bincount(numbers[order], minlength=len(waiting)), strict=True):
                        if many:
                            places[shard].append((written, int(many)))
                            written += int(many)
                    file.write(self._pack_rows(batch, order).data)
        except UsageError as error:
            path.unlink(missing_ok=True)
            return _Laid(path, target.axes, {}, error)
        except OSError as error:
            raise UsageError(
                f"{self._folder.parent}: {error.strerror or error}; {name} mixes the rows of its axes, and "
                f"pmfid sorts them on this disk, with {self._kind.itemsize} bytes a row: free some space, or "
                "choose another folder"
            ) from None
        return _Laid(path, target.axes, places)

    def _pack_rows(self, batch: Mapping[str, NDArray[np.generic]], order: NDArray[np.intp]) -> NDArray[np.void]:
        rows = np.empty(order.size, self._kind)
        for field in self._kind.names or ():
            rows[field] = batch[field][order]
        return rows


def _batches(part: Part, target: ShardTable, columns: SourceColumns) -> Iterator[_Columns]:
    """Yield the rows of a part that belong to known axes, some rows at a time. Raises UsageError for a damaged part."""
    with readable("data"):
        for window in part.windows():
            frame = window.rows(columns).select(target.number, *columns.carried[1:]).drop_nulls([AXIS, TIME])
            for batch in frame.collect_batches(chunk_size=TUNING.aside_batch, engine="streaming"):
                yield _columns(batch)


class ShardTable:
    """A table that finds the shard of a row.

    The `shards` share no row. `length` is the duration of a slice [s]. `axes` has the sorted names of all shards.
    `times` (n,) has the times at which shards begin or end [s].
    """

    def __init__(self, shards: Sequence[RowShard], length: float) -> None:
        self.axes = tuple(sorted({axis for shard in shards for axis in shard.axes}))
        edges = np.unique([edge for shard in shards for edge in (shard.first, shard.last)])
        number = {axis: k for k, axis in enumerate(self.axes)}
        # A column before or after all edges belongs to no axis.
        self._table = np.full((len(self.axes), edges.size + 1), -1, np.int32)
        for k, shard in enumerate(shards):
            first, last = np.searchsorted(edges, [shard.first, shard.last])
            self._table[[number[axis] for axis in shard.axes], first + 1 : last + 1] = k
        self.times = edges * length

    @property
    def number(self) -> pl.Expr:
        """Expression for the number of an axis in place of its name, null for other axes."""
        return pl.col(AXIS).cast(pl.Enum(self.axes), strict=False).to_physical().cast(pl.UInt32).alias(AXIS)

    def find(self, axis: NDArray[np.generic], time: NDArray[np.generic]) -> NDArray[np.int32]:
        """Return the index (n,) of the shard of each row, -1 for no shard, from axis number (n,) and time (n,) [s]."""
        found: NDArray[np.int32] = self._table[axis, np.searchsorted(self.times, time, "right")]
        return found


#: Problem of a file that changed while it was read. The next call reads the file again, because its stamp has changed.
REWRITTEN = "the file changed while pmfid read it: run the command again once the file is complete"
#: Columns of rows by their name in `source`.
_Columns = Mapping[str, NDArray[np.generic]]


@dataclass(frozen=True)
class ShardRows:
    """Rows in order. `axis` (n,) are numbers in `axes`, `time` (n,) is in s, and `others` has further columns (n,) by
    name.
    """

    axes: tuple[str, ...]
    axis: NDArray[np.uint32]
    time: Floats
    others: dict[str, Floats]

    def __getitem__(self, kept: Flags | NDArray[np.intp] | slice) -> ShardRows:
        others = {name: values[kept] for name, values in self.others.items()}
        return ShardRows(self.axes, self.axis[kept], self.time[kept], others)


@dataclass(frozen=True)
class RecordPiece:
    """Rows of one axis and one slice without a gap.

    `start` is the time of the first sample [s]. `table` has the columns by their name in the data, with the time
    counted from the start.
    """

    axis: str
    start: float
    table: Table


def read_rows(
    shard: RowShard, parts: Mapping[str, Part], columns: SourceColumns, length: float, aside: Aside | None = None
) -> tuple[ShardRows, tuple[RowProblem, ...]]:
    """Return the rows of a shard in order.

    Of equal rows one is kept, of contradictory rows none. `length` is the duration of a slice [s]. `aside` has the rows
    of parts that are kept by shard. Parts that cannot be read have problems in place of rows.
    """
    frames, problems = list[_Columns](), list[RowProblem]()
    if aside is not None:
        aside.prepare(shard)
    for name in shard.parts:
        try:
            if aside is not None and name in aside:
                frames.append(aside.read(name, shard))
            else:
                with readable("data"):
                    frames += [_window(one, shard, columns, length) for one in parts[name].windows()]
        except UsageError as error:
            problems.append(RowProblem("", name, "unreadable", " ".join(str(error).split())))
        if parts[name].rewritten:
            problems.append(RowProblem("", name, "rewritten", REWRITTEN))
    rows, found = _order_rows(_arrays(frames, shard.axes, columns))
    return rows, (*problems, *found)


def _window(part: Part, shard: RowShard, columns: SourceColumns, length: float) -> _Columns:
    """Return the rows of a shard in one window of a part. The axes have their numbers in the shard."""
    low, high, axis, time = shard.first * length, shard.last * length, pl.col(AXIS), pl.col(TIME)
    frame = part.rows(columns).select(columns.carried)
    if not part.sliced:  # the part may be larger than the memory
        named = pl.lit(True) if columns.axis in part.constants else axis.is_in(list(shard.axes))
        frame = frame.filter(named & (time >= low) & (time < high))
    read = frame.collect(engine="streaming")
    found = dict(_columns(read.drop(AXIS)))
    found[AXIS], mine = _number_axes(read[AXIS], shard.axes)
    times = np.asarray(found[TIME], np.float64)
    inside = (times >= low) & (times < high)
    if mine.all() and inside.all():
        return found
    return {name: values[mine & inside] for name, values in found.items()}


def _number_axes(names: pl.Series, axes: Sequence[str]) -> tuple[NDArray[np.uint32], Flags]:
    """Return the index (n,) of each name among the axes, and whether the name is one of them, (n,).

    Each run of equal names is looked up once.
    """
    runs = names.rle()
    numbers = runs.struct.field("value").cast(pl.Enum(list(axes)), strict=False).to_physical().cast(pl.UInt32)
    known, many = numbers.is_not_null().to_numpy(), runs.struct.field("len").to_numpy()
    return np.repeat(numbers.fill_null(0).to_numpy(), many), np.repeat(known, many)


def _columns(frame: pl.DataFrame) -> _Columns:
    return {name: frame[name].to_numpy() for name in frame.columns}


def _arrays(frames: Sequence[_Columns], axes: tuple[str, ...], columns: SourceColumns) -> ShardRows:
    def join(name: str) -> Floats:
        parts = [frame[name] for frame in frames]
        return np.asarray(parts[0] if len(parts) == 1 else np.concatenate(parts) if parts else np.empty(0))

    named = columns.named
    others = {named[own]: join(own) for own in columns.carried[2:]}
    return ShardRows(axes, join(AXIS).astype(np.uint32, copy=False), join(TIME), others)


def rows_of(frame: pl.DataFrame, columns: SourceColumns) -> tuple[ShardRows, tuple[RowProblem, ...]]:
    """Return the rows of a frame with the columns of `source`, in any order."""
    axes = tuple(sorted(frame[AXIS].drop_nulls().unique().to_list()))
    named = pl.col(AXIS).cast(pl.Enum(list(axes))).to_physical()
    known = frame.filter(pl.col(TIME).is_finite()).drop_nulls(AXIS).with_columns(named)
    return _order_rows(_arrays([_columns(known)], axes, columns))


def _order_rows(rows: ShardRows) -> tuple[ShardRows, tuple[RowProblem, ...]]:
    """Sort rows by axis and time, without repeated and contradictory rows."""
    if _increasing(rows):
        return rows, ()
    by_axis = rows[np.argsort(rows.axis, kind="stable")]  # enough if the rows of each axis are in order
    if _increasing(by_axis):
        return by_axis, ()
    # The remaining values are keys, so that the order of files has no effect.
    keys: list[Floats] = [*rows.others.values(), rows.time, rows.axis.astype(np.float64)]
    return unique(rows[np.lexsort(keys)])


def _increasing(rows: ShardRows) -> bool:
    axis, later = rows.axis, rows.time[1:] > rows.time[:-1]
    return bool(np.all((axis[1:] > axis[:-1]) | ((axis[1:] == axis[:-1]) & later)))


def unique(rows: ShardRows) -> tuple[ShardRows, tuple[RowProblem, ...]]:
    """Remove repeated rows, and all rows of one time that contradict each other."""
    again = np.r_[False, (np.diff(rows.axis) == 0) & (np.diff(rows.time) == 0)]
    if not np.any(again):
        return rows, ()
    equal = np.ones(again.size, bool)
    for values in rows.others.values():
        equal[1:] &= (values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
    group = np.cumsum(~again)
    contradicted = np.isin(group, group[again & ~equal])
    problems = _report_rows(
        rows, again & ~contradicted, "duplicates", "rows are repeated without a difference: one of each counts"
    )
    problems += _report_rows(
        rows, contradicted, "contradictions", "rows repeat the time of another row with other values: they are left out"
    )
    return rows[~again & ~contradicted], tuple(problems)


def _report_rows(rows: ShardRows, which: Flags, code: str, text: str) -> list[RowProblem]:
    numbers, first, count = np.unique(rows.axis[which], return_index=True, return_counts=True)
    times = rows.time[which][first]
    return [
        RowProblem(rows.axes[number], "", code, f"{many} {text}", at)
        for number, many, at in zip(numbers.tolist(), count.tolist(), times.tolist(), strict=True)
    ]


def pieces_of(rows: ShardRows, columns: SourceColumns, length: float) -> Iterator[RecordPiece]:
    """Yield the pieces of rows, in order. `length` is the duration of a slice [s]."""
    if not rows.time.size:
        return
    place = np.floor(rows.time / length)
    ends = np.flatnonzero((rows.axis[1:] != rows.axis[:-1]) | (place[1:] != place[:-1])) + 1
    for first, last in zip([0, *ends], [*ends, rows.time.size], strict=True):
        cuts = _find_gaps(rows.time[first:last]) + first
        for low, high in zip([first, *cuts], [*cuts, last], strict=True):
            time = rows.time[low:high]
            others = {name: values[low:high] for name, values in rows.others.items()}
            yield RecordPiece(rows.axes[rows.axis[low]], float(time[0]), {columns.time: time - time[0], **others})


def _find_gaps(time: Floats) -> NDArray[np.intp]:
    """Return the rows (k,) after a gap, from rising times (n,) [s]."""
    steps = np.diff(time)
    if steps.size == 0 or steps.max() <= TUNING.rows_apart * steps.min():  # no median can be smaller
        return np.empty(0, np.intp)
    return np.flatnonzero(steps > TUNING.rows_apart * np.median(steps)) + 1

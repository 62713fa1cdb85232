"""Engines, and their work on parts of a history."""

from __future__ import annotations

import math
import os
from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from threading import Condition
from typing import ClassVar, Protocol, TypeVar

import polars as pl

from pmfid.errors import UsageError, whole_number
from pmfid.fleet.edge_segments import solve_edges
from pmfid.fleet.plan import Places, RowProblem, RowShard, Survey, content, join_surveys, survey_part
from pmfid.fleet.rows import Aside, RecordPiece, ShardRows, find_mixed_parts, pieces_of, read_rows, rows_of
from pmfid.fleet.segments import Segments, solve
from pmfid.fleet.settings import Settings
from pmfid.fleet.source import Part, SourceColumns
from pmfid.fleet.store import Keep, digest
from pmfid.fleet.tuning import TUNING
from pmfid.io.tables import Table

A = TypeVar("A")
B = TypeVar("B")


class Engine(Protocol):
    """The place where the work of a history is done."""

    name: ClassVar[str]

    def map(self, work: Callable[[A], B], items: Sequence[A]) -> Iterator[B]:
        """Yield the result of `work` for each item, in the order of the items."""
        ...


@dataclass(frozen=True)
class Local:
    """An engine of threads on this machine.

    `workers` is the number of threads, by default one for each processor. A `RowBudget` limits how many threads have a
    shard in memory.
    """

    name: ClassVar[str] = "local"
    workers: int | None = None

    def __post_init__(self) -> None:
        if self.workers is not None:
            whole_number(
                "workers", self.workers, 1, "it is the number of threads; None uses one thread for each processor"
            )

    def map(self, work: Callable[[A], B], items: Sequence[A]) -> Iterator[B]:
        """Yield the result of `work` for each item, in order.

        At any time, at most one item and one waiting result exist for each worker.
        """
        processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
        many = self.workers or processors or 1
        with ThreadPoolExecutor(many) as pool:
            waiting: deque[Future[B]] = deque()
            try:
                for item in items:
                    waiting.append(pool.submit(work, item))
                    if len(waiting) > 2 * many:
                        yield waiting.popleft().result()
                while waiting:
                    yield waiting.popleft().result()
            finally:
                for future in waiting:
                    future.cancel()


class RowBudget:
    """A budget for the rows that threads have in memory together, independent of the number of processors."""

    def __init__(self, rows: int) -> None:
        self._rows, self._used = rows, 0
        self._freed = Condition()

    @contextmanager
    def reserve(self, rows: int) -> Iterator[None]:
        """Wait until this number of rows fits into the budget. A larger request waits for the whole budget."""
        own = min(rows, self._rows)
        with self._freed:
            self._freed.wait_for(lambda: self._used + own <= self._rows)
            self._used += own
        try:
            yield
        finally:
            with self._freed:
                self._used -= own
                self._freed.notify_all()


#: Number of shards, and of first axes in each, that may yield the configuration.
TRIED = 5


@dataclass(frozen=True)
class Work:
    """The work on parts of a history, with its settings and columns. `length` is the duration of a slice [s]."""

    settings: Settings
    columns: SourceColumns
    length: float

    def shard(self, shard: RowShard, parts: Mapping[str, Part], aside: Aside | None = None) -> Segments:
        """Return the segments of a shard. The rows come from the shard's files, or from the folder of rows kept by
        shard.
        """
        return self._solve(*read_rows(shard, parts, self.columns, self.length, aside))

    def frame(self, frame: pl.DataFrame) -> Segments:
        """Return the segments of rows that an engine has gathered, in any order.

        All rows of a slice of an axis must be present. `frame` has the columns of `source`.
        """
        return self._solve(*rows_of(frame, self.columns))

    def _solve(self, rows: ShardRows, problems: tuple[RowProblem, ...]) -> Segments:
        solve_all = solve if self.columns.age is None else solve_edges
        found = solve_all(pieces_of(rows, self.columns, self.length), self.settings)
        return Segments(found.rows, (*problems, *found.problems))


def first_table(frame: pl.DataFrame, columns: SourceColumns, length: float) -> Table | None:
    """Return the table of the longest piece in the first slice, from gathered rows of one axis, or None without a
    piece.
    """
    pieces = list(pieces_of(rows_of(frame, columns)[0], columns, length))
    first = [one for one in pieces if one.start // length == pieces[0].start // length]
    return longest(first, columns) if pieces else None


def longest(pieces: Sequence[RecordPiece], columns: SourceColumns) -> Table:
    return max(pieces, key=lambda piece: len(piece.table[columns.time])).table  # type: ignore[arg-type]


def check_columns(columns: SourceColumns, parts: Sequence[Part], found: Survey) -> None:
    """Raise UsageError if no part has rows with the named columns."""
    if found.rows.height:
        return
    for part in parts[:1]:
        try:
            part.rows(columns)
        except UsageError as error:
            raise UsageError(f"{part.name}: {error}") from None
    reason = next((f": {one.part}: {one.text}" for one in found.problems if one.code == "unreadable"), "")
    raise UsageError(f"no file of the data set could be read{reason}; run pmfid check on one of the files")


#: Number of full shards that one machine holds in memory at a time, for any number of threads.
FULL = 3


class Parts:
    """Files or frames in memory, each of them a part. `SparkRows` has the same methods for rows that stay in Spark."""

    def __init__(self, parts: Sequence[Part], columns: SourceColumns, engine: Engine) -> None:
        self._parts = {part.name: part for part in parts}
        self._columns, self._engine = columns, engine
        self._aside: Aside | None = None
        self._places: Places | None = None

    @property
    def engine(self) -> str:
        """Name of the engine that does the work."""
        return self._engine.name

    def survey(self, keep: Keep) -> Survey:
        """Find all axes and their times. This call comes first.

        Parts that cannot be read are problems. Raises UsageError if no part can be read.
        """
        if keep.lasting:
            # A frame has no date, so its content is its stamp.
            frames = {name: part for name, part in self._parts.items() if not part.stamp}
            stamped = {name: replace(part, stamp=content(part, self._columns)) for name, part in frames.items()}
            self._parts = {name: stamped.get(name, part) for name, part in self._parts.items()}
        parts = list(self._parts.values())
        keys = [digest("survey", part.name, part.stamp, self._columns) for part in parts]
        work = partial(survey_part, columns=self._columns)
        kept = keep.fetch(keys, lambda missing: self._engine.map(work, [parts[k] for k in missing]), here=True)
        found = join_surveys([Survey(one.rows(), one.problems) for one in kept])
        check_columns(self._columns, parts, found)
        self._places = Places({part.name for part in parts if part.sliced}, found.rows)
        return found

    @contextmanager
    def prepare_shards(
        self, shards: Sequence[RowShard], survey: Survey, length: float, folder: Path | None
    ) -> Iterator[None]:
        """Open a context for all work on these shards of the survey.

        Within the context, rows of files that mix axes are kept by shard. An engine of many machines shuffles mixed
        files itself. The rows go into `folder`, by default the folder of temporary files.
        """
        names = find_mixed_parts(survey.rows, shards) if isinstance(self._engine, Local) else set()
        if not names:
            yield
            return
        parts = {name: self._parts[name] for name in names}
        with closing(Aside(parts, shards, self._columns, length, folder)) as self._aside:
            yield
        self._aside = None

    def stamp(self, shard: RowShard, length: float) -> object:
        """Return a value that changes with the rows of a shard."""
        return [(name, self._parts[name].stamp) for name in shard.parts]

    def tables(self, shards: Sequence[RowShard], length: float) -> Iterator[Table]:
        """Yield the longest piece of the first slice with a piece, for each of the first axes."""
        for shard in shards[:TRIED]:
            rows, _ = read_rows(shard, self._select_rows(shard, length), self._columns, length, self._aside)
            slices: dict[str, dict[int, list[RecordPiece]]] = defaultdict(lambda: defaultdict(list))
            for piece in pieces_of(rows, self._columns, length):
                slices[piece.axis][math.floor(piece.start / length)].append(piece)
            for axis in sorted(slices)[:TRIED]:
                yield longest(slices[axis][min(slices[axis])], self._columns)

    def _select_rows(self, shard: RowShard, length: float) -> dict[str, Part]:
        """Return the parts of a shard, each limited to a range of rows that contains the shard's rows."""
        parts = {name: self._parts[name] for name in shard.parts}
        if self._places is None:
            return parts
        return {name: self._places.narrow(part, shard, length) for name, part in parts.items()}

    def segments(self, work: Work, shards: Sequence[RowShard]) -> Iterator[Segments]:
        """Yield the segments of each shard, in order."""
        items = [(shard, self._select_rows(shard, work.length)) for shard in shards]
        if self._aside is not None:
            self._aside.only(shards)
        room = RowBudget(FULL * TUNING.plan_budget) if isinstance(self._engine, Local) else None
        return self._engine.map(partial(_solve_shard, work, self._aside, room), items)


def _solve_shard(
    work: Work, aside: Aside | None, room: RowBudget | None, item: tuple[RowShard, dict[str, Part]]
) -> Segments:
    shard, parts = item
    with nullcontext() if room is None else room.reserve(shard.rows):
        found = work.shard(shard, parts, aside)
    if aside is not None:
        aside.release(shard)
    return found

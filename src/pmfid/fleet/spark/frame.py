"""Histories in Spark's frames."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import cached_property, partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, cast

import polars as pl

from pmfid import __version__
from pmfid.errors import UsageError
from pmfid.fleet.data import TRIED, Engine, Work, check_columns, first_table
from pmfid.fleet.plan import FIRST, LAST, LOST, ROWS, RowShard, Survey, count_rows, mixture, survey_of
from pmfid.fleet.rows import ShardTable
from pmfid.fleet.segments import Segments
from pmfid.fleet.source import AGE, AXIS, FRAME, INPUT, MASK, OUTPUT, TIME, TYPE, Part, SourceColumns
from pmfid.fleet.spark.engine import (
    NUMBER,
    RETURNED,
    Spark,
    answer_task,
    arrow_of,
    collect_answers,
    merge_batches,
    return_answers,
)
from pmfid.fleet.store import Keep
from pmfid.fleet.tuning import TUNING
from pmfid.io.tables import Table

if TYPE_CHECKING:
    import pyarrow as pa
    from pyspark.sql import Column, DataFrame

_PLACE = "place"


def tag_rows(rows: pl.LazyFrame, columns: SourceColumns, plan: ShardTable) -> pl.DataFrame:
    """Return the rows of each shard, with the index of the shard. The rows come from `Part.rows`."""
    known = rows.select(plan.number.alias(_PLACE), *columns.carried).drop_nulls([_PLACE, TIME]).collect()
    shard = plan.find(known[_PLACE].to_numpy(), known[TIME].to_numpy())
    return known.select(pl.Series(NUMBER, shard), *columns.carried).filter(pl.col(NUMBER) >= 0)


def jobs_of(shards: Sequence[RowShard]) -> list[list[RowShard]]:
    """Return the shards in order, divided into jobs with the shards of some blocks of time."""
    blocks: dict[int, list[RowShard]] = defaultdict(list)
    for shard in shards:
        blocks[shard.first // TUNING.plan_block].append(shard)
    jobs: list[list[RowShard]] = []
    enough = sum(shard.rows for shard in shards) / TUNING.frame_jobs
    for block in sorted(blocks):
        if jobs and sum(shard.rows for shard in jobs[-1]) < enough:
            jobs[-1] += blocks[block]
        else:
            jobs.append(blocks[block])
    return jobs


#: Sum that represents the content of an axis' rows on a day.
MIXED = "mixed"
_DAY = "day"


class SparkRows:
    """A DataFrame whose rows stay in Spark. Raises UsageError for an engine other than None or Spark."""

    def __init__(self, frame: object, columns: SourceColumns, engine: Engine | None) -> None:
        if engine is not None and not isinstance(engine, Spark):
            raise UsageError(
                f"a Spark DataFrame is processed by Spark, not by the engine {engine.name}: leave out the "
                "engine, or give frame.toArrow() if the data fit into this machine's memory"
            )
        self._whole, self._columns = cast("DataFrame", frame), columns
        mask, kind = (MASK if columns.mask else None), (TYPE if columns.type else None)
        age = AGE if columns.age else None
        self._own = SourceColumns(AXIS, TIME, INPUT, OUTPUT, mask, kind, columns.factor, age)

    @property
    def engine(self) -> str:
        return Spark.name

    def survey(self, keep: Keep) -> Survey:
        """Return the survey from one pass, which stores nothing, because the stamps come from the survey.

        Raises UsageError for missing columns.
        """
        try:
            odd = self._part.other_types(self._columns)
            self._part.rows(self._columns)
        except UsageError as error:
            raise UsageError(f"the DataFrame: {error}") from None
        found = survey_of(FRAME, self._counts, odd, self._columns.factor)
        check_columns(self._columns, [self._part], found)
        return found

    def prepare_shards(
        self, shards: Sequence[RowShard], survey: Survey, length: float, folder: Path | None
    ) -> AbstractContextManager[None]:
        return nullcontext()

    def stamp(self, shard: RowShard, length: float) -> object:
        low, high = shard.first * length, shard.last * length
        days = [day for axis in shard.axes for day in self._days.get(axis, ())]
        return [day for day in days if day[0] < high and day[1] >= low]

    def tables(self, shards: Sequence[RowShard], length: float) -> Iterator[Table]:
        for shard in shards[:TRIED]:
            yield from islice(self._first_tables(shard, length), TRIED)

    def _first_tables(self, shard: RowShard, length: float) -> Iterator[Table]:
        """Yield the first tables of the axes with rows, some axes at a time."""
        axes, work = sorted(shard.axes), partial(first_table, columns=self._columns, length=length)
        for start in range(0, len(axes), TRIED):
            some = [RowShard((axis,), shard.first, shard.last, shard.parts, 0) for axis in axes[start : start + TRIED]]
            yield from (cast(Table, found) for found in self._gather_shards(some, length, work) if found is not None)

    def segments(self, work: Work, shards: Sequence[RowShard]) -> Iterator[Segments]:
        """Yield the segments of the shards, with some blocks of time in a job.

        If the files are in the order of time, each job reads only its own times.
        """
        for job in jobs_of(shards):
            yield from (cast(Segments, found) for found in self._gather_shards(job, work.length, work.frame))

    @cached_property
    def _days(self) -> dict[str, list[tuple[float, float, int, int]]]:
        """First and last time [s], number of rows and content sum for each day of each axis."""
        found = defaultdict(list)
        for axis, *day in self._counts.drop_nulls([AXIS, FIRST]).select(AXIS, FIRST, LAST, ROWS, MIXED).iter_rows():
            found[axis].append(tuple(day))
        return dict(found)

    @cached_property
    def _frame(self) -> DataFrame:
        """The needed columns under their own names, because Spark interprets a dot in a name."""
        from pyspark.sql import functions as sql

        quoted = {own: "`" + name.replace("`", "``") + "`" for own, name in self._columns.named.items()}
        return self._whole.select([sql.col(name).alias(own) for own, name in quoted.items()])

    @cached_property
    def _part(self) -> Part:
        """The columns of the part, without rows."""
        nothing = cast(pl.DataFrame, pl.from_arrow(arrow_of(self._whole.limit(0))))
        return Part(FRAME, "", nothing.lazy)

    @cached_property
    def _counts(self) -> pl.DataFrame:
        """Counts for each axis and day."""
        from pyspark.sql import functions as sql

        kinds = f"{AXIS} string, {_DAY} double, {ROWS} long, {LOST} long, {FIRST} double, {LAST} double, "
        partly = self._frame.mapInArrow(_counter(self._own), f"{kinds}{TYPE} string, {MIXED} long")
        sums = [sql.sum(name).alias(name) for name in (ROWS, LOST, MIXED)]
        ends = [sql.min(FIRST).alias(FIRST), sql.max(LAST).alias(LAST), sql.min(TYPE).alias(TYPE)]
        found = pl.from_arrow(arrow_of(partly.groupBy(AXIS, _DAY).agg(*sums, *ends)))
        return cast(pl.DataFrame, found).sort(AXIS, _DAY, nulls_last=True)

    def _gather_shards(
        self, shards: Sequence[RowShard], length: float, work: Callable[[pl.DataFrame], object]
    ) -> list[object]:
        """Return the results of `work` on the rows of each shard. All rows of a shard come together, in any order."""
        if not shards:
            return []
        plan = ShardTable(shards, length)
        near = self._frame.where(self._bound_times(plan.times[0], plan.times[-1]))
        kinds = ", ".join(f"{name} {'string' if name == AXIS else 'double'}" for name in self._columns.carried)
        tagged = near.mapInArrow(_tagger(self._own, plan), f"{NUMBER} int, {kinds}")
        together = tagged.repartitionById(len(shards), NUMBER)
        found = collect_answers(together.mapInArrow(_worker(work, __version__), RETURNED))
        nothing = self._part.rows(self._columns).select(self._columns.carried).collect()
        return [found[k] if k in found else work(nothing) for k in range(len(shards))]

    def _bound_times(self, first: float, last: float) -> Column:
        """Return a condition by which Spark leaves out files, for times from first to last [s] with a margin.

        The exact rows are chosen later.
        """
        from pyspark.sql import functions as sql
        from pyspark.sql.types import NumericType, TimestampType

        kind, time = self._frame.schema[TIME].dataType, sql.col(TIME)
        if isinstance(kind, NumericType):
            low, high = first / self._columns.factor, last / self._columns.factor
            return time.between(low - abs(low) * 1e-9 - 1, high + abs(high) * 1e-9 + 1)
        if isinstance(kind, TimestampType) and abs(first) < 1e11 and abs(last) < 1e11:
            return time.between(sql.timestamp_seconds(sql.lit(first - 1)), sql.timestamp_seconds(sql.lit(last + 1)))
        return sql.lit(True)


def _rows(table: pa.Table, columns: SourceColumns) -> pl.LazyFrame:
    frame = cast(pl.DataFrame, pl.from_arrow(table))
    return Part(FRAME, "", frame.lazy).rows(columns)


def _batches(frame: pl.DataFrame) -> Iterator[pa.RecordBatch]:
    """Yield record batches with the types of Spark, which has only one type of text."""
    import pyarrow as pa

    table = frame.to_arrow()
    kinds = {pa.large_string(): pa.string(), pa.string_view(): pa.string()}
    schema = pa.schema([(field.name, kinds.get(field.type, field.type)) for field in table.schema])
    yield from table.cast(schema).to_batches()


Task = Callable[[Iterator["pa.RecordBatch"]], Iterator["pa.RecordBatch"]]


def _counter(columns: SourceColumns) -> Task:
    def count(batches: Iterator[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
        for table in merge_batches(batches):
            rows = _rows(table, columns).with_columns(mixture(columns).alias(MIXED))
            found = count_rows(rows, columns, pl.col(MIXED).sum()).collect()
            yield from _batches(found.select(AXIS, _DAY, ROWS, LOST, FIRST, LAST, TYPE, MIXED))

    return count


def _tagger(columns: SourceColumns, plan: ShardTable) -> Task:
    def tag(batches: Iterator[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
        for table in merge_batches(batches):
            yield from _batches(tag_rows(_rows(table, columns), columns, plan))

    return tag


def _worker(work: Callable[[pl.DataFrame], object], version: str) -> Task:
    def act(batches: Iterator[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
        import pyarrow as pa

        there = list(batches)
        if not there:
            return
        rows = cast(pl.DataFrame, pl.from_arrow(pa.Table.from_batches(there)))
        for (number,), shard in rows.partition_by(NUMBER, as_dict=True, include_key=False).items():
            yield return_answers([number], [answer_task(partial(work, shard), version)])

    return act

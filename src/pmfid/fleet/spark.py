"""The history of a Spark DataFrame, whose rows stay in Spark."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, cast

import polars as pl

from pmfid.errors import UsageError
from pmfid.fleet.evaluate import Work
from pmfid.fleet.source import AXIS, FRAME, SECONDS, TIME, TYPE, Part, SourceColumns
from pmfid.fleet.survey import END, FIRST, HOUR, LAST, ROWS, START, Survey, join_surveys, survey_of

if TYPE_CHECKING:
    import pyarrow as pa
    from pyspark.sql import DataFrame

NOT_THERE = (
    "the executors of Spark have no pmfid: install it in their Python (PYSPARK_PYTHON), or send "
    "an environment that contains it (spark.archives); see docs/howto/fleet.md"
)


def arrow_of(frame: DataFrame) -> pl.DataFrame:
    """Compute a frame. Raises UsageError if the executors have no package, or another version."""
    try:
        return cast(pl.DataFrame, pl.from_arrow(frame.toArrow()))
    except Exception as error:
        if "No module named 'pmfid" in str(error):
            raise UsageError(NOT_THERE) from None
        if refused := re.search(r"UsageError: (.*)", str(error)):
            raise UsageError(refused[1]) from None
        raise


class SparkRows:
    """A DataFrame whose rows stay in Spark. Raises UsageError for missing columns."""

    def __init__(self, frame: object, columns: SourceColumns) -> None:
        self._frame, self.given, self.columns = cast("DataFrame", frame), columns, columns.own
        self._part = Part(FRAME, arrow_of(self._frame.limit(0)).lazy)
        try:
            self._part.rows(columns)
        except UsageError as error:
            raise UsageError(f"the DataFrame: {error}") from None

    @cached_property
    def _rows(self) -> DataFrame:
        """The rows under their own names. Spark would interpret a dot in a name, so the columns are renamed first."""
        from pyspark.sql import functions as sql

        names = self.given.named
        chosen = [sql.col("`" + name.replace("`", "``") + "`").alias(own) for own, name in names.items()]
        own = replace(self.columns, factor=self.given.factor)

        def read(batches: Iterator[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
            for batch in batches:
                frame = cast(pl.DataFrame, pl.from_arrow(batch))
                yield from _batches(Part(FRAME, frame.lazy).rows(own).collect())

        kinds = ", ".join(f"`{key}` {'string' if key in (AXIS, TYPE) else 'double'}" for key in names)
        return self._frame.select(chosen).mapInArrow(read, kinds)

    def _number_hours(self) -> DataFrame:
        """The rows with the number of their hour, null for rows without an axis or a valid time."""
        from pyspark.sql import functions as sql

        known = sql.col(AXIS).isNotNull() & (sql.abs(TIME) < float("inf"))
        return self._rows.withColumn(HOUR, sql.when(known, sql.floor(sql.col(TIME) / SECONDS["h"])))

    def survey(self) -> Survey:
        from pyspark.sql import functions as sql

        ends = [sql.min(TIME).alias(FIRST), sql.max(TIME).alias(LAST)]
        kind = sql.coalesce(sql.min(TYPE), sql.lit("")) if self.columns.type else sql.lit("")
        counts = (
            self._number_hours().groupBy(AXIS, HOUR).agg(sql.count(sql.lit(1)).alias(ROWS), *ends, kind.alias(TYPE))
        )
        found = arrow_of(counts).with_columns(pl.lit(0, pl.Int64).alias(START), pl.lit(0, pl.Int64).alias(END))
        return join_surveys([survey_of(FRAME, found, self._part.other_types(self.given), self.given.factor)])

    def read(self, wanted: pl.DataFrame) -> pl.DataFrame:
        """Return the rows of some axes and hours."""
        from pyspark.sql import functions as sql

        pairs = self._frame.sparkSession.createDataFrame(wanted.select(AXIS, HOUR).to_arrow())
        chosen = self._number_hours().join(sql.broadcast(pairs), [AXIS, HOUR])
        return arrow_of(chosen.select(self.columns.carried))

    def evaluate(self, work: Work, tell: Callable[[float], None]) -> pl.DataFrame:
        """Return the results for all axes. Spark brings the hours of a day of each axis together."""
        from pyspark.sql import functions as sql

        def act(table: pa.Table) -> pa.Table:
            import pyarrow

            return pyarrow.Table.from_batches(_batches(work.evaluate(cast(pl.DataFrame, pl.from_arrow(table)))))

        day = sql.floor(sql.col(HOUR) * SECONDS["h"] / SECONDS["d"]).alias("day")
        rows = self._number_hours().where(sql.col(HOUR).isNotNull()).select(*self.columns.carried, day)
        kinds = {pl.String: "string", pl.Float64: "double", pl.Int64: "long", pl.List(pl.Float64): "array<double>"}
        schema = ", ".join(f"`{name}` {kinds[kind]}" for name, kind in work.schema.items())
        grouped = rows.groupBy(AXIS, "day").applyInArrow(act, schema)
        return arrow_of(grouped)


def _batches(frame: pl.DataFrame) -> list[pa.RecordBatch]:
    """Return record batches with the types of Spark, which has only one type of text and one of lists."""
    import pyarrow as pa

    table = frame.to_arrow()
    kinds = {pa.large_string(): pa.string(), pa.string_view(): pa.string()}
    kinds[pa.large_list(pa.float64())] = pa.list_(pa.float64())
    schema = pa.schema([(field.name, kinds.get(field.type, field.type)) for field in table.schema])
    return list(table.cast(schema).to_batches())

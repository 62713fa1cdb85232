"""Spark as the engine of a history. This module needs `pmfid[spark]` and a Java runtime."""

from __future__ import annotations

import os
import pickle
import re
import shutil
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, TypeVar, cast
from unittest import mock

import polars as pl

from pmfid.errors import UsageError
from pmfid.fleet.evaluate import Work
from pmfid.fleet.plan import END, FIRST, LAST, ROWS, SLICE, START, Survey, join_surveys, survey_of
from pmfid.fleet.source import AXIS, FRAME, TIME, TYPE, Part, SourceColumns
from pmfid.fleet.tuning import TUNING

A = TypeVar("A")
B = TypeVar("B")

if TYPE_CHECKING:
    import pyarrow as pa
    from pyspark.sql import DataFrame, SparkSession

#: Any of these variables shows that the user has set up Spark, or works in Spark. The settings of that Spark stay.
SET_UP = ("SPARK_REMOTE", "SPARK_HOME", "SPARK_CONF_DIR", "PYSPARK_GATEWAY_PORT", "PYSPARK_SUBMIT_ARGS")
LOOPBACK = "127.0.0.1"
NO_PYSPARK = "the engine spark needs PySpark 4.2 or later: pip install 'pmfid[spark]'"
NO_JAVA = (
    "Spark needs a Java runtime, version 17 or later, and finds none: apt install "
    "openjdk-17-jre-headless, or set JAVA_HOME"
)
#: Settings of a session on this machine. Only this machine can reach the session, which prints only errors.
QUIET = {
    "spark.driver.bindAddress": LOOPBACK,
    "spark.driver.host": LOOPBACK,
    "spark.ui.enabled": "false",
    "spark.ui.showConsoleProgress": "false",
    "spark.sql.session.timeZone": "UTC",
    # Each Python process has one core of the machine. Without a limit the process would start a thread for every core.
    "spark.executorEnv.POLARS_MAX_THREADS": "1",
    "spark.executorEnv.OMP_NUM_THREADS": "1",
    "spark.executorEnv.OPENBLAS_NUM_THREADS": "1",
}


def running() -> SparkSession | None:
    """Return the running session. Raises UsageError if PySpark is missing."""
    return _spark().getActiveSession()


def session_of(master: str | None = None, settings: Mapping[str, str] | None = None) -> SparkSession:
    """Return the running session, as on Databricks, or set up a new one.

    A new session follows the environment or `master`. By default it is a session of this machine with all its
    processors, which nobody else can reach. `master` has Spark's form, for example "local[2]", "spark://host:7077",
    "yarn", or "sc://host" (Spark Connect). `settings` belong to Spark. In a running session, only some settings can
    still change. Raises UsageError if PySpark or Java is missing, and if a session runs elsewhere than on `master`.
    """
    found, settings = running(), dict(settings or {})
    if found is not None:
        return _take_session(found, master, settings)
    remote = (master or os.environ.get("SPARK_REMOTE", "")).startswith("sc://")
    if not remote and not _java():
        raise UsageError(NO_JAVA)
    if not is_own(master):
        builder = _spark().builder.appName("pmfid").config(map=settings)
        place = builder if master is None else builder.remote(master) if remote else builder.master(master)
        return place.getOrCreate()
    options = f"-Dlog4j2.configurationFile={Path(__file__).with_name('log4j2.properties').as_uri()}"
    builder = _spark().builder.appName("pmfid").master(master or "local[*]")
    with _own_environment():
        made = builder.config(map=QUIET | {"spark.driver.extraJavaOptions": options} | settings).getOrCreate()
    warnings.filterwarnings("ignore", "PySpark does not yet fully support pandas", FutureWarning)
    return made


def is_own(master: str | None) -> bool:
    """Return whether a running session is a local one that nobody has configured."""
    return master.startswith("local") if master is not None else not any(name in os.environ for name in SET_UP)


def _take_session(found: SparkSession, master: str | None, settings: Mapping[str, str]) -> SparkSession:
    there = found.conf.get("spark.master", None)
    if master is not None and there is not None and there != master:
        raise UsageError(
            f"a Spark session is already running on {there}; leave out the master {master}, or stop that session first"
        )
    for name, value in settings.items():
        if found.conf.isModifiable(name):
            found.conf.set(name, value)
    return found


def _spark() -> type[SparkSession]:
    try:
        from pyspark.sql import SparkSession
    except ImportError:
        raise UsageError(NO_PYSPARK) from None
    found: type[SparkSession] = SparkSession
    return found


def _java() -> bool:
    home = os.environ.get("JAVA_HOME")
    return shutil.which("java", path=f"{home}/bin" if home else None) is not None


@contextmanager
def _own_environment() -> Iterator[None]:
    """Let Spark start the Python of this process, and ask no name server for this machine."""
    own = {"PYSPARK_PYTHON": sys.executable, "SPARK_LOCAL_IP": LOOPBACK}
    with mock.patch.dict(os.environ, {name: value for name, value in own.items() if name not in os.environ}):
        yield


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


@dataclass(frozen=True)
class Spark:
    """The engine of a Spark cluster.

    `master` is as in `session_of`. None takes the running session, or the session that the environment defines. Files
    must be visible to all executors under the same names. A Spark DataFrame takes its own session.
    """

    name: ClassVar[str] = "spark"
    master: str | None = None

    def session(self) -> SparkSession:
        """Return the running session, or a new one. Raises UsageError if PySpark or Java is missing."""
        return session_of(self.master)

    def map(self, work: Callable[[A], B], items: Sequence[A]) -> list[B]:
        """Return the results, with a task for each item."""
        from pyspark import cloudpickle

        if not items:
            return []
        packed = [cloudpickle.dumps((work, item)) for item in items]

        def task(batches: Iterator[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
            import pyarrow

            for batch in batches:
                numbers = batch.column(0).to_pylist()
                found = [pickle.dumps(function(item)) for function, item in (pickle.loads(packed[k]) for k in numbers)]
                yield pyarrow.record_batch(
                    [pyarrow.array(numbers), pyarrow.array(found, pyarrow.binary())], ["id", "found"]
                )

        session = self.session()
        rows = session.range(0, len(items), 1, len(items)).mapInArrow(task, "id long, found binary")
        return [pickle.loads(found) for found in arrow_of(rows).sort("id")["found"]]


class SparkRows:
    """A DataFrame whose rows stay in Spark. Raises UsageError for missing columns."""

    engine = Spark.name

    def __init__(self, frame: object, columns: SourceColumns) -> None:
        self._frame, self.given, self.columns = cast("DataFrame", frame), columns, columns.own
        self._part = Part(FRAME, "", arrow_of(self._frame.limit(0)).lazy)
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
                yield from _batches(Part(FRAME, "", frame.lazy).rows(own).collect())

        kinds = ", ".join(f"`{key}` {'string' if key in (AXIS, TYPE) else 'double'}" for key in names)
        return self._frame.select(chosen).mapInArrow(read, kinds)

    def _number_slices(self, length: float) -> DataFrame:
        """The rows with the number of their slice, null for rows without an axis or a valid time."""
        from pyspark.sql import functions as sql

        known = sql.col(AXIS).isNotNull() & (sql.abs(TIME) < float("inf"))
        return self._rows.withColumn(SLICE, sql.when(known, sql.floor(sql.col(TIME) / length)))

    def survey(self, length: float) -> Survey:
        from pyspark.sql import functions as sql

        ends = [sql.min(TIME).alias(FIRST), sql.max(TIME).alias(LAST)]
        kind = sql.coalesce(sql.min(TYPE), sql.lit("")) if self.columns.type else sql.lit("")
        counts = (
            self._number_slices(length)
            .groupBy(AXIS, SLICE)
            .agg(sql.count(sql.lit(1)).alias(ROWS), *ends, kind.alias(TYPE))
        )
        found = arrow_of(counts).with_columns(pl.lit(0, pl.Int64).alias(START), pl.lit(0, pl.Int64).alias(END))
        return join_surveys([survey_of(FRAME, found, self._part.other_types(self.given), self.given.factor)])

    def read(self, wanted: pl.DataFrame, length: float) -> pl.DataFrame:
        """Return the rows of some axes and slices."""
        from pyspark.sql import functions as sql

        pairs = self._frame.sparkSession.createDataFrame(wanted.select(AXIS, SLICE).to_arrow())
        chosen = self._number_slices(length).join(sql.broadcast(pairs), [AXIS, SLICE])
        return arrow_of(chosen.select(self.columns.carried))

    def evaluate(self, work: Work, tell: Callable[[float], None]) -> pl.DataFrame:
        """Return the results for all axes. Spark brings the slices of a day of each axis together."""
        from pyspark.sql import functions as sql

        def act(table: pa.Table) -> pa.Table:
            import pyarrow

            return pyarrow.Table.from_batches(_batches(work.evaluate(cast(pl.DataFrame, pl.from_arrow(table)))))

        day = sql.floor(sql.col(SLICE) / TUNING.plan_block).alias("day")
        rows = self._number_slices(work.length).where(sql.col(SLICE).isNotNull()).select(*self.columns.carried, day)
        kinds = {pl.String: "string", pl.Float64: "double", pl.Int64: "long"}
        schema = ", ".join(f"`{name}` {kinds[kind]}" for name, kind in work.schema.items())
        grouped = rows.groupBy(AXIS, "day").applyInArrow(act, schema)
        return arrow_of(grouped)


def _batches(frame: pl.DataFrame) -> list[pa.RecordBatch]:
    """Return record batches with the types of Spark, which has only one type of text."""
    import pyarrow as pa

    table = frame.to_arrow()
    kinds = {pa.large_string(): pa.string(), pa.string_view(): pa.string()}
    schema = pa.schema([(field.name, kinds.get(field.type, field.type)) for field in table.schema])
    return list(table.cast(schema).to_batches())

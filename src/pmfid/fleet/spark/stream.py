"""Blocks of many axes through Spark Structured Streaming, with a state for each shard (`pmfid fleet stream`)."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import polars as pl

from pmfid.errors import UsageError
from pmfid.fleet.shards import Folder, States, StreamPlan, StreamSettings, columns_of, open_folder
from pmfid.fleet.spark.engine import is_own, memory, session_of
from pmfid.fleet.tuning import TUNING

if TYPE_CHECKING:
    from pyspark.sql import DataFrame, SparkSession
    from pyspark.sql.streaming.query import StreamingQuery


NAME = "spark.log"
#: A line that names the cause of a failure, in Python or Java.
CAUSE = re.compile(r"(Caused by: )?[\w.$]+(Error|Exception): .")
#: Spark's messages about an incomplete checkpoint.
DAMAGED = ("log file", "end-of-input", "CANNOT_LOAD_STATE_STORE", "ChecksumException")
REPAIR = "the checkpoint is damaged: restore a copy of it, or give new folders for --checkpoint and --out"
AGAIN = "correct the cause, and start the stream again"
NO_MEMORY = (
    "the stream stopped: Java has no memory left; start the stream again with more memory, for "
    "example with the variable SPARK_DRIVER_MEMORY=8g for 8 GB; in a session of your own, raise "
    "spark.driver.memory"
)


class SparkLog:
    """The log of a process that uses the checkpoint in `folder`."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / NAME
        self._begun = self.path.stat().st_size if self.path.exists() else 0

    @contextmanager
    def capture(self) -> Iterator[None]:
        """Redirect the messages of a Java process that starts in this context to the log, for the life of the process.

        The messages are many, and help to find the cause of a failure.
        """
        sys.stderr.flush()
        kept = os.dup(2)
        try:
            log = open(self.path, "ab")  # noqa: SIM115
        except OSError:  # the checkpoint can only be read
            log = open(os.devnull, "ab")  # noqa: SIM115
        with log:
            os.dup2(log.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)

    def problem(self, error: Exception) -> str:
        """Return Spark's message about a failure, without stack traces."""
        messages = b""
        with suppress(OSError), open(self.path, "rb") as file:
            file.seek(max(self._begun, file.seek(0, os.SEEK_END) - TUNING.log_lately))
            messages = file.read()
        if b"java.lang.OutOfMemoryError" in messages:
            return NO_MEMORY
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        causes = [line for line in lines if CAUSE.match(line)]
        cause = causes[-1] if causes else next(iter(lines), "without a reason given")
        damaged = any(sign in str(error) for sign in DAMAGED)
        return f"the stream stopped: {cause[:400]}; {(REPAIR if damaged else AGAIN)} (details in {self.path})"


_STORE = "spark.sql.streaming.stateStore"
#: Settings that the session of a stream needs.
SETTINGS = {
    f"{_STORE}.providerClass": "org.apache.spark.sql.execution.streaming.state.RocksDBStateStoreProvider",
    f"{_STORE}.rocksdb.changelogCheckpointing.enabled": "true",
    # Every batch writes the whole state, so a restart needs only the last few states.
    "spark.sql.streaming.minBatchesToRetain": "4",
}
#: The folder of Spark's own checkpoint within the checkpoint of the stream.
SPARK = "spark"


@dataclass(frozen=True)
class Pacing:
    """The pace of a stream.

    `interval` is the time between two batches [s]. `files` is the largest number of files in a batch. None takes all
    files. With `once`, the stream ends after all present files.
    """

    interval: float = 5.0
    files: int | None = None
    once: bool = False


def watch_blocks(blocks: DataFrame, plan: StreamPlan, begin: States | None = None) -> DataFrame:
    """Return the estimates, notices and counts (`columns_of`) of a stream of blocks.

    The column `axis` has the name of the axis, the column `block` the bytes of docs/wire.md, like Kafka's key and
    value. `begin` has states from which axes continue.
    """
    from pyspark.sql import functions as f

    from pmfid.fleet.spark.workers import ShardProcessor

    spark = blocks.sparkSession
    keys = _find_keys(spark, plan.shards)
    initial = None
    if begin is not None:
        rows = [(keys[shard], bytearray(body)) for shard, body in begin.bodies(plan).items()]
        initial = spark.createDataFrame(rows, "shard int, body binary").groupBy("shard")
    shard = f.element_at(f.lit(keys), f.expr(f"cast(pmod(crc32(encode(axis, 'UTF-8')), {plan.shards}) as int) + 1"))
    schema = ", ".join(f"`{name}` {kind}" for name, kind in columns_of(plan).items())
    # A row without one of these columns is no block, and is counted as unusable.
    block = f.expr("if(axis is null or block is null, encode('nothing', 'UTF-8'), block)").alias("block")
    whole = blocks.select(f.expr("coalesce(axis, '')").alias("axis"), block)
    grouped = whole.withColumn("shard", shard).groupBy("shard")
    return grouped.transformWithStateInPandas(
        ShardProcessor(plan, keys),
        outputStructType=schema,
        outputMode="Append",
        timeMode="None",
        initialState=initial,
    )


def stream_files(
    source: Path,
    plan: StreamPlan,
    checkpoint: Path,
    out: Path,
    pacing: Pacing | None = None,
    begin: States | None = None,
    master: str | None = None,
    settings: Mapping[str, str] | None = None,
) -> None:
    """Watch a folder that receives Parquet files or growing files of blocks (.pmfb) until the stream is stopped.

    `begin` has states from which axes continue in a new checkpoint. Raises UsageError if PySpark or Java is missing, or
    if the stream fails. An invalid folder, a folder in use, and a checkpoint of another configuration raise UsageError,
    too.
    """
    pacing = pacing or Pacing()
    kind = kind_of(source)
    own = {"spark.sql.shuffle.partitions": str(plan.shards), **dict(settings or {})}
    with open_folder(checkpoint, out, settings_of(plan, source)) as folder:
        if (checkpoint / SPARK).exists():
            begin = None  # the checkpoint already has the states
        log = SparkLog(checkpoint)
        spark = _session(log, master, own)
        from py4j.protocol import Py4JError
        from pyspark.errors import PySparkException

        try:
            blocks = _read(spark, source, kind, pacing)
            query = _start_query(watch_blocks(blocks, plan, begin), folder, checkpoint / SPARK, pacing)
            try:
                query.awaitTermination()
            except KeyboardInterrupt:
                with suppress(Exception):
                    query.stop()
                raise
        except (PySparkException, Py4JError) as error:
            raise UsageError(log.problem(error)) from None


def settings_of(plan: StreamPlan, source: Path) -> StreamSettings:
    """Return the settings that must not change between two starts."""
    pace = plan.pace
    return StreamSettings(plan.prepared.digest, plan.shards, pace.window, pace.every, str(source.resolve()))


def kind_of(source: Path) -> str:
    """Return "parquet" or "pmfb", by the present files. Raises UsageError for anything else."""
    if not source.is_dir():
        raise UsageError(
            f"{source}: this is not a folder; give the folder that receives the files of blocks (.parquet or .pmfb)"
        )
    kinds = {path.suffix for path in source.iterdir() if path.suffix in (".parquet", ".pmfb")}
    if len(kinds) > 1:
        raise UsageError(f"{source}: contains both .parquet and .pmfb files; use a separate folder for each kind")
    return kinds.pop().lstrip(".") if kinds else "parquet"


def _session(log: SparkLog, master: str | None, settings: Mapping[str, str]) -> SparkSession:
    """Return the session of a stream.

    A local session may take a quarter of the machine's memory, as Java itself does. Spark's own variable can set
    another limit. Spark's default is 1 GB, but a batch has the states of its shards in several copies.
    """
    own = os.environ.get("SPARK_DRIVER_MEMORY") or f"{memory() // 2**22}m"
    roomy = {"spark.driver.memory": own, "spark.driver.maxResultSize": "0"}
    with log.capture():
        return session_of(master, {**SETTINGS, **(roomy if is_own(master) else {}), **settings})


def _read(spark: SparkSession, source: Path, kind: str, pacing: Pacing) -> DataFrame:
    if kind == "pmfb":
        from pmfid.fleet.spark.workers import BlockFiles

        spark.dataSource.register(BlockFiles)
        return spark.readStream.format(BlockFiles.name()).load(str(source))
    reader = spark.readStream.schema("axis string, block binary").option("pathGlobFilter", "*.parquet")
    if pacing.files is not None:
        reader = reader.option("maxFilesPerTrigger", pacing.files)
    return reader.parquet(str(source))


def _start_query(outcomes: DataFrame, folder: Folder, checkpoint: Path, pacing: Pacing) -> StreamingQuery:
    def write(batch: DataFrame, number: int) -> None:
        folder.write(number, pl.DataFrame(pl.from_arrow(batch.toArrow())))

    writer = outcomes.writeStream.foreachBatch(write).outputMode("append")
    writer = writer.option("checkpointLocation", str(checkpoint))
    if pacing.once:
        return writer.trigger(availableNow=True).start()
    return writer.trigger(processingTime=f"{round(1000 * pacing.interval)} milliseconds").start()


def states_of(checkpoint: Path, prepared_digest: str, master: str | None = None) -> States:
    """Return the states of all axes in the checkpoint of a stream, after its last batch.

    Raises UsageError if no checkpoint exists, or if it has another configuration.
    """
    check_states(checkpoint)
    from pmfid.fleet.spark.workers import STATE, unpack_state

    log = SparkLog(checkpoint)
    spark = _session(log, master, {})
    from py4j.protocol import Py4JError
    from pyspark.errors import PySparkException

    try:
        reader = spark.read.format("statestore").option("path", str((checkpoint / SPARK).resolve()))
        rows = reader.option("stateVarName", STATE).load().selectExpr("key.shard", "value.body").toLocalIterator()
        bodies = {row[0]: unpack_state(row[1]) for row in rows}
    except (PySparkException, Py4JError) as error:
        raise UsageError(log.problem(error)) from None
    except ValueError as error:
        raise UsageError(f"a state cannot be read: {error}; read it with the version that wrote it") from None
    return States.from_bodies(bodies, prepared_digest)


def check_states(checkpoint: Path) -> None:
    """Raise UsageError if no stream has kept its states."""
    if not (checkpoint / SPARK / "state").is_dir():
        raise UsageError(
            f"{checkpoint}: contains no states yet; give the --checkpoint of a stream that has processed a batch"
        )


def _find_keys(spark: SparkSession, shards: int) -> list[int]:
    """Return a key for each shard, by which Spark gives every shard its own partition.

    The key is the least whole number whose hash, modulo `shards`, is the number of the shard. Consecutive keys would
    leave a third of the partitions empty, and put several shards into others.
    """
    numbers = spark.range(TUNING.stream_tried * shards).selectExpr(
        "cast(id as int) as key", f"pmod(hash(key), {shards}) as place"
    )
    table = numbers.toArrow().to_pydict()
    found: dict[int, int] = {}
    for key, place in sorted(zip(table["key"], table["place"], strict=True)):
        found.setdefault(place, key)
    return [found[number] for number in range(shards)]

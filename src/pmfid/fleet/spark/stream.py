"""`pmfid fleet stream`: blocks of many axes through Spark Structured Streaming, with a state for each shard."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING

from pmfid.errors import UsageError
from pmfid.fleet.spark.session import session_of
from pmfid.fleet.stream.folder import Folder, Settings, opened
from pmfid.fleet.stream.shard import Plan
from pmfid.fleet.stream.states import States
from pmfid.fleet.stream.tables import columns_of

if TYPE_CHECKING:
    from pyspark.sql import DataFrame, SparkSession
    from pyspark.sql.streaming.query import StreamingQuery

__all__ = ["SETTINGS", "SPARK", "Pacing", "check_states", "kind_of", "states_of", "stream_files", "watched"]

_STORE = "spark.sql.streaming.stateStore"
#: What the session of a stream needs.
SETTINGS = {
    f"{_STORE}.providerClass": "org.apache.spark.sql.execution.streaming.state.RocksDBStateStoreProvider",
    f"{_STORE}.rocksdb.changelogCheckpointing.enabled": "true",
    # a state is written whole with every batch: what is older than a few of them is in nobody's way to a restart
    "spark.sql.streaming.minBatchesToRetain": "4",
}
#: The folder of Spark's own checkpoint within that of the stream.
SPARK = "spark"
#: What Spark says of a checkpoint that is not whole.
_DAMAGED = ("log file", "end-of-input", "CANNOT_LOAD_STATE_STORE", "ChecksumException")
#: What Spark and its processes say, beside it.
LOG = "spark.log"


@dataclass(frozen=True)
class Pacing:
    """interval: time between two batches [s]; files: of a batch at most, None: all that are there; once: ends when all
    that is there is done."""

    interval: float = 5.0
    files: int | None = None
    once: bool = False


def watched(blocks: DataFrame, plan: Plan, initial: DataFrame | None = None) -> DataFrame:
    """The estimates, notices and counts (`columns_of`) of a stream of blocks: columns `axis`, its name, and `block`,
    the bytes of docs/wire.md, as Kafka's key and value. initial: `shard`, `body`, states to begin with."""
    from pyspark.sql import functions as f

    from pmfid.fleet.spark.processor import ShardProcessor

    shard = f.expr(f"cast(pmod(crc32(encode(axis, 'UTF-8')), {plan.shards}) as int)")
    schema = ", ".join(f"`{name}` {kind}" for name, kind in columns_of(plan).items())
    # a row without one of them, as of a file with other columns, is no block, and counted as such
    block = f.expr("if(axis is null or block is null, encode('nothing', 'UTF-8'), block)").alias("block")
    whole = blocks.select(f.expr("coalesce(axis, '')").alias("axis"), block)
    grouped = whole.withColumn("shard", shard).groupBy("shard")
    return grouped.transformWithStateInPandas(
        ShardProcessor(plan),
        outputStructType=schema,
        outputMode="Append",
        timeMode="None",
        initialState=None if initial is None else initial.groupBy("shard"),
    )


def stream_files(
    source: Path,
    plan: Plan,
    checkpoint: Path,
    out: Path,
    pacing: Pacing | None = None,
    begin: States | None = None,
    master: str | None = None,
    settings: Mapping[str, str] | None = None,
) -> None:
    """Watches what comes into a folder of Parquet files, or of files of blocks (.pmfb) that grow, until it is stopped.

    begin: states of axes that go on here, for a new checkpoint. Raises UsageError where PySpark or Java is missing, a
    folder is not what it should be, the configuration is not that of the checkpoint, or the stream fails.
    """
    pacing = pacing or Pacing()
    kind = kind_of(source)
    with opened(checkpoint, out, settings_of(plan, source)) as folder:
        _stream(source, kind, plan, checkpoint, folder, pacing, begin, master, settings or {})


def _stream(
    source: Path,
    kind: str,
    plan: Plan,
    checkpoint: Path,
    folder: Folder,
    pacing: Pacing,
    begin: States | None,
    master: str | None,
    settings: Mapping[str, str],
) -> None:
    """The same, in folders that it has for itself."""
    fresh = not (checkpoint / SPARK).exists()
    if begin is not None and not fresh:
        begin = None  # they are in the checkpoint already
    own = {**SETTINGS, "spark.sql.shuffle.partitions": str(plan.shards), **settings}
    with _said_into(checkpoint / LOG):
        spark = session_of(master, own)
    from py4j.protocol import Py4JError
    from pyspark.errors import PySparkException

    try:
        blocks = _read(spark, source, kind, pacing)
        initial = None if begin is None else _initial(spark, begin, plan)
        _wait(_started(watched(blocks, plan, initial), folder, checkpoint / SPARK, pacing))
    except (PySparkException, Py4JError) as error:
        raise UsageError(problem_of(error)) from None


def settings_of(plan: Plan, source: Path) -> Settings:
    """What may not change between two starts."""
    pace = plan.pace
    return Settings(plan.prepared.digest, plan.shards, pace.window, pace.every, str(source.resolve()))


def kind_of(source: Path) -> str:
    """ "parquet" or "pmfb", by the files that are there. Raises UsageError for anything else."""
    if not source.is_dir():
        raise UsageError(f"{source}: is no folder; give one into which files of blocks come, .parquet or .pmfb")
    kinds = {path.suffix for path in source.iterdir() if path.suffix in (".parquet", ".pmfb")}
    if len(kinds) > 1:
        raise UsageError(f"{source}: holds both .parquet and .pmfb files; give a folder for each kind")
    return kinds.pop().lstrip(".") if kinds else "parquet"


@contextmanager
def _said_into(path: Path) -> Iterator[None]:
    """A Java process that is started meanwhile writes its messages there, for its whole life: they are for those who
    look for the cause of a failure, and many."""
    sys.stderr.flush()
    kept = os.dup(2)
    with _log(path) as log:
        os.dup2(log.fileno(), 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


def _log(path: Path) -> IO[bytes]:
    """To be appended to; of a checkpoint that can only be read, nothing."""
    try:
        return open(path, "ab")
    except OSError:
        return open(os.devnull, "ab")


def _read(spark: SparkSession, source: Path, kind: str, pacing: Pacing) -> DataFrame:
    if kind == "pmfb":
        from pmfid.fleet.spark.block_files import BlockFiles

        spark.dataSource.register(BlockFiles)
        return spark.readStream.format(BlockFiles.name()).load(str(source))
    reader = spark.readStream.schema("axis string, block binary").option("pathGlobFilter", "*.parquet")
    if pacing.files is not None:
        reader = reader.option("maxFilesPerTrigger", pacing.files)
    return reader.parquet(str(source))


def _initial(spark: SparkSession, begin: States, plan: Plan) -> DataFrame:
    rows = [(shard, bytearray(body)) for shard, body in begin.bodies(plan).items()]
    return spark.createDataFrame(rows, "shard int, body binary")


def _started(outcomes: DataFrame, folder: Folder, checkpoint: Path, pacing: Pacing) -> StreamingQuery:
    def write(batch: DataFrame, number: int) -> None:
        import polars as pl

        folder.write(number, pl.DataFrame(pl.from_arrow(batch.toArrow())))

    writer = outcomes.writeStream.foreachBatch(write).outputMode("append")
    writer = writer.option("checkpointLocation", str(checkpoint))
    if pacing.once:
        return writer.trigger(availableNow=True).start()
    return writer.trigger(processingTime=f"{round(1000 * pacing.interval)} milliseconds").start()


def _wait(query: StreamingQuery) -> None:
    try:
        query.awaitTermination()
    except KeyboardInterrupt:
        with suppress(Exception):
            query.stop()
        raise


def states_of(checkpoint: Path, prepared_digest: str, master: str | None = None) -> States:
    """The states of all axes in the checkpoint of a stream, behind its last batch. Raises UsageError where there is
    none, or of another configuration."""
    check_states(checkpoint)
    from pmfid.fleet.spark.processor import STATE

    with _said_into(checkpoint / LOG):
        spark = session_of(master, SETTINGS)
    from py4j.protocol import Py4JError
    from pyspark.errors import PySparkException

    try:
        reader = spark.read.format("statestore").option("path", str((checkpoint / SPARK).resolve()))
        rows = reader.option("stateVarName", STATE).load().selectExpr("key.shard", "value.body").collect()
    except (PySparkException, Py4JError) as error:
        raise UsageError(problem_of(error)) from None
    return States.of({row[0]: bytes(row[1]) for row in rows}, prepared_digest)


def check_states(checkpoint: Path) -> None:
    """Raises UsageError where no stream has kept its states."""
    if not (checkpoint / SPARK / "state").is_dir():
        raise UsageError(f"{checkpoint}: has no states yet; give the --checkpoint of a stream that has done a batch")


def problem_of(error: Exception) -> str:
    """What Spark says of a failure, in a sentence without its traces."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    causes = [line for line in lines if line.startswith(("pmfid.", "ValueError", "Caused by", "java.io"))]
    told = causes[-1] if causes else next(iter(lines), "for no reason that it tells")
    remedy = "mend that, and start it again"
    if any(sign in str(error) for sign in _DAMAGED):
        remedy = "the checkpoint is damaged: put back a copy of it, or give new folders for --checkpoint and --out"
    return f"the stream stopped: {told[:400]}; {remedy}"

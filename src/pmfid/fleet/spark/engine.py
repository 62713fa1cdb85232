"""Spark as the engine of a history."""

from __future__ import annotations

import os
import pickle
import shutil
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, TypeVar, cast
from unittest import mock

from pmfid import __version__
from pmfid.errors import PmfidError, UsageError
from pmfid.fleet.data import Local
from pmfid.fleet.tuning import TUNING

if TYPE_CHECKING:
    import pyarrow as pa
    from pyspark.sql import DataFrame, SparkSession

#: Any of these variables shows that the user has set up Spark, or works in Spark. The settings of that Spark stay.
SET_UP = ("SPARK_REMOTE", "SPARK_HOME", "SPARK_CONF_DIR", "PYSPARK_GATEWAY_PORT", "PYSPARK_SUBMIT_ARGS")
#: The memory limit of a container on Linux [bytes].
CONTAINER = Path("/sys/fs/cgroup/memory.max")
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


def memory() -> int:
    """Return the memory [bytes] of the machine, or of the container if the process is in one."""
    found = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    with suppress(OSError, ValueError):  # the process has no container, or no limit
        found = min(found, int(CONTAINER.read_text()))
    return found


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


#: Columns of the results, for the item or shard and its pickled result.
NUMBER, FOUND = "number", "found"
RETURNED = f"{NUMBER} long, {FOUND} binary"
NOT_THERE = (
    "the executors of Spark have no pmfid: install it in their Python (PYSPARK_PYTHON), or send "
    "an environment that contains it (spark.archives); see docs/howto/fleet.md"
)


def answer_task(work: Callable[[], object], version: str) -> bytes:
    """Return the packed answer of an executor. `version` is the package version of the receiver."""
    try:
        if version != __version__:
            raise UsageError(
                f"the executors have pmfid {__version__}, but the driver has {version}: install the same "
                "version on both"
            )
        return pickle.dumps((work(), None))
    except PmfidError as error:
        return pickle.dumps((None, error))


def open_answer(packed: bytes) -> object:
    """Return the result of an executor. Raises the error with which the executor refused the work."""
    found, refused = pickle.loads(packed)
    if refused is not None:
        raise refused
    return found


def return_answers(numbers: Sequence[int], found: Sequence[bytes]) -> pa.RecordBatch:
    import pyarrow as pa

    return pa.record_batch([pa.array(numbers, pa.int64()), pa.array(found, pa.binary())], [NUMBER, FOUND])


def collect_answers(frame: DataFrame) -> dict[int, object]:
    """Return the answers of all executors, by number. Raises UsageError if they do not have the package."""
    table = arrow_of(frame)
    pairs = zip(table.column(NUMBER).to_pylist(), table.column(FOUND).to_pylist(), strict=True)
    return {number: open_answer(packed) for number, packed in pairs}


def arrow_of(frame: DataFrame) -> pa.Table:
    """Compute a frame and return it as an Arrow table. Raises UsageError if the executors do not have the package."""
    try:
        return frame.toArrow()
    except Exception as error:
        if "No module named 'pmfid" in str(error):
            raise UsageError(NOT_THERE) from None
        raise


def merge_batches(batches: Iterator[pa.RecordBatch]) -> Iterator[pa.Table]:
    """Yield the rows in fewer tables, without empty tables."""
    import pyarrow as pa

    waiting: list[pa.RecordBatch] = []
    rows = 0
    for batch in batches:
        waiting.append(batch)
        rows += batch.num_rows
        if rows >= TUNING.at_once:
            yield pa.Table.from_batches(waiting)
            waiting, rows = [], 0
    if rows:
        yield pa.Table.from_batches(waiting)


A = TypeVar("A")
B = TypeVar("B")


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

    def map(self, work: Callable[[A], B], items: Sequence[A]) -> Iterator[B]:
        """Yield the results job by job, with a task for each item."""
        if not items:
            return
        session = self.session()
        many = max(TUNING.engine_least, TUNING.engine_each * processors(session))
        jobs = [items[start : start + many] for start in range(0, len(items), many)]
        for found in Local(TUNING.engine_jobs).map(partial(_job, session, work), jobs):
            yield from found


def processors(session: SparkSession) -> int:
    """Return the number of tasks that run in parallel."""
    try:
        return int(session.sparkContext.defaultParallelism)
    except Exception:  # Spark Connect has no context
        return TUNING.engine_untold


def _job(session: SparkSession, work: Callable[[A], B], items: Sequence[A]) -> list[B]:
    from pyspark import cloudpickle

    packed = [cloudpickle.dumps((work, item)) for item in items]
    found = collect_answers(
        session.range(0, len(items), 1, len(items)).mapInArrow(_task(packed, __version__), RETURNED)
    )
    return cast("list[B]", [found[k] for k in range(len(items))])


def _task(packed: Sequence[bytes], version: str) -> Callable[[Iterator[pa.RecordBatch]], Iterator[pa.RecordBatch]]:
    """Return a task for Spark. `packed` has work and item for each number."""

    def task(batches: Iterator[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
        for batch in batches:
            for number in batch.column(0).to_pylist():
                yield return_answers([number], [answer_task(partial(_run_task, packed[number]), version)])

    return task


def _run_task(packed: bytes) -> object:
    import pickle

    work, item = pickle.loads(packed)
    return work(item)

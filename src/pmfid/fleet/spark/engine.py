"""The engine of a cluster: Spark sends the work to its executors, which read the files themselves."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, ClassVar, TypeVar, cast

from pmfid import __version__
from pmfid.fleet.local import Local
from pmfid.fleet.spark.session import session_of
from pmfid.fleet.spark.tasks import RETURNED, answer_task, collect_answers, return_answers

if TYPE_CHECKING:
    import pyarrow as pa
    from pyspark.sql import SparkSession

A = TypeVar("A")
B = TypeVar("B")

#: Items of a job, in processors, and at least: what it found is kept when it is done, and a job costs a tenth of a
#: second. While the last items of a job are worked on, the next one has the other processors.
EACH, LEAST, JOBS = 4, 8, 2
#: Processors that are reckoned with where Spark does not say how many it has.
UNTOLD = 64


@dataclass(frozen=True)
class Spark:
    """master: as in `session_of`; None: the session that runs already, or as the environment says. Files must be
    visible to all executors under the same names; a Spark DataFrame takes its own session."""

    name: ClassVar[str] = "spark"
    master: str | None = None

    def session(self) -> SparkSession:
        """Taken or made. Raises UsageError where PySpark or Java is missing."""
        return session_of(self.master)

    def map(self, work: Callable[[A], B], items: Sequence[A]) -> Iterator[B]:
        """Job by job, an item a task."""
        if not items:
            return
        session = self.session()
        many = max(LEAST, EACH * processors(session))
        jobs = [items[start : start + many] for start in range(0, len(items), many)]
        for found in Local(JOBS).map(partial(_job, session, work), jobs):
            yield from found


def processors(session: SparkSession) -> int:
    """Tasks that run at once."""
    try:
        return int(session.sparkContext.defaultParallelism)
    except Exception:  # Spark Connect has no context
        return UNTOLD


def _job(session: SparkSession, work: Callable[[A], B], items: Sequence[A]) -> list[B]:
    from pyspark import cloudpickle

    packed = [cloudpickle.dumps((work, item)) for item in items]
    found = collect_answers(
        session.range(0, len(items), 1, len(items)).mapInArrow(_task(packed, __version__), RETURNED)
    )
    return cast("list[B]", [found[k] for k in range(len(items))])


def _task(packed: Sequence[bytes], version: str) -> Callable[[Iterator[pa.RecordBatch]], Iterator[pa.RecordBatch]]:
    """packed: work and item for each number."""

    def task(batches: Iterator[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
        for batch in batches:
            for number in batch.column(0).to_pylist():
                yield return_answers([number], [answer_task(partial(_run_task, packed[number]), version)])

    return task


def _run_task(packed: bytes) -> object:
    import pickle

    work, item = pickle.loads(packed)
    return work(item)

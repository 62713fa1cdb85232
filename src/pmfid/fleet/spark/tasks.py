"""What is sent to the executors, and how what they found, or refused, comes back.

Functions go by name, so every executor needs the package; values go by cloudpickle, which takes the readers of files
along.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pmfid import __version__
from pmfid.errors import PmfidError, UsageError

if TYPE_CHECKING:
    import pyarrow as pa
    from pyspark.sql import DataFrame

#: Columns of what comes back: which item or shard, and what was found for it, pickled.
NUMBER, FOUND = "number", "found"
RETURNED = f"{NUMBER} long, {FOUND} binary"
#: Rows that are handed to polars at once: Spark's own batches are small.
AT_ONCE = 2**20
NOT_THERE = (
    "the executors of Spark do not have pmfid: install it in the Python that they run (PYSPARK_PYTHON), or send an "
    "environment that has it (spark.archives); see docs/guide/fleet.md"
)


@dataclass(frozen=True)
class Answer:
    """found: by the work; refused: what it raised on purpose."""

    found: object = None
    refused: PmfidError | None = None


def answer_task(work: Callable[[], object], version: str) -> bytes:
    """The answer of an executor, packed; version: of the package where the answer goes."""
    try:
        if version != __version__:
            raise UsageError(f"the executors have pmfid {__version__}, the driver {version}: install the same on both")
        answer = Answer(work())
    except PmfidError as error:
        answer = Answer(refused=error)
    return pickle.dumps(answer)


def open_answer(packed: bytes) -> object:
    """The result of an executor. Raises the error with which the executor refused the work."""
    answer = pickle.loads(packed)
    if answer.refused is not None:
        raise answer.refused
    return answer.found


def return_answers(numbers: Sequence[int], found: Sequence[bytes]) -> pa.RecordBatch:
    """Answers as a batch for Spark."""
    import pyarrow as pa

    return pa.record_batch([pa.array(numbers, pa.int64()), pa.array(found, pa.binary())], [NUMBER, FOUND])


def collect_answers(frame: DataFrame) -> dict[int, object]:
    """The answers of all executors, by number. Raises UsageError where they do not have the package."""
    table = arrow_of(frame)
    pairs = zip(table.column(NUMBER).to_pylist(), table.column(FOUND).to_pylist(), strict=True)
    return {number: open_answer(packed) for number, packed in pairs}


def arrow_of(frame: DataFrame) -> pa.Table:
    """Of a frame, computed. Raises UsageError where the executors do not have the package."""
    try:
        return frame.toArrow()
    except Exception as error:
        if "No module named 'pmfid" in str(error):
            raise UsageError(NOT_THERE) from None
        raise


def merge_batches(batches: Iterator[pa.RecordBatch]) -> Iterator[pa.Table]:
    """The same rows in fewer tables, none of them empty."""
    import pyarrow as pa

    waiting: list[pa.RecordBatch] = []
    rows = 0
    for batch in batches:
        waiting.append(batch)
        rows += batch.num_rows
        if rows >= AT_ONCE:
            yield pa.Table.from_batches(waiting)
            waiting, rows = [], 0
    if rows:
        yield pa.Table.from_batches(waiting)

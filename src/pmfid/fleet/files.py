"""Files and frames with the rows of a history, and the work on them by threads of this machine."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TypeVar

import polars as pl

from pmfid.errors import UsageError, whole_number
from pmfid.estimators.fleet import processors
from pmfid.fleet.evaluate import PROBLEM, Work
from pmfid.fleet.plan import (
    SLICE,
    Chunk,
    Survey,
    chunks_of,
    join_surveys,
    number_chunks,
    read_chunk,
    sort_mixed,
    survey_part,
)
from pmfid.fleet.source import AXIS, Part, SourceColumns
from pmfid.fleet.tuning import TUNING

A = TypeVar("A")
B = TypeVar("B")
#: A function that is called with the completed part of the work, 0 to 1.
Progress = Callable[[float], None]


class Files:
    """Files, or frames in memory. `SparkRows` has the same methods for rows that stay in Spark.

    `folder` takes the rows of files that mix their axes; None takes the folder for temporary files. `workers` is the
    number of threads, by default one for each processor. Raises UsageError for a number below 1.
    """

    def __init__(
        self, parts: Sequence[Part], columns: SourceColumns, folder: Path | None, workers: int | None = None
    ) -> None:
        if workers is not None:
            whole_number("workers", workers, 1, "it is the number of threads; None uses one for each processor")
        self._parts, self.given, self._folder = {part.name: part for part in parts}, columns, folder
        self._threads = workers or processors()

    def _map(self, work: Callable[[A], B], items: Sequence[A]) -> Iterator[B]:
        """Yield the result of `work` for each item, in the order of the items."""
        pool = ThreadPoolExecutor(self._threads)
        try:
            yield from pool.map(work, items)
        finally:
            pool.shutdown(cancel_futures=True)

    def survey(self, length: float) -> Survey:
        """Find all axes and their times. This call comes first.

        Raises UsageError if a column is missing everywhere, or if no part can be read.
        """
        work = partial(survey_part, columns=self.given, length=length)
        self._survey = Survey(pl.DataFrame(), ())
        try:
            self._survey = join_surveys(list(self._map(work, list(self._parts.values()))))
        except UsageError:
            refusals = list(self._refusals())
            if not refusals:
                raise
            # A column that is missing everywhere is the likelier mistake than a damaged file.
            raise UsageError(next((one for one in refusals if "no column" in one), refusals[0])) from None
        return self._survey

    def _refusals(self) -> Iterator[str]:
        """Yield the reasons why parts have no such columns."""
        for part in self._parts.values():
            try:
                part.rows(self.given)
            except UsageError as error:
                yield f"{part.name}: {error}"

    def read(self, wanted: pl.DataFrame, length: float) -> pl.DataFrame:
        """Return the rows of some axes and slices."""
        rows = self._survey.rows.join(wanted, on=[AXIS, SLICE], how="semi")
        (chunk,) = chunks_of(number_chunks(rows, 2**62), self._parts, self.given)
        return read_chunk(chunk, length)[0]

    def evaluate(self, work: Work, tell: Progress) -> pl.DataFrame:
        """Return the results of all chunks."""
        numbered = number_chunks(self._survey.rows, max(TUNING.plan_rows // self._threads, TUNING.plan_least))
        chunks = chunks_of(numbered, self._parts, self.given)
        results, done, total = [pl.DataFrame(schema=work.schema)], 0, sum(chunk.rows for chunk in chunks)
        with sort_mixed(chunks, numbered, work.length, self._folder) as ready:
            for chunk, rows in zip(ready, self._map(partial(_evaluate_chunk, work), ready), strict=True):
                results.append(rows)
                done += chunk.rows
                tell(done / total)
        return pl.concat(results)


def _evaluate_chunk(work: Work, chunk: Chunk) -> pl.DataFrame:
    rows, problems = read_chunk(chunk, work.length)
    reports = pl.DataFrame([asdict(one) for one in problems], PROBLEM)
    segments = pl.DataFrame(schema=work.schema) if not rows.height else work.evaluate(rows)
    return pl.concat([segments, reports], how="diagonal")

"""Files and frames with the rows of a history, and the work on them by threads of this machine."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import asdict
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar, cast

import polars as pl

from pmfid.errors import UsageError, whole_number
from pmfid.estimators.fleet import processors
from pmfid.fleet.evaluate import PROBLEM, Work
from pmfid.fleet.source import AXIS, SECONDS, Part, SourceColumns
from pmfid.fleet.survey import (
    END,
    HOUR,
    PART,
    ROWS,
    START,
    RowProblem,
    Survey,
    hour_of,
    join_surveys,
    survey_part,
    unreadable,
)
from pmfid.fleet.tuning import TUNING
from pmfid.io.safety import readable

A = TypeVar("A")
B = TypeVar("B")
#: A function that is called with the completed part of the work, 0 to 1.
Progress = Callable[[float], None]
CHUNK = "chunk"
#: Problem of a file that changed while it was read.
REWRITTEN = "the file changed while pmfid read it: run the command again once the file is complete"


#: Parts with what returns their rows, which are in memory together.
Reads = Sequence[tuple[Part, Callable[[], pl.LazyFrame]]]


def read_parts(reads: Reads) -> tuple[pl.DataFrame, list[RowProblem]]:
    """Return the rows, in the order of the parts. Parts that cannot be read have problems in place of rows."""
    frames, problems = list[pl.DataFrame](), list[RowProblem]()
    for part, rows in reads:
        try:
            with readable("data"):
                frames.append(rows().collect())
        except UsageError as error:
            problems.append(unreadable(part, error))
        if part.rewritten:
            problems.append(RowProblem("", part.name, "rewritten", REWRITTEN))
    return pl.concat(frames) if frames else pl.DataFrame(), problems


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

    def survey(self) -> Survey:
        """Find all axes and their times. This call comes first.

        Raises UsageError if a column is missing everywhere, or if no part can be read.
        """
        try:
            parts = list(self._parts.values())
            self._survey = join_surveys(list(self._map(partial(survey_part, columns=self.given), parts)))
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

    def _rows(self, part: Part) -> pl.LazyFrame:
        return part.rows(self.given).select(self.given.carried)

    def _choose_rows(self, part: Part, hours: pl.DataFrame) -> pl.LazyFrame:
        """Return the rows of some hours in the survey of a part, from the first to the last of them."""
        first = cast(int, hours[START].min())
        many = cast(int, hours[END].max()) + 1 - first
        rows = self._rows(part).slice(first, many)
        if many == hours[ROWS].sum():
            return rows
        return rows.with_columns(hour_of()).join(hours.lazy(), on=[AXIS, HOUR], how="semi").drop(HOUR)

    def read(self, wanted: pl.DataFrame) -> pl.DataFrame:
        """Return the rows of some axes and hours."""
        return read_parts(self._reads(self._survey.rows.join(wanted, on=[AXIS, HOUR], how="semi"), {}))[0]

    def _reads(self, rows: pl.DataFrame, ready: Mapping[str, Callable[[], pl.LazyFrame]]) -> Reads:
        """Return what reads some rows of the survey. `ready` has the rows of parts that were sorted."""
        return [
            (self._parts[name], ready.get(name) or partial(self._choose_rows, self._parts[name], hours))
            for (name,), hours in rows.sort(PART).group_by(PART, maintain_order=True)
            if isinstance(name, str)
        ]

    def evaluate(self, work: Work, tell: Progress) -> pl.DataFrame:
        """Return the results for all rows."""
        numbered = number_chunks(self._survey.rows, max(TUNING.plan_rows // self._threads, TUNING.plan_least))
        results = [pl.DataFrame(schema=work.schema)]
        with self._sort_mixed(numbered) as folders:
            chunks = list[Reads]()
            for (number,), rows in numbered.group_by(CHUNK, maintain_order=True):
                ready = {
                    name: partial(pl.scan_parquet, folder / f"{CHUNK}={number}", hive_partitioning=False)
                    for name, folder in folders.items()
                }
                chunks.append(self._reads(rows, ready))
            for found in self._map(partial(_evaluate_chunk, work), chunks):
                results.append(found)
                tell((len(results) - 1) / len(chunks))
        return pl.concat(results)

    @contextmanager
    def _sort_mixed(self, numbered: pl.DataFrame) -> Iterator[dict[str, Path]]:
        """Open a context with a folder for each part of which many chunks have rows. The folder has a folder for each
        chunk.

        Raises UsageError if the disk is full. A damaged part has no folder, so that each chunk reports the part.
        """
        many = numbered.group_by(PART).agg(pl.col(CHUNK).n_unique()).filter(pl.col(CHUNK) > TUNING.plan_times)
        mixed = sorted(many[PART])
        with TemporaryDirectory(prefix="pmfid-", dir=self._folder) if mixed else nullcontext("") as there:
            folders = {name: Path(there) / str(k) for k, name in enumerate(mixed)}
            yield {name: to for name, to in folders.items() if self._sort(self._parts[name], numbered, to)}

    def _sort(self, part: Part, numbered: pl.DataFrame, folder: Path) -> bool:
        """Write the rows of a part into a folder for each chunk, and return whether the part can be read."""
        places = numbered.filter(pl.col(PART) == part.name).select(AXIS, HOUR, CHUNK).lazy()
        try:
            with readable("data"):
                rows = self._rows(part).with_columns(hour_of()).join(places, on=[AXIS, HOUR]).drop(HOUR)
                rows.sink_parquet(_folders_by_chunk(folder), compression="lz4", mkdir=True)
        except UsageError:
            if shutil.disk_usage(folder.parent).free < TUNING.plan_free:
                raise UsageError(
                    f"{folder.parent.parent}: no space left on this disk; {part.name} mixes the rows of its axes, and "
                    "pmfid sorts them there: free some space, or choose another folder"
                ) from None
            return False
        return True


def number_chunks(rows: pl.DataFrame, most: int) -> pl.DataFrame:
    """Return the survey's rows with the number of their chunk. A chunk has about `most` rows.

    A chunk holds the hours of a day of an axis, then those of the next axis, so that files by time and files by axis
    are each read in one piece.
    """
    whole = rows.group_by(AXIS, HOUR).agg(pl.sum(ROWS)).sort(pl.col(HOUR) * SECONDS["h"] // SECONDS["d"], AXIS, HOUR)
    number = ((pl.col(ROWS).cum_sum() - pl.col(ROWS)) // most).alias(CHUNK)
    return rows.join(whole.select(AXIS, HOUR, number), on=[AXIS, HOUR]).sort(CHUNK, AXIS, HOUR, PART)


def _folders_by_chunk(folder: Path) -> Any:
    """Return the target of Polars for a folder for each chunk, whose name differs between its versions."""
    if hasattr(pl, "PartitionBy"):
        return pl.PartitionBy(folder, key=CHUNK, include_key=False)
    return getattr(pl, "PartitionByKey")(folder, by=[CHUNK], include_key=False)  # noqa: B009  unknown to later versions


def _evaluate_chunk(work: Work, chunk: Reads) -> pl.DataFrame:
    rows, problems = read_parts(chunk)
    found = [work.evaluate(own) for own in _split_by_axis(rows)] if rows.height else []
    reports = pl.DataFrame([asdict(one) for one in problems], PROBLEM)
    return pl.concat([pl.DataFrame(schema=work.schema), *found, reports], how="diagonal")


def _split_by_axis(rows: pl.DataFrame) -> Iterator[pl.DataFrame]:
    """Yield the rows of each axis, without a copy if they lie together."""
    runs = rows[AXIS].rle().struct.unnest()
    if runs["value"].n_unique() < runs.height:
        yield from rows.partition_by(AXIS, maintain_order=True)
        return
    start = 0
    for many in runs["len"]:
        yield rows[start : start + many]
        start += many

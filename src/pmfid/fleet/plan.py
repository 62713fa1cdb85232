"""A survey of a history, the chunks of its rows that fit into memory, and how they are read."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

import polars as pl

from pmfid.errors import UsageError
from pmfid.fleet.source import AXIS, TIME, TYPE, Part, SourceColumns, other_unit
from pmfid.fleet.tuning import TUNING
from pmfid.io.safety import readable

PART, SLICE, CHUNK, ROWS, LOST, FIRST, LAST = "part", "slice", "chunk", "rows", "lost", "first", "last"
#: Numbers of the first and the last row in the part.
START, END = "start", "end"


@dataclass(frozen=True)
class RowProblem:
    """Rows or a file that cannot be used.

    `axis` is empty if the problem concerns a file, and `part` is empty if it concerns an axis. `at` is the time [s] at
    which the problem begins. `code` is the name of the problem among the findings.
    """

    axis: str
    part: str
    code: str
    text: str
    at: float = float("nan")


@dataclass(frozen=True)
class Survey:
    """The axes and slices of time in the parts of a data set.

    `rows` has a row for each axis and slice in each part, with its number of rows, first and last time [s], type, and
    the places of its first and last row. `problems` has parts that are left out, and peculiarities of other parts.
    """

    rows: pl.DataFrame
    problems: tuple[RowProblem, ...]


def slice_length(period: float | None) -> float:
    """Return the length of a slice [s], an hour or a fraction or multiple of the period [s] near it.

    Records end at the ends of slices, so that the division of the work changes no estimate.
    """
    hour = TUNING.plan_slice
    if period is None:
        return hour
    return period / -(-period // hour) if period > hour else period * (hour // period)


def slice_of(length: float) -> pl.Expr:
    """Return the number of the slice of a row, null for a row without an axis or a valid time."""
    number = (pl.col(TIME) / length).floor().cast(pl.Int64, strict=False)
    return pl.when(pl.col(AXIS).is_not_null()).then(number).alias(SLICE)


def count_rows(rows: pl.LazyFrame, columns: SourceColumns, length: float) -> pl.LazyFrame:
    """Count the rows of each axis and slice. The rows come from `Part.rows`."""
    kind = pl.col(TYPE).min().fill_null("") if columns.type else pl.lit("")
    place, time = pl.col(START), pl.col(TIME)
    return (
        rows.with_row_index(START)
        .group_by(AXIS, slice_of(length))
        .agg(
            pl.len().cast(pl.Int64).alias(ROWS),
            time.min().alias(FIRST),
            time.max().alias(LAST),
            kind.alias(TYPE),
            place.min().cast(pl.Int64),
            place.max().cast(pl.Int64).alias(END),
        )
    )


def survey_part(part: Part, columns: SourceColumns, length: float) -> Survey:
    """Return the survey of one part. A part that cannot be read has no rows and a problem."""
    try:
        with readable("data"):
            found, odd = count_rows(part.rows(columns), columns, length).collect(), part.other_types(columns)
    except UsageError as error:
        return Survey(_empty(), (unreadable(part, error),))
    said = part.constants.get(columns.axis)
    others = found.filter(pl.col(AXIS) != said)[AXIS].sort() if said else found[AXIS][:0]
    if others.len():
        odd.append(f"its folder says {columns.axis} = {said}, but its column says {others[0]}: the column is used")
    return survey_of(part.name, found, odd, columns.factor)


def survey_of(name: str, found: pl.DataFrame, odd: Sequence[str], factor: float) -> Survey:
    """Return the survey from the counts of the part `name`.

    `odd` has peculiarities of the part's columns. `factor` is the number of seconds per unit of its times.
    """
    problems = [RowProblem("", name, "type", text) for text in odd]
    if not found.height:
        problems.append(RowProblem("", name, "empty", "the file has no rows"))
    lost = int(found.filter(pl.col(SLICE).is_null())[ROWS].sum())
    if lost:
        problems.append(
            RowProblem("", name, "rows_lost", f"{lost} rows have no axis, or no valid time: these rows are left out")
        )
    found = found.drop_nulls(SLICE)
    if found.height and (text := other_unit(cast(float, found[FIRST].min()), cast(float, found[LAST].max()), factor)):
        problems.append(RowProblem("", name, "time_unit", text))
    return Survey(found.select(pl.lit(name).alias(PART), *_empty().columns[1:]), tuple(problems))


def join_surveys(surveys: Sequence[Survey]) -> Survey:
    """Return the survey of all parts. Raises UsageError if it has no rows."""
    problems = tuple(problem for one in surveys for problem in one.problems)
    rows = pl.concat([_empty(), *(one.rows for one in surveys)]).sort(SLICE, AXIS, PART)
    if not rows.height:
        reason = next((f": {one.part}: {one.text}" for one in problems if one.code == "unreadable"), "")
        raise UsageError(f"no file of the data set could be read{reason}; run pmfid check on one of the files")
    return Survey(rows, problems)


def _empty() -> pl.DataFrame:
    kinds = {PART: pl.String, AXIS: pl.String, SLICE: pl.Int64, ROWS: pl.Int64, FIRST: pl.Float64, LAST: pl.Float64}
    return pl.DataFrame(schema=kinds | {TYPE: pl.String, START: pl.Int64, END: pl.Int64})


@dataclass(frozen=True)
class Read:
    """Rows of a part: `many` rows from `first` on. With `only`, all of them belong to the chunk."""

    part: Part
    columns: SourceColumns
    first: int
    many: int
    only: bool


@dataclass(frozen=True)
class Chunk:
    """Rows that are in memory together: the slices of some axes in `wanted`, read from some parts."""

    number: int
    wanted: pl.DataFrame
    reads: tuple[Read, ...]
    rows: int


def number_chunks(rows: pl.DataFrame, most: int) -> pl.DataFrame:
    """Return the survey's rows with the number of their chunk. A chunk has about `most` rows.

    A chunk holds the slices of a day of an axis, then those of the next axis, so that files by time and files by axis
    are each read in one piece.
    """
    whole = rows.group_by(AXIS, SLICE).agg(pl.sum(ROWS)).sort(pl.col(SLICE) // TUNING.plan_block, AXIS, SLICE)
    number = ((pl.col(ROWS).cum_sum() - pl.col(ROWS)) // most).alias(CHUNK)
    return rows.join(whole.select(AXIS, SLICE, number), on=[AXIS, SLICE], maintain_order="left")


def chunks_of(numbered: pl.DataFrame, parts: Mapping[str, Part], columns: SourceColumns) -> list[Chunk]:
    """Return all chunks, in order."""
    found = []
    for (number,), own in numbered.sort(CHUNK, AXIS, SLICE).group_by(CHUNK, maintain_order=True):
        many = pl.max(END) + 1 - pl.min(START)
        reads = own.group_by(PART).agg(pl.min(START), many.alias("many"), pl.sum(ROWS)).sort(PART).iter_rows()
        listed = tuple(Read(parts[part], columns, start, many, many == rows) for part, start, many, rows in reads)
        wanted = own.select(AXIS, SLICE).unique(maintain_order=True)
        found.append(Chunk(cast(int, number), wanted, listed, int(own[ROWS].sum())))
    return found


#: Problem of a file that changed while it was read.
REWRITTEN = "the file changed while pmfid read it: run the command again once the file is complete"


def read_chunk(chunk: Chunk, length: float) -> tuple[pl.DataFrame, list[RowProblem]]:
    """Return the rows of a chunk, in the order of the parts. Parts that cannot be read have problems in place of
    rows."""
    frames, problems = list[pl.DataFrame](), list[RowProblem]()
    for one in chunk.reads:
        columns = one.columns.carried
        try:
            with readable("data"):
                rows = one.part.rows(one.columns).select(columns).slice(one.first, one.many)
                if not one.only:
                    rows = rows.with_columns(slice_of(length)).join(chunk.wanted.lazy(), on=[AXIS, SLICE], how="semi")
                frames.append(rows.select(columns).collect())
        except UsageError as error:
            problems.append(unreadable(one.part, error))
        if one.part.rewritten:
            problems.append(RowProblem("", one.part.name, "rewritten", REWRITTEN))
    return pl.concat(frames) if frames else pl.DataFrame(), problems


def unreadable(part: Part, error: UsageError) -> RowProblem:
    return RowProblem("", part.name, "unreadable", " ".join(str(error).split()))


@contextmanager
def sort_mixed(
    chunks: Sequence[Chunk], numbered: pl.DataFrame, length: float, folder: Path | None
) -> Iterator[list[Chunk]]:
    """Open a context with chunks of which none reads far more rows than its own.

    Polars writes the rows of a part that mixes its axes into files by chunk. `folder` contains them until the end of
    the context; by default it is the folder of temporary files. Raises UsageError if the disk is full.
    """
    rows, read = dict(numbered.group_by(PART).agg(pl.sum(ROWS)).iter_rows()), Counter[str]()
    for one in chunks:
        read.update({own.part.name: own.many for own in one.reads})
    mixed = {name for name, many in read.items() if many > TUNING.plan_times * rows[name]}
    with TemporaryDirectory(prefix="pmfid-", dir=folder) if mixed else nullcontext("") as there:
        known = {own.part.name: own for one in chunks for own in one.reads if own.part.name in mixed}
        written = {
            name: _write_by_chunk(known[name], numbered.filter(pl.col(PART) == name), length, Path(there) / str(k))
            for k, name in enumerate(sorted(mixed))
        }
        yield [
            replace(
                one,
                reads=tuple(
                    written[own.part.name](own, one.number) if own.part.name in mixed else own for own in one.reads
                ),
            )
            for one in chunks
        ]


def _folders_by_chunk(folder: Path) -> Any:
    """Return the target of Polars for a folder for each chunk, whose name differs between its versions."""
    if hasattr(pl, "PartitionBy"):
        return pl.PartitionBy(folder, key=CHUNK, include_key=False)
    return getattr(pl, "PartitionByKey")(folder, by=[CHUNK], include_key=False)  # noqa: B009  unknown to later versions


def _write_by_chunk(read: Read, numbered: pl.DataFrame, length: float, folder: Path) -> Callable[[Read, int], Read]:
    """Write the rows of a part into a folder for each chunk, and return what reads them in place of the part."""
    rows = read.part.rows(read.columns).select(read.columns.carried).with_columns(slice_of(length))
    chosen = rows.join(numbered.lazy().select(AXIS, SLICE, CHUNK), on=[AXIS, SLICE]).drop(SLICE)
    try:
        with readable("data"):
            chosen.sink_parquet(_folders_by_chunk(folder), compression="lz4", mkdir=True)
    except UsageError:
        if shutil.disk_usage(folder.parent).free < TUNING.plan_free:
            raise UsageError(
                f"{folder.parent.parent}: no space left on this disk; {read.part.name} mixes the rows of its axes, and "
                "pmfid sorts them there: free some space, or choose another folder"
            ) from None
        return lambda own, chunk: own  # each chunk reports the damaged part
    return lambda own, chunk: Read(
        replace(own.part, open=partial(pl.scan_parquet, folder / f"{CHUNK}={chunk}", hive_partitioning=False)),
        own.columns.own, 0, 2**31, True,
    )  # fmt: skip

"""The work on one shard, as a value: what an engine sends to where the rows are."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pmfid.errors import UsageError
from pmfid.fleet.aside import Aside
from pmfid.fleet.plan import RowShard
from pmfid.fleet.rows import RecordPiece, pieces_of, read_rows, rows_of
from pmfid.fleet.segments import Segments, solve
from pmfid.fleet.settings import Settings
from pmfid.fleet.source import Columns, Part
from pmfid.fleet.survey import Survey
from pmfid.session.tables import Table

if TYPE_CHECKING:
    import polars as pl

#: Shards whose first axes are looked at for one that tells the configuration.
TRIED = 5


@dataclass(frozen=True)
class Work:
    """settings, columns: of the history; length: of a slice [s]."""

    settings: Settings
    columns: Columns
    length: float

    def shard(self, shard: RowShard, parts: Mapping[str, Part], aside: Aside | None = None) -> Segments:
        """The segments of a shard, from the files that have its rows, or from where these are put aside."""
        rows, problems = read_rows(shard, parts, self.columns, self.length, aside)
        found = solve(pieces_of(rows, self.columns, self.length), self.settings)
        return Segments(found.rows, (*problems, *found.problems))

    def frame(self, frame: pl.DataFrame) -> Segments:
        """The segments of rows that an engine has brought together, in any order: all those of a slice of an axis must
        be there. frame: with the columns of `source`."""
        rows, problems = rows_of(frame, self.columns)
        found = solve(pieces_of(rows, self.columns, self.length), self.settings)
        return Segments(found.rows, (*problems, *found.problems))


def samples_of(
    shards: Sequence[RowShard], parts: Mapping[str, Part], columns: Columns, length: float, aside: Aside | None = None
) -> Iterator[Table]:
    """The longest piece of the first slice of each of the first axes, a table for each."""
    for shard in shards[:TRIED]:
        rows, _ = read_rows(shard, parts, columns, length, aside)
        slices: dict[str, dict[int, list[RecordPiece]]] = defaultdict(lambda: defaultdict(list))
        for piece in pieces_of(rows, columns, length):
            slices[piece.axis][math.floor(piece.start / length)].append(piece)
        for axis in sorted(slices)[:TRIED]:
            first = slices[axis][min(slices[axis])]
            yield longest(first, columns)


def first_table(frame: pl.DataFrame, columns: Columns, length: float) -> Table | None:
    """The table of the longest first piece in rows of one axis that an engine has gathered; None: there is no piece."""
    rows, _ = rows_of(frame, columns)
    pieces = list(pieces_of(rows, columns, length))
    return (
        longest([one for one in pieces if one.start // length == pieces[0].start // length], columns)
        if pieces
        else None
    )


def longest(pieces: Sequence[RecordPiece], columns: Columns) -> Table:
    """The table of the longest piece."""
    return max(pieces, key=lambda piece: len(piece.table[columns.time])).table  # type: ignore[arg-type]


def check_columns(columns: Columns, parts: Sequence[Part], found: Survey) -> None:
    """Raises UsageError where no part has rows with the columns that are named."""
    if found.rows.height:
        return
    for part in parts[:1]:
        try:
            part.rows(columns)
        except UsageError as error:
            raise UsageError(f"{part.name}: {error}") from None
    reason = next((f": {one.part}: {one.text}" for one in found.problems if one.code == "unreadable"), "")
    raise UsageError(f"no file of the data set could be read{reason}; run pmfid check on one")

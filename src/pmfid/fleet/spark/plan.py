"""Which shard each row belongs to, as a table that the executors join with their rows."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pmfid.fleet.plan import BLOCK, RowShard
from pmfid.fleet.source import AXIS, INPUT, MASK, OUTPUT, TIME, Columns
from pmfid.fleet.spark.tasks import NUMBER
from pmfid.types import Floats

if TYPE_CHECKING:
    import polars as pl

#: Greatest number of jobs: the results of a job are stored at its end, but each job reads its times again.
JOBS = 16
_PLACE = "place"


@dataclass(frozen=True)
class RowPlan:
    """edges: (n,) [s], all times at which shards begin or end, in order; places: which shard an axis is in, from each
    edge on."""

    edges: Floats
    places: pl.DataFrame

    @classmethod
    def from_shards(cls, shards: Sequence[RowShard], length: float) -> RowPlan:
        """The plan of shards that share no row, by their index in the sequence; length: of a slice [s]."""
        import polars as pl

        ends = np.array([[one.first * length, one.last * length] for one in shards]).reshape(-1, 2)
        edges = np.unique(ends)
        low, high = np.searchsorted(edges, ends).T
        rows = [
            (axis, place, number)
            for number, one in enumerate(shards)
            for axis in one.axes
            for place in range(low[number], high[number])
        ]
        kinds = {AXIS: pl.String, _PLACE: pl.Int64, NUMBER: pl.Int32}
        return cls(edges, pl.DataFrame(rows, schema=kinds, orient="row"))

    def tag_rows(self, rows: pl.LazyFrame, columns: Columns) -> pl.DataFrame:
        """The rows that are in a shard, with its number; rows: of `Part.rows`."""
        import polars as pl

        known = rows.select(list_carried_columns(columns)).drop_nulls([AXIS, TIME]).collect()
        place = np.searchsorted(self.edges, known[TIME].to_numpy(), side="right") - 1
        joined = known.with_columns(pl.Series(_PLACE, place, pl.Int64)).join(self.places, on=[AXIS, _PLACE])
        return joined.select(NUMBER, *list_carried_columns(columns))


def list_carried_columns(columns: Columns) -> list[str]:
    """Columns that an estimate needs, by the names of `source`."""
    return [AXIS, TIME, INPUT, OUTPUT, *([MASK] if columns.mask else [])]


def jobs_of(shards: Sequence[RowShard]) -> list[list[RowShard]]:
    """The shards of some blocks of time together, in their order."""
    blocks: dict[int, list[RowShard]] = defaultdict(list)
    for shard in shards:
        blocks[shard.first // BLOCK].append(shard)
    jobs: list[list[RowShard]] = []
    enough = sum(shard.rows for shard in shards) / JOBS
    for block in sorted(blocks):
        if jobs and sum(shard.rows for shard in jobs[-1]) < enough:
            jobs[-1] += blocks[block]
        else:
            jobs.append(blocks[block])
    return jobs

"""In which rows of a large file a shard has its own: the others are not read."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import replace
from typing import TYPE_CHECKING

from pmfid.fleet import source
from pmfid.fleet.plan import RowShard
from pmfid.fleet.source import AXIS, Part
from pmfid.fleet.survey import EXTENT, FIRST, LAST, PART, ROWS, START

if TYPE_CHECKING:
    import polars as pl


class Places:
    """names: of the parts that can be read in windows; rows: of the `Survey`. Files of one window are read whole."""

    def __init__(self, names: Set[str], rows: pl.DataFrame) -> None:
        import polars as pl

        large = pl.col(ROWS).sum().over(PART) > source.WINDOW
        found = rows.filter(pl.col(PART).is_in(list(names)) & large)
        groups = found.partition_by(PART, as_dict=True, include_key=False)
        self._rows = {str(key[0]): group for key, group in groups.items()}

    def narrow(self, part: Part, shard: RowShard, length: float) -> Part:
        """The part from the first to the last row that the shard may have in it; length: of a slice [s]."""
        import polars as pl

        if part.name not in self._rows:
            return part
        inside = (pl.col(LAST) >= shard.first * length) & (pl.col(FIRST) < shard.last * length)
        own = self._rows[part.name].filter(pl.col(AXIS).is_in(list(shard.axes)) & inside)
        if not own.height:
            return replace(part, first=0, many=0)
        first, last = own.select(pl.min(START), (pl.col(START) + pl.col(EXTENT)).max().alias("end")).row(0)
        return replace(part, first=first, many=last - first)

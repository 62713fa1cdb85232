"""Slices of time that are estimated by themselves, and shards of them that fit the memory.

A slice begins at a multiple of its length, whatever files the rows stand in, so that the estimates know nothing of
partitions, shards or workers. What is added to a data set changes the shards of its own times alone.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pmfid.errors import UsageError
from pmfid.fleet.source import AXIS
from pmfid.fleet.survey import FIRST, LAST, PART, ROWS

if TYPE_CHECKING:
    import polars as pl

#: Lengths of a slice [s], and how many samples it has at most.
LENGTHS, MOST_SAMPLES = (3600.0, 900.0, 180.0, 60.0, 15.0, 5.0, 1.0), 2**19
#: Slices whose rows are shared out together.
BLOCK = 24
#: Rows of a shard: 40 bytes each, and as much again while they are sorted and estimated from.
BUDGET = 2**22


@dataclass(frozen=True)
class RowShard:
    """axes in the slices first <= k < last, and the parts that have rows of them; rows: about how many."""

    axes: tuple[str, ...]
    first: int
    last: int
    parts: tuple[str, ...]
    rows: int


def slice_length(rows: pl.DataFrame, period: float | None) -> float:
    """Length of a slice [s]: a part or a multiple of the period [s], None: of any; by the rate at which most axes are
    sampled, and short enough for the rows of the fastest to fit a shard."""
    import polars as pl

    step = (pl.col(LAST) - pl.col(FIRST)) / (pl.col(ROWS) - 1)
    steps = rows.filter(pl.col(LAST) > pl.col(FIRST)).select(step.alias("dt"))["dt"].to_numpy()
    if not steps.size:
        raise UsageError("no axis has two rows at different times on a day; check --axis, [record] time and time_unit")
    dt = float(np.median(steps))
    fastest = _fastest(rows)
    fits = (length for length in LENGTHS if length / dt <= MOST_SAMPLES and length * fastest <= BUDGET)
    longest = next(fits, LENGTHS[-1])
    if period is None:
        return longest
    return period / math.ceil(period / longest - 1e-9) if period > longest else period * math.floor(longest / period)


def _fastest(rows: pl.DataFrame) -> float:
    """Rows per second of the fastest of the axes that have more rows than a shard: a few rows close together are small
    in slices of any length."""
    import polars as pl

    span, many = (pl.col(LAST) - pl.col(FIRST)).sum(), (pl.col(ROWS) - 1).sum()
    axes = rows.group_by(AXIS).agg(span.alias("span"), many.alias("many"))
    large = axes.filter((pl.col("many") > BUDGET) & (pl.col("span") > 0))
    return float(large.select((pl.col("many") / pl.col("span")).max()).item() or 0.0)


def shards_of(rows: pl.DataFrame, length: float) -> list[RowShard]:
    """All shards, in the order of time and of axes; rows: of the `Survey`; length: of a slice [s]."""
    blocks: dict[int, dict[str, dict[str, float]]] = defaultdict(lambda: defaultdict(dict))
    for part, axis, count, first, last in rows.select(PART, AXIS, ROWS, FIRST, LAST).iter_rows():
        for block, share in _blocks(first, last, length * BLOCK):
            # a block may hold several days of a part
            own = blocks[block][axis]
            own[part] = own.get(part, 0.0) + count * share
    found: list[RowShard] = []
    for block in sorted(blocks):
        for axes in _pack_axes(blocks[block]):
            found += _cut(axes, blocks[block], block * BLOCK, (block + 1) * BLOCK)
    return found


def _blocks(first: float, last: float, length: float) -> Iterator[tuple[int, float]]:
    """Blocks that rows from first to last [s] fall into, with the part of the rows that does, if they are even."""
    low, high = math.floor(first / length), math.floor(last / length)
    span = max(last - first, 1e-9)
    for block in range(low, high + 1):
        inside = min(last, (block + 1) * length) - max(first, block * length)
        yield block, 1.0 if low == high else max(0.0, inside / span)


def _pack_axes(block: Mapping[str, Mapping[str, float]]) -> Iterator[tuple[str, ...]]:
    """The axes of a block in groups of at most BUDGET rows, or of one axis."""
    group: list[str] = []
    total = 0.0
    for axis in sorted(block):
        size = sum(block[axis].values())
        if group and total + size > BUDGET:
            yield tuple(group)
            group, total = [], 0.0
        group.append(axis)
        total += size
    if group:
        yield tuple(group)


def _cut(
    axes: Sequence[str], block: Mapping[str, Mapping[str, float]], first: int, last: int, share: float = 1.0
) -> list[RowShard]:
    """The slices of a group of axes, halved until their rows fit; share: of the block's rows that they have."""
    total = share * sum(sum(block[axis].values()) for axis in axes)
    if total > BUDGET and last - first > 1:
        middle = (first + last) // 2
        return _cut(axes, block, first, middle, share / 2) + _cut(axes, block, middle, last, share / 2)
    parts = sorted({part for axis in axes for part in block[axis]})
    return [RowShard(tuple(axes), first, last, tuple(parts), round(total))]

"""Streams of blocks for the tests on Spark, and the same work in one process."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from random import Random

import polars as pl

from pmfid.fleet.shards import StreamPlan, StreamShard, shard_of, table_of
from pmfid.simulation import CART, CART_DT, Schedule
from pmfid.stream.blocks import encode
from pmfid.stream.checkpoint import Saved
from pmfid.stream.delivery import Block
from studies.monitoring.axis import INCREMENTS, changing
from tests.service.orders import made

#: Disorder of the blocks [samples].
WINDOW = 60
#: Time of the first file, in s since 1970: in the past, because Spark ignores files much older than the newest.
EARLIER = 1_700_000_000

Row = tuple[str, bytes]


def rows_of(axes: int, seconds: float) -> list[Row]:
    """Return name and bytes of the blocks of some axes in order of arrival.

    Some blocks come twice, some never, and some out of order. Every third axis becomes heavier.
    """
    found = list[tuple[float, Row]]()
    for k in range(axes):
        later = [(seconds / 2, replace(CART, mass=1.3 * CART.mass))] if k % 3 == 0 else []
        motion = changing(Schedule(((0.0, CART), *later)), k, INCREMENTS, seconds)
        arrived = made(*motion, Random(k), WINDOW).arrived
        name = f"axis-{k}"
        blocks = [replace(block, axis=name, dt=CART_DT) for block in arrived]
        found += [(place / len(blocks), (name, encode(block))) for place, block in enumerate(blocks)]
    return [row for _, row in sorted(found, key=lambda pair: pair[0])]


def block_of(name: str, seconds: float = 1.0, seed: int = 0) -> Block:
    """Return the first block of an axis."""
    u, counts = changing(Schedule(((0.0, CART),)), seed, INCREMENTS, seconds)
    return Block(name, 0, 0, 0.0, CART_DT, u, counts)


def parts_of(rows: Sequence[Row], files: int) -> list[list[Row]]:
    """Split the rows into the given number of files."""
    size = math.ceil(len(rows) / files)
    return [list(rows[k : k + size]) for k in range(0, len(rows), size)]


def write_parts(folder: Path, parts: Sequence[Sequence[Row]]) -> None:
    """Write a Parquet file for each part, a second apart: Spark orders files by their age in ms, not by name."""
    folder.mkdir(parents=True, exist_ok=True)
    for k, part in enumerate(parts):
        frame = pl.DataFrame({"axis": [name for name, _ in part], "block": [data for _, data in part]})
        path = folder / f"part-{k:04d}.parquet"
        frame.write_parquet(path)
        os.utime(path, (EARLIER + k, EARLIER + k))


def in_one_process(plan: StreamPlan, batches: Sequence[Sequence[Row]]) -> tuple[dict[int, bytes], pl.DataFrame]:
    """Return the bodies of all shards after these batches, and all output, of one process without a restart."""
    shards, tables = dict[int, StreamShard](), list[pl.DataFrame]()
    for batch in batches:
        by_shard: dict[int, list[bytes]] = {}
        for name, data in batch:
            by_shard.setdefault(shard_of(name, plan.shards), []).append(data)
        for number, messages in by_shard.items():
            shard = shards.setdefault(number, StreamShard(plan, number))
            shard.take(messages)
            tables.append(table_of(shard))
            shard.outcomes.estimates.clear()
            shard.outcomes.notices.clear()
    return {number: shard.save_state() for number, shard in shards.items()}, pl.concat(tables)


def estimates_of(table: pl.DataFrame) -> pl.DataFrame:
    """Return only the estimates, in a fixed order."""
    rows = table.filter(pl.col("row") == "estimate") if "row" in table.columns else table
    return rows.drop("row", "told", strict=False).sort("axis", "number")


def essence(saved: Saved) -> dict[str, object]:
    """Return the part of each axis's state that decides its future output, in a fixed order of the axes.

    The counts of late and reported deliveries are left out, because they depend on the ends of batches.
    """
    order = sorted(range(len(saved.axes)), key=saved.axes.__getitem__)
    names = [name for name in saved.seats.dtype.names or () if name != "seat"]
    gaps = {saved.axes[int(k)]: own.get("gaps") for k, own in saved.rare.items()}
    seats = {name: saved.seats[name][order].tobytes() for name in names}
    return {"axes": sorted(saved.axes), "seats": seats, "gaps": gaps, "held": len(saved.held)}

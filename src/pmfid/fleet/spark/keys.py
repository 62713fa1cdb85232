"""Keys by which Spark gives every shard a partition of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pyspark.sql import SparkSession

__all__ = ["keys_of"]

#: Numbers that are tried for each partition: one in e^30 has none among them.
TRIED = 30


def keys_of(spark: SparkSession, shards: int) -> list[int]:
    """A whole number for each shard: the least one whose hash is the number of the shard, modulo `shards`.

    With as many partitions as shards, each partition has one shard. Numbers in order would leave a third of the
    partitions empty, and put several shards into others.
    """
    numbers = spark.range(TRIED * shards).selectExpr("cast(id as int) as key", f"pmod(hash(key), {shards}) as place")
    table = numbers.toArrow().to_pydict()
    found: dict[int, int] = {}
    for key, place in sorted(zip(table["key"], table["place"], strict=True)):
        found.setdefault(place, key)
    return [found[number] for number in range(shards)]

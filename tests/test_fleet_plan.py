"""Shards fit the memory for any number of axes, files and processors."""

from __future__ import annotations

import threading
import time

import polars as pl
import pytest

from pmfid.fleet.data import Local, RowBudget
from pmfid.fleet.plan import shards_of, slice_length
from pmfid.fleet.tuning import TUNING
from tests.patience import PATIENCE


def survey(*rows: tuple[str, str, int, float, float]) -> pl.DataFrame:
    return pl.DataFrame(rows, schema=["part", "axis", "rows", "first", "last"], orient="row")


def test_the_days_of_a_part_in_one_block_are_added() -> None:
    rows = survey(
        ("a", "x", 3000, 0.0, TUNING.plan_day - 1), ("a", "x", 2000, TUNING.plan_day, 2 * TUNING.plan_day - 1)
    )

    shards = shards_of(rows, TUNING.plan_day)

    assert sum(shard.rows for shard in shards) == 5000


def test_one_fast_axis_among_slow_ones_fits_a_shard() -> None:
    slow = [("a", f"slow-{k}", 360_000, 0.0, 3600.0) for k in range(5)]
    rows = survey(*slow, ("b", "fast", 36_000_000, 0.0, 3600.0))

    length = slice_length(rows, None)

    assert length == 180.0
    assert max(shard.rows for shard in shards_of(rows, length)) <= TUNING.plan_budget


def test_a_few_rows_close_together_shorten_no_slice() -> None:
    slow = [("a", f"slow-{k}", 360_000, 0.0, 3600.0) for k in range(5)]

    assert slice_length(survey(*slow, ("b", "odd", 3, 0.0, 2e-6)), None) == 3600.0


@pytest.mark.parametrize(("rows", "most"), [(4, 2), (5, 2), (30, 1)])
def test_memory_knows_no_number_of_threads(rows: int, most: int) -> None:
    room, lock = RowBudget(10), threading.Lock()
    inside, largest = 0, 0

    def work(item: int) -> int:
        nonlocal inside, largest
        with room.reserve(rows):
            with lock:
                inside += 1
                largest = max(largest, inside)
            end = time.monotonic() + PATIENCE
            while largest < most and time.monotonic() < end:
                time.sleep(0.001)
            time.sleep(0.005)
            with lock:
                inside -= 1
        return item

    assert list(Local(workers=8).map(work, range(16))) == list(range(16))
    assert largest == most

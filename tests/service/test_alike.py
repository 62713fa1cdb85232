"""Messages of equal blocks are one table, with the content of single blocks."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pmfid.stream.blocks import encode, items
from pmfid.stream.delivery import Block, Table, Unusable
from tests.service.test_blocks import decode

SIZE = 7


def block(k: int, wide: bool = False, name: str = "axis-{:02d}", edges: bool = False) -> Block:
    rng = np.random.default_rng(k)
    u = rng.normal(size=SIZE).astype(np.float32).astype(float) + (1e-12 if wide else 0.0)
    u[k % SIZE] = math.nan
    counts = rng.integers(-(2**40) if wide else -99, 2**40 if wide else 99, SIZE)
    time = math.nan if k % 3 == 0 else 0.25 * k
    ages = np.where(np.isnan(u), u, 1e-3 * abs(u) if wide else 2.0**-10) if edges else None
    return Block(name.format(k), k, 10 * k, time, 0.01, u, counts, ages)


def _bytes(ages: np.ndarray | None) -> bytes | None:
    return None if ages is None else ages.tobytes()


def said(found: list[Block | Unusable]) -> list[tuple[object, ...]]:
    return [
        (
            one.axis,
            one.epoch,
            one.first,
            repr(one.time),
            one.dt,
            one.u.tobytes(),
            one.counts.tobytes(),
            _bytes(one.ages),
        )
        if isinstance(one, Block)
        else (one.reason, one.problem, one.axis)
        for one in found
    ]


@pytest.mark.parametrize("edges", [False, True])
@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize("name", ["axis-{:02d}", "ä{}-long-name-of-an-axis-0123456789"])
def test_many_blocks_say_what_each_says(wide: bool, name: str, edges: bool) -> None:
    parts = [encode(block(k % 9 + 1, wide, name, edges)) for k in range(30)]
    (found,) = items(b"".join(parts))
    assert isinstance(found, Table)
    assert said([*found.blocks()]) == said([one for part in parts for one in decode(part)])
    assert found.u.dtype == np.float64
    assert found.counts.dtype == np.int64


@pytest.mark.parametrize("damaged", [(3,), (0,), (7,), (2, 3), (0, 7), (1, 4, 6)])
@pytest.mark.parametrize("place", [-1, -5, 30, 60])
def test_a_wrong_checksum_costs_each_block_that_is_damaged(damaged: tuple[int, ...], place: int) -> None:
    parts = [bytearray(encode(block(k + 1))) for k in range(8)]
    for k in damaged:
        parts[k][place] ^= 1
    found = decode(b"".join(parts))
    assert [one.reason for one in found if isinstance(one, Unusable)] == ["crc"] * len(damaged)
    assert sum(isinstance(one, Block) for one in found) == 8 - len(damaged)

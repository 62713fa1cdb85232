"""Blocks of many axes as one table give the bits of the same blocks one by one."""

from __future__ import annotations

from collections.abc import Sequence
from random import Random

import numpy as np
import pytest

from pmfid.service.arrangement import arrange_groups
from pmfid.simulation import CART_DT
from pmfid.stream import order as clock
from pmfid.stream.checkpoint import draft
from pmfid.stream.delivery import Block, Delivery, Item, Lines, Table, split_tables
from pmfid.stream.engine import StreamEngine
from pmfid.stream.groups import Pace, Prepared
from pmfid.stream.outcome import Counters
from pmfid.stream.timeline import Line
from tests.service.collected import Collected
from tests.tuned import set_tuning

AXES = tuple(f"x{k}" for k in range(6))
SIZE, TURNS = 8, 60
PACE = Pace(4 * SIZE * CART_DT, 5 * CART_DT)


def engine_of(prepared: Prepared, outlet: Collected, axes: Sequence[str] = AXES) -> StreamEngine:
    engine = StreamEngine(Counters(), [outlet])
    engine.set_groups(arrange_groups([], dict.fromkeys(axes, prepared), PACE)[0])
    return engine


def sent(name: str, random: Random) -> list[Block]:
    """Return blocks of an axis, of which some are lost, repeated or late.

    The clock is set, has another rate, or is absent. At times a new epoch or another sample period begins.
    """
    rng = np.random.default_rng(random.randrange(2**32))
    rate, timed = random.choice([1.0, 1.0, 1.02]), random.random() < 0.8
    blocks, epoch, begun, shift, place = list[Block](), 0, 0, 0.0, 0.0
    for k in range(TURNS):
        if random.random() < 0.03:
            epoch, begun = epoch + 1, random.choice([k, begun])
        shift += random.choice([-100.0, 500.0]) if random.random() < 0.04 else 0.0
        first = (k - begun) * SIZE
        time = place + shift if timed else np.nan
        place += (rate if k < TURNS // 3 else 1.0) * SIZE * CART_DT
        dt = CART_DT * (1.0 if random.random() < 0.97 else 1.1)
        u, counts = rng.normal(size=SIZE), rng.integers(-3, 4, SIZE).cumsum() + 40 * k
        blocks.append(Block(name, epoch, first, time, dt, u, counts))
    found = list[Block]()
    for block in blocks:
        found += [block] * random.choices([0, 1, 2], [0.05, 0.9, 0.05])[0]
    for k in range(len(found) - 1):
        if random.random() < 0.1:
            found[k], found[k + 1] = found[k + 1], found[k]
    return found


def table(blocks: Sequence[Block]) -> Table:
    numbers = np.array([(one.epoch, one.first) for one in blocks], np.int64)
    times = np.array([(one.time, one.dt) for one in blocks])
    u, counts = np.stack([one.u for one in blocks]), np.stack([one.counts for one in blocks])
    return Table(tuple(one.axis for one in blocks), *numbers.T, *times.T, u, counts)


def deliveries(random: Random) -> list[Delivery]:
    """Return tables of blocks of several axes and of an unknown axis; at times a line or a single block."""
    left = {name: sent(name, random)[::-1] for name in (*AXES[:5], "nobody")}
    lines = [Line(k * CART_DT, 0.1 * k, k) for k in range(1000)][::-1]
    found = list[Delivery]()
    while any(left.values()):
        names = [name for name, blocks in left.items() if blocks]
        chosen = random.choices(names, k=random.randint(1, 4)) if random.random() < 0.2 else names
        blocks = [left[name].pop() for name in chosen if left[name]]
        items: list[Item] = [table(blocks)] if blocks else []
        if random.random() < 0.2:
            items.insert(random.randint(0, len(items)), Lines(AXES[5], [lines.pop() for _ in range(5)]))
        if random.random() < 0.2 and left["x2"]:
            items.append(left["x2"].pop())
        found.append(Delivery("source", items, received=float(len(found))))
    return found


def reported(engine: StreamEngine, outlet: Collected) -> tuple[object, ...]:
    counts = {key: value for key, value in engine.counters.values().items() if "seconds" not in key[0]}
    return outlet.rows_of, repr(sorted(outlet.notices.items())), counts, draft(engine).chunks()[2:]


@pytest.mark.parametrize("seed", range(4))
def test_a_table_is_its_blocks_one_by_one(prepared: Prepared, seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    set_tuning(monkeypatch, clock, rate_time=0.3)
    set_tuning(monkeypatch, clock, rate_samples=20)
    given = deliveries(Random(seed))
    random, outlets, engines = Random(seed), (Collected(), Collected()), list[StreamEngine]()
    batches = list[list[Delivery]]()
    while given:
        n = random.randint(1, 9)
        batches, given = [*batches, given[:n]], given[n:]
    for outlet, single in zip(outlets, (False, True), strict=True):
        engine = engine_of(prepared, outlet)
        for batch in batches:
            own = [Delivery(d.source, split_tables(d.items), received=d.received) for d in batch] if single else batch
            engine.process(own)
        engines.append(engine)
    tables, blocks = (reported(engine, outlet) for engine, outlet in zip(engines, outlets, strict=True))
    assert tables == blocks
    kinds = {what["event"] for _, what in outlets[0].notices.values()}
    assert {"gap", "clock", "epoch", "period"} <= kinds
    assert len(outlets[0].rows_of) > 4 * TURNS

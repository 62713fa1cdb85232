"""The inbox is bounded, and the engine takes as much from it, in order, as it can step at once."""

from __future__ import annotations

from threading import Thread

import numpy as np

from pmfid.stream.delivery import Block, Delivery, Table
from pmfid.stream.engine import Inbox
from pmfid.stream.tuning import TUNING
from tests.patience import PATIENCE
from tests.service.engine import wait_for


def delivery(k: int, blocks: int) -> Delivery:
    numbers, times = np.full(blocks, k), np.zeros(blocks)
    names = tuple(f"x{row}" for row in range(blocks))
    return Delivery(
        str(k), [Table(names, numbers, numbers, times, times, np.zeros((blocks, 2)), np.zeros((blocks, 2), int))]
    )


def test_a_delay_is_made_up_for_in_portions_and_in_order() -> None:
    inbox, size = Inbox(), 100
    for k in range(30):
        assert inbox.put(delivery(k, size))
    portions = []
    while len(inbox):
        portions.append(inbox.take_deliveries(0.0))
    assert [int(one.source) for portion in portions for one in portion] == list(range(30))
    assert all((len(portion) - 1) * size < TUNING.at_once <= len(portion) * size for portion in portions[:-1])
    assert inbox.take_deliveries(0.0) == []


def test_a_source_waits_while_the_inbox_is_full_of_blocks() -> None:
    inbox, put = Inbox(), list[int]()

    def fill() -> None:
        for k in range(12):
            if inbox.put(delivery(k, 1000)):
                put.append(k)

    source = Thread(target=fill, daemon=True)
    source.start()
    assert wait_for(lambda: len(put) == 9)
    assert len(inbox) == 9
    assert [one.source for one in inbox.take_deliveries(0.0)] == ["0", "1"]
    assert wait_for(lambda: len(put) == 11)
    inbox.close()
    source.join(PATIENCE)
    left = [one for _ in range(9) for one in inbox.take_deliveries(0.0)]
    assert [int(one.source) for one in left] == list(range(2, 11))
    assert inbox.closed
    assert not inbox.put(Delivery("late", [Block("x", 0, 0, 0.0, 1.0, np.zeros(1), np.zeros(1, int))]))

"""The messages that a sender keeps, number by number, without a broker."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pmfid.errors import UsageError
from pmfid.service.wire.sender import Numbering, Outbox
from pmfid.stream.blocks import decode
from pmfid.stream.delivery import Block


class Link:
    """A link that numbers published messages from 1 for each connection."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []

    def __call__(self, payload: bytes) -> int:
        self.sent.append(payload)
        return len(self.sent)


def test_what_a_broker_may_have_forgotten_goes_out_again_in_order() -> None:
    now = [0.0]
    box, link = Outbox(10.0, 10**6, lambda: now[0]), Link()
    for k in range(5):
        box.take(bytes([k]))
    assert not box.pump(link), "there is no connection yet"
    box.begin(3)
    assert box.pump(link)
    assert not box.pump(link)
    assert link.sent == [b"\0"], "the first message proves that the broker has a receiver"
    box.note_acknowledged(1)
    box.pump(link)
    assert link.sent[1:] == [b"\1", b"\2", b"\3"], "no more than have room"
    now[0] = 5.0
    box.note_acknowledged(2)
    box.pump(link)
    assert link.sent[4:] == [b"\4"]
    box.end()
    now[0] = 100.0
    box.take(b"\5")
    assert not box.settled
    box.begin(100)
    link = Link()
    for k in range(6):
        box.pump(link)
        assert not box.settled
        box.note_acknowledged(k + 1)
    assert b"".join(link.sent) == bytes(range(6)), "while the connection is down nothing becomes safe"
    assert box.settled
    now[0] = 111.0
    box.take(b"\6")
    box.begin(100)
    box.pump(link := Link())
    assert link.sent == [b"\6"], "what has been safe for long enough is forgotten"
    assert box.dropped == 0


def test_the_oldest_go_where_there_is_no_room_and_are_counted_once() -> None:
    box = Outbox(10.0, 3)
    box.begin(2)
    for k in range(3):
        box.take(bytes([k]))
    link = Link()
    box.pump(link)
    box.note_acknowledged(1)
    box.pump(link)
    for k in range(3, 6):
        box.take(bytes([k]))
    assert box.dropped == 2, "the first was acknowledged"
    box.note_acknowledged(2)
    box.begin(9)
    link = Link()
    for k in range(3):
        box.pump(link)
        box.note_acknowledged(k + 1)
    assert b"".join(link.sent) == bytes([3, 4, 5])
    assert box.settled


@pytest.mark.parametrize("seed", range(3))
def test_samples_in_any_portions_give_the_same_blocks(seed: int) -> None:
    rng = np.random.default_rng(seed)
    numbering, made, k = Numbering(0.01, 3, 7), b"", 0
    while k < 200:
        n = int(rng.integers(0, 30))
        made += b"".join(numbering.add("x1", np.arange(k, k + n), np.arange(k, k + n), 0.01 * k))
        k += n
    assert numbering.waits == (k % 7 != 0)
    blocks = decode(made + b"".join(numbering.rest()))
    assert not numbering.waits
    assert all(isinstance(block, Block) for block in blocks)
    assert [block.first for block in blocks] == list(range(0, k, 7))
    assert [block.time for block in blocks] == pytest.approx([0.01 * block.first for block in blocks])
    assert np.concatenate([block.counts for block in blocks]).tolist() == list(range(k))


@pytest.mark.parametrize(
    ("u", "counts", "name"), [(math.inf, 1, "x"), ([1.0, 2.0], [1], "x"), (1.0, 1, ""), (1.0, 1, "a" * 65)]
)
def test_what_no_block_takes_is_refused_and_costs_nothing(u: object, counts: object, name: str) -> None:
    numbering = Numbering(0.01, 0, 1)
    with pytest.raises(UsageError):
        numbering.add(name, u, counts, 0.0)
    (made,) = numbering.add("x", 1.0, 1, 0.0)
    assert [block.first for block in decode(made)] == [0]
    with pytest.raises(UsageError, match="1 to 1024"):
        Numbering(0.01, 0, 1025)

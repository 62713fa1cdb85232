"""The broker is killed, absent, or serves another service of the same name: no data are lost, and a notice says so."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest

from examples.gateway import Gateway
from pmfid.stream.blocks import encode
from pmfid.stream.delivery import Block
from tests.service.broker import Broker, needs_broker, stopped_brokers  # noqa: F401 a fixture
from tests.service.engine import FakeEngine, wait_for
from tests.service.test_mqtt import connected, source, stop

pytestmark = [needs_broker, pytest.mark.usefixtures("stopped_brokers")]


def through_kills(folder: Path, kills: int, seconds: float, more: str) -> tuple[FakeEngine, dict[str, int]]:
    """Return the deliveries of a sender whose broker is killed repeatedly, and the samples that each axis sent."""
    engine, broker, rng = FakeEngine(), Broker(folder, more).start(), np.random.default_rng(kills)
    hall = source(engine, broker, "killed")
    thread = engine.running(hall)
    assert connected(hall)
    ended, sent = threading.Event(), {"x1": 0, "x2": 0}
    gateway = Gateway("killed/a", port=broker.port, keep=10.0)  # a loaded broker saves late

    def feed() -> None:
        while not ended.wait(0.02):
            for name in sent:
                numbers = np.arange(sent[name], sent[name] + int(rng.integers(1, 9)))
                gateway.send(
                    encode(Block(name, 1, sent[name], 0.01 * sent[name], 0.01, numbers.astype(float), numbers))
                )
                sent[name] += numbers.size

    feeder = threading.Thread(target=feed)
    feeder.start()
    for k in range(kills):
        for _ in range(4):
            ended.wait(seconds / 4)
            engine.checkpoint()
        broker.kill()
        ended.wait(0.3 * (k % 3))
        broker.start()
    ended.wait(seconds / 2)
    ended.set()
    feeder.join()
    assert wait_for(lambda: not gateway.waiting.unfinished_tasks)

    def complete() -> bool:
        engine.checkpoint()
        return engine.reached == sent

    wait_for(complete)
    stop(hall, thread)
    broker.stop()
    return engine, sent


def check_nothing_lost(engine: FakeEngine, sent: dict[str, int]) -> None:
    """Check that each axis has no hole, in the order of delivery and without repeated samples."""
    for name, n in sent.items():
        expected = 0
        for block in engine.blocks:
            if block.axis == name and block.end > expected:
                assert block.first <= expected, f"a hole before {block.first} of {name}, expected {expected}"
                assert block.counts.tolist() == list(range(block.first, block.end))
                expected = block.end
        assert expected == n


PERSISTENT = "max_queued_messages 100000\n"


def test_a_killed_broker_costs_nothing(tmp_path: Path) -> None:
    engine, sent = through_kills(tmp_path, 2, 0.5, PERSISTENT)
    check_nothing_lost(engine, sent)
    assert sum(block.end - block.first for block in engine.blocks) > sum(sent.values()), "nothing was sent again"
    assert any("ended" in problem for problem in engine.problems())
    assert engine.problems()[-1] == ""


def test_two_services_under_one_name_are_reported(tmp_path: Path) -> None:
    engine, broker = FakeEngine(), Broker(tmp_path).start()
    first, second = source(engine, broker, "same"), source(FakeEngine(), broker, "same")
    threads = [engine.running(first)]
    assert connected(first)
    threads.append(engine.running(second))
    assert wait_for(lambda: "another service uses the session 'same'" in str(engine.problems()))
    stop(first, threads[0])
    stop(second, threads[1])

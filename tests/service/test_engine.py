"""The estimates of the service equal `pmfid monitor` in any order of delivery, and after restarts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from random import Random

import numpy as np
import pytest

from pmfid.service.arrangement import arrange_groups
from pmfid.simulation import CART, CART_DT, Schedule
from pmfid.stream.checkpoint import draft, read_snapshot
from pmfid.stream.delivery import Block, Delivery, Unusable
from pmfid.stream.engine import StreamEngine
from pmfid.stream.groups import Pace, Prepared
from pmfid.stream.order import UNKNOWN_GAP
from pmfid.stream.outcome import Counters
from pmfid.stream.timeline import Sample
from studies.monitoring.axis import INCREMENTS, changing
from tests.service.collected import Collected, monitored
from tests.service.orders import Sending, made

AXES = ("x1", "x2", "x3")
WINDOW = 60
PACE = Pace(WINDOW * CART_DT, 0.0)
SECONDS = 16.0


@pytest.fixture(scope="module")
def motions() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return u and counts of each axis; the mass of the second axis grows by a third."""
    heavier = Schedule(((0.0, CART), (8.0, replace(CART, mass=1.33 * CART.mass))))
    plants = {name: heavier if name == "x2" else Schedule(((0.0, CART),)) for name in AXES}
    return {name: changing(plants[name], 5 + k, INCREMENTS, SECONDS) for k, name in enumerate(AXES)}


def engine_of(prepared: Prepared, outlet: Collected, pace: Pace = PACE, axes: Sequence[str] = AXES) -> StreamEngine:
    engine = StreamEngine(Counters(), [outlet])
    engine.set_groups(arrange_groups([], dict.fromkeys(axes, prepared), pace)[0])
    return engine


def named(sending: Sending, name: str) -> list[Block]:
    return [replace(block, axis=name, dt=CART_DT) for block in sending.arrived]


def mixed(blocks: dict[str, list[Block]], random: Random) -> list[Delivery]:
    """Mix the blocks of several axes into one stream, which keeps the order of each axis."""
    left = {name: list(reversed(own)) for name, own in blocks.items()}
    found = []
    while any(left.values()):
        name = random.choice([name for name, own in left.items() if own])
        items = [left[name].pop() for _ in range(min(random.randint(1, 3), len(left[name])))]
        found.append(Delivery("source", items))
    return found


@dataclass
class Restarted:
    """An engine that is killed at times and resumes from its last checkpoint; later data are delivered again."""

    prepared: Prepared
    outlet: Collected
    random: Random
    restarts: int = 0
    saved: tuple[int, bytes] | None = field(default=None)

    def run(self, deliveries: Sequence[Delivery], kills: float) -> StreamEngine:
        engine, k = engine_of(self.prepared, self.outlet), 0
        while k < len(deliveries):
            n = self.random.randint(1, 6)
            engine.process(deliveries[k : k + n])
            k = min(k + n, len(deliveries))
            if self.random.random() < 0.3:
                self.saved = k, b"".join(draft(engine).chunks())
            if self.saved is not None and self.random.random() < kills:
                engine, k = self.again(), max(0, self.saved[0] - self.random.choice([0, 0, 2]))
        return engine

    def again(self) -> StreamEngine:
        assert self.saved is not None
        self.restarts += 1
        found = read_snapshot(self.saved[1])
        engine = StreamEngine(Counters(), [self.outlet])
        found.restore(engine)
        groups = [one.restore_group(self.prepared, PACE) for one in found.groups]
        engine.set_groups(arrange_groups(groups, dict.fromkeys(AXES, self.prepared), PACE)[0])
        return engine


def expected(sending: Sending) -> list[Sample]:
    """Return the sorted data without duplicates as samples of `pmfid monitor`."""
    return [
        Sample(time, u, counts, max(0, lead), 1.0 if lead == UNKNOWN_GAP else 0.0)
        for lead, _, u, counts, time in sending.expected
    ]


@pytest.mark.parametrize(("seed", "kills"), [(0, 0.0), (1, 0.15)])
def test_rows_are_those_of_the_monitor_bit_by_bit(
    prepared: Prepared, motions: dict[str, tuple[np.ndarray, np.ndarray]], seed: int, kills: float
) -> None:
    random = Random(seed)
    sendings = {name: made(*motions[name], random, WINDOW, 0.1, 0.02) for name in AXES}
    deliveries = mixed({name: named(sending, name) for name, sending in sendings.items()}, random)
    outlet = Collected()
    restarted = Restarted(prepared, outlet, random)
    restarted.run(deliveries, kills)
    assert (restarted.restarts > 3) == (kills > 0)
    for name, sending in sendings.items():
        rows, reported = monitored(prepared, expected(sending))
        found = [bits for _, bits in outlet.of(name)]
        assert len(found) > len(rows) - 6 * WINDOW
        assert found == rows[: len(found)]
        numbers = [number for number, _ in outlet.of(name)]
        assert numbers == sorted(set(numbers))
        reported = [event for event in reported if event["event"] in ("alarm", "state", "settled")]
        events = outlet.events(name, "alarm", "state", "settled")
        assert len(events) >= len(reported) - 2
        for one, other in zip(events, reported, strict=False):
            assert one["event"] == other["event"]
            assert one["time"] == pytest.approx(other["time"], abs=1e-6)
            assert {**one, "time": 0, "changed_at": 0} == {**other, "time": 0, "changed_at": 0}
    assert outlet.events("x2", "alarm")
    assert (outlet.twice > 0) == (kills > 0)


def blocks_of(name: str, motion: tuple[np.ndarray, np.ndarray], size: int, epoch: int = 0) -> list[Block]:
    u, counts = motion
    cuts = range(0, counts.size, size)
    return [Block(name, epoch, k, k * CART_DT, CART_DT, u[k : k + size], counts[k : k + size]) for k in cuts]


def test_what_cannot_be_used_is_counted_by_reason_and_said_once(prepared: Prepared) -> None:
    outlet = Collected()
    engine = engine_of(prepared, outlet)
    said = list[dict[str, object]]()
    engine.tell = lambda what, axis="": said.append(what)  # type: ignore[method-assign]
    foreign = Block("nobody", 0, 0, 0.0, CART_DT, np.zeros(3), np.zeros(3, np.int64))
    engine.process([Delivery("a", [foreign, foreign, Unusable("crc", "the checksum is wrong")])] * 3)
    assert [(what["source"], what["reason"]) for what in said] == [("a", "axis"), ("a", "crc")]
    values = engine.counters.values()
    assert values["pmfid_unusable_total", (("reason", "axis"), ("source", "a"))] == 6


@pytest.mark.parametrize("u", [np.inf, -np.inf, np.nan])
def test_an_input_that_is_no_number_is_a_lost_sample(
    prepared: Prepared, motions: dict[str, tuple[np.ndarray, np.ndarray]], u: float
) -> None:
    inputs, counts = motions["x1"][0][:600].copy(), motions["x1"][1][:600]
    inputs[200:203] = u
    outlet = Collected()
    engine = engine_of(prepared, outlet, Pace(0.0, 0.0), ["x1"])
    engine.process([Delivery("a", blocks_of("x1", (inputs, counts), 50))])
    rows, _ = monitored(prepared, (Sample(k * CART_DT, float(inputs[k]), int(counts[k])) for k in range(600)))
    assert [bits for _, bits in outlet.of("x1")] == rows
    assert engine.counters.values()["pmfid_samples_without_input_total", (("group", "axis.toml"),)] == 3

"""Axes with the ages of edges in the service: the bits of `pmfid monitor`, every form of input, and wrong input."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from random import Random

import pytest

from pmfid.pipeline.monitored import setup
from pmfid.service.arrangement import arrange_groups
from pmfid.service.wire.messages import Messages
from pmfid.simulation import CART_DT
from pmfid.stream.blocks import encode
from pmfid.stream.blocks import items as items_of
from pmfid.stream.checkpoint import draft, read_snapshot
from pmfid.stream.delivery import Block, Delivery, Item, Lines
from pmfid.stream.engine import StreamEngine
from pmfid.stream.groups import Pace, Prepared, prepare
from pmfid.stream.lines import LineParser
from pmfid.stream.order import UNKNOWN_GAP
from pmfid.stream.outcome import Counters
from pmfid.stream.timeline import Sample
from tests.edge_axes import Motion, cart_edges, heavier, write_edge_axis
from tests.service.collected import Collected, monitored
from tests.service.orders import made

WINDOW = 60


@pytest.fixture(scope="module")
def edge_axis(tmp_path_factory: pytest.TempPathFactory) -> Prepared:
    folder = tmp_path_factory.mktemp("edges")
    write_edge_axis(folder)
    return prepare(folder / "axis.toml")


@pytest.fixture(scope="module")
def motion() -> Motion:
    return cart_edges(heavier(9.0), 7, 16.0)


def test_a_baseline_needs_no_calibration(prepared: Prepared, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(setup, "learn_edges", None)
    again = prepare(prepared.path, None, {prepared.digest: prepared.setup.baseline})
    assert again.setup.nominal.tolist() == prepared.setup.nominal.tolist()


def run(prepared: Prepared, deliveries: list[list[Item]], restarts: int = 0) -> Collected:
    """Return the outcome of deliveries to the axes x1 and x2, with restarts from a checkpoint spread over them."""
    outlet, names = Collected(), ("x1", "x2")
    engine = StreamEngine(Counters(), [outlet])
    engine.set_groups(arrange_groups([], dict.fromkeys(names, prepared), Pace(WINDOW * CART_DT, 0.0))[0])
    for k, items in enumerate(deliveries):
        engine.process([Delivery("source", items)])
        if restarts and k % (len(deliveries) // restarts) == 1:
            found = read_snapshot(b"".join(draft(engine).chunks()))
            engine = StreamEngine(Counters(), [outlet])
            found.restore(engine)
            engine.set_groups([one.restore_group(prepared, Pace(WINDOW * CART_DT, 0.0)) for one in found.groups])
    engine.tick(0.0)
    return outlet


@pytest.mark.parametrize("restarts", [0, 9])
def test_rows_and_alarms_are_those_of_the_monitor(edge_axis: Prepared, motion: Motion, restarts: int) -> None:
    u, counts, ages = motion
    sending = made(u, counts, Random(3), WINDOW, 0.03, 0.0, ages)
    deliveries: list[list[Item]] = [[replace(block, axis="x1", dt=CART_DT)] for block in sending.arrived]
    outlet = run(edge_axis, deliveries, restarts)
    samples = [
        Sample(time, u, n, max(0, lead), 1.0 if lead == UNKNOWN_GAP else 0.0, age)
        for (lead, _, u, n, time), age in zip(sending.expected, sending.ages, strict=True)
    ]
    rows, reported = monitored(edge_axis, samples)
    found = [bits for _, bits in outlet.of("x1")]
    assert len(found) > len(rows) - 6 * WINDOW
    assert found == rows[: len(found)]
    alarms = outlet.events("x1", "alarm")
    assert [one["parameter"] for one in alarms] == [one["parameter"] for one in reported if one["event"] == "alarm"]
    assert alarms[0]["parameter"] == "mass"


def texts(motion: Motion, form: str) -> bytes:
    """Return the first samples of x1 in a form of text; a missing age is a missing field or null."""
    rows = list(enumerate(zip(*(part[:400].tolist() for part in motion), strict=True)))
    given = [
        {"axis": "x1", "t": CART_DT * k, "u": u, "n": n, "age": None if math.isnan(age) else age}
        for k, (u, n, age) in rows
    ]
    if form == "columns":
        columns = {key: [row[key] for row in given] for key in ("t", "u", "n", "age")}
        return json.dumps({"axis": "x1", **columns}).encode()
    return json.dumps(given).encode()


def messages_of(motion: Motion, first: int = 0) -> list[bytes]:
    """Return blocks of 50 samples, of which the first has the number `first`."""
    parts = (slice(k, k + 50) for k in range(0, motion[0].size, 50))
    return [
        encode(Block("x1", 1, first + p.start, CART_DT * (first + p.start), CART_DT, *(column[p] for column in motion)))
        for p in parts
    ]


@pytest.mark.parametrize("form", ["json", "columns", "csv", "block"])
def test_every_form_of_input_gives_the_same_rows(edge_axis: Prepared, motion: Motion, form: str) -> None:
    config = edge_axis.axis
    if form == "csv":
        parser = LineParser(b"t,u,n,age", config)
        cells = zip(*(part[:400].tolist() for part in motion), strict=True)
        rows = [f"{CART_DT * k!r},{u!r},{n},{'' if math.isnan(a) else repr(a)}" for k, (u, n, a) in enumerate(cells)]
        items: list[Item] = [Lines("x1", [line for row in rows if (line := parser(row.encode())) is not None])]
    elif form == "block":
        items = [*items_of(b"".join(messages_of(tuple(part[:400] for part in motion))))]
    else:
        items = list(Messages({"x1": config}.get).items(texts(motion, form)))
    found = [bits for _, bits in run(edge_axis, [items]).of("x1")]
    samples = [
        Sample(CART_DT * k, *map(float, row[:1]), int(row[1]), further=float(row[2]))
        for k, row in enumerate(zip(*(part[:400].tolist() for part in motion), strict=True))
    ]
    assert len(found) >= 330  # lines wait for older ones
    assert found == monitored(edge_axis, samples)[0][: len(found)]


def test_blocks_without_ages_are_refused_in_one_sentence(edge_axis: Prepared, motion: Motion) -> None:
    plain = [encode(Block(name, 0, 0, 0.0, CART_DT, *(part[:40] for part in motion[:2]))) for name in ("x1", "x2") * 4]
    outlet, said = Collected(), list[dict[str, object]]()
    engine = StreamEngine(Counters(), [outlet])
    engine.set_groups(arrange_groups([], dict.fromkeys(("x1", "x2"), edge_axis), Pace(0.5, 1.0))[0])
    engine.tell = lambda what, axis="": said.append(what)  # type: ignore[method-assign]
    items = list(Messages({}.get).items(b"".join(plain)))
    engine.process([Delivery("hall", items)])
    assert not outlet.rows_of
    assert [one["reason"] for one in said] == ["ages"]
    assert "version 2" in str(said[0]["problem"])
    assert engine.counters.values()["pmfid_unusable_total", (("reason", "ages"), ("source", "hall"))] == 8

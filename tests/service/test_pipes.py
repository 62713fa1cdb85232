"""Serial ports, which deliver part of a line when they are opened, and Telegraf's pipe."""

from __future__ import annotations

import os
import threading
import tty
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from pydantic import Field

from pmfid.config.toml_file import FileSection, validate_sections
from pmfid.errors import UsageError
from pmfid.pipeline.tuning import TUNING
from pmfid.service.sources.execd import ExecdSection, ExecdSource
from pmfid.service.sources.serial import SerialSection, SerialSource
from pmfid.service.wire.messages import LineSplitter
from pmfid.stream.blocks import encode
from pmfid.stream.delivery import Block, Item, Lines, Unusable
from tests.patience import PATIENCE
from tests.service.engine import FakeEngine, wait_for
from tests.service.test_lines import axis


@dataclass
class Device:
    """The other end of a serial port."""

    controller: int
    port: str

    def write(self, data: bytes) -> None:
        os.write(self.controller, data)


@pytest.fixture
def device() -> Iterator[Device]:
    controller, port = os.openpty()
    tty.setraw(controller)
    yield Device(controller, os.ttyname(port))
    os.close(port)
    os.close(controller)


def serial_source(engine: FakeEngine, folder: Path, **options: object) -> SerialSource:
    section = SerialSection(kind="serial", **options)
    return SerialSource("port", section, {"x1": axis(folder)}.get, engine.tell)


def stop(running: SerialSource | ExecdSource, thread: threading.Thread) -> None:
    running.stop()
    thread.join(PATIENCE)
    assert not thread.is_alive()


def times(items: list[Item]) -> list[float]:
    return [line.time for item in items if isinstance(item, Lines) for line in item.lines]


def test_lines_come_whole_though_the_port_was_opened_within_one(device: Device, tmp_path: Path) -> None:
    engine = FakeEngine()
    port = serial_source(engine, tmp_path, port=device.port, axis="x1", header="t,u,x")
    thread = engine.running(port)
    assert wait_for(lambda: port.opened)
    device.write(b"9,1.5,0.001\n1,1.5,0.0")
    assert not wait_for(lambda: engine.items, 0.3), "a line without its beginning, and one without its end"
    device.write(b"01\r\n# restarted\n2,1,")
    device.write(b"0.002\nnonsense\n3,1,0.002\n")
    assert wait_for(lambda: 3.0 in times(engine.items))
    stop(port, thread)
    lines = [line for item in engine.items if isinstance(item, Lines) for line in item.lines]
    assert [line.time for line in lines if not line.problem] == [1.0, 2.0, 3.0]
    assert [line.counts for line in lines if not line.problem] == [43, 87, 87]
    assert "cells" in next(line.problem for line in lines if line.problem)


def test_the_header_may_come_by_the_port(device: Device, tmp_path: Path) -> None:
    engine = FakeEngine()
    port = serial_source(engine, tmp_path, port=device.port, axis="x1")
    thread = engine.running(port)
    assert wait_for(lambda: port.opened)
    device.write(b"Drive 7 ready\n1,2,3\n" + b"5,5,5\n" * TUNING.first_lines)
    assert wait_for(lambda: engine.items)
    device.write(b"u;x;t\n1;2;3\n")
    assert wait_for(lambda: times(engine.items) == [3.0])
    stop(port, thread)
    assert isinstance(engine.items[0], Unusable)
    assert engine.items[0].reason == "header"
    assert "give them in header" in engine.items[0].problem


def test_blocks_are_found_among_noise(device: Device, tmp_path: Path) -> None:
    engine = FakeEngine()
    port = serial_source(engine, tmp_path, port=device.port, format="block")
    thread = engine.running(port)
    assert wait_for(lambda: port.opened)
    blocks = [Block("x1", 0, 5 * k, 0.0, 0.01, np.ones(5), np.arange(5)) for k in range(20)]
    for k, one in enumerate(blocks):
        data = encode(one)
        device.write(data[7 * (k == 3) :] if k != 8 else data[:30] + data[33:])
    assert wait_for(lambda: engine.blocks and engine.blocks[-1].first == 95)
    stop(port, thread)
    assert [block.first for block in engine.blocks] == [5 * k for k in range(20) if k not in (3, 8)]


def test_a_port_that_goes_away_is_opened_again(tmp_path: Path) -> None:
    engine, name = FakeEngine(), tmp_path / "port"
    port = serial_source(engine, tmp_path, port=str(name), axis="x1", header="t,u,x")
    thread = engine.running(port)
    assert wait_for(lambda: engine.reported)
    for time in (1, 2):
        controller, slave = os.openpty()
        tty.setraw(controller)
        name.unlink(missing_ok=True)
        name.symlink_to(os.ttyname(slave))
        assert wait_for(lambda: port.opened)
        os.write(controller, f"cut\n{time},1,1\n".encode())
        assert wait_for(lambda time=time: time in times(engine.items))
        os.close(slave)
        os.close(controller)
        assert wait_for(lambda: engine.problems()[-1] != "")
    stop(port, thread)
    assert all("cannot be read" in problem for problem in engine.problems()[::2])
    assert times(engine.items) == [1.0, 2.0]


class Plant(FileSection):
    source: SerialSection = Field(description="a source")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({}, "axis is required for format"),
        ({"format": "block", "axis": "x1"}, "axis is required for format"),
        ({"format": "block", "header": "t"}, "header is only for format"),
        ({"axis": "x1", "baud": 1}, "baud"),
    ],
)
def test_a_section_that_cannot_work_is_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        validate_sections(Plant, {"source": {"kind": "serial", "port": "a", **change}})


@pytest.mark.parametrize(("name", "header", "message"), [("x9", None, "no such axis"), ("x1", "t,v", "no column 'u'")])
def test_an_axis_or_header_that_is_not_there_ends_at_once(
    tmp_path: Path, name: str, header: str | None, message: str
) -> None:
    port = serial_source(FakeEngine(), tmp_path, port="nowhere", axis=name, header=header)
    with pytest.raises(UsageError, match=message):
        port.run(lambda delivery: True, None)


def test_lines_longer_than_any_are_left_out() -> None:
    splitter = LineSplitter()
    assert splitter.feed(b"a\nb") == [b"a"]
    assert splitter.feed(b"c" * (TUNING.longest_line + 1)) == []
    assert splitter.feed(b"d" * 10 + b"\ne\n") == [b"e"]
    assert splitter.feed(b"x" * (TUNING.longest_line + 1) + b"\nf\n") == [b"f"]


# --- Telegraf ---------------------------------------------------------------------------------------------------------

SENT = (
    b"drive,axis=x1,host=a u=1.5,x=0.001 1700000000000000000\n"
    b"\n# a remark\n"
    b"cpu,host=a usage=5 1700000000000000000\n"
    b"broken\n"
    b"x1 u=1,x=0.002,temperature=40i 1700000000010000000"
)


@pytest.mark.parametrize("pass_on", [False, True])
def test_telegraf_is_understood_and_lines_are_passed_on(tmp_path: Path, pass_on: bool) -> None:
    engine, (read, telegraf), (back, write) = FakeEngine(), os.pipe(), os.pipe()
    section = ExecdSection(kind="execd", pass_on=pass_on)
    thread = engine.running(ExecdSource("telegraf", section, {"x1": axis(tmp_path)}.get, engine.tell, read, write))
    for k in range(0, len(SENT), 37):
        os.write(telegraf, SENT[k : k + 37])
    os.close(telegraf)
    thread.join(PATIENCE)
    assert not thread.is_alive(), "the end of the pipe is the end"
    os.close(write)
    passed = b""
    while data := os.read(back, 4096):
        passed += data
    os.close(read)
    os.close(back)
    lines = [line for line in SENT.split(b"\n") if line]
    assert passed.splitlines() == (lines if pass_on else [])
    assert times(engine.items) == pytest.approx([1.7e9, 1.7e9 + 0.01], abs=1e-6)
    assert [item.reason for item in engine.items if isinstance(item, Unusable)] == ["axis", "line"]


def test_nobody_may_read_what_is_passed_on_and_the_axes_go_on(tmp_path: Path) -> None:
    engine, (read, telegraf), (back, write) = FakeEngine(), os.pipe(), os.pipe()
    os.close(back)
    section = ExecdSection(kind="execd", pass_on=True)
    source = ExecdSource("telegraf", section, {"x1": axis(tmp_path)}.get, engine.tell, read, write)
    thread = engine.running(source)
    for k in range(2):
        os.write(telegraf, f"x1 u=1,x=1 {k}000000000\n".encode())
        assert wait_for(lambda k=k: len(times(engine.items)) == k + 1)
    stop(source, thread)
    for one in (read, telegraf, write):
        os.close(one)
    assert len(engine.reported) == 1
    assert "cannot be passed on" in engine.problems()[0]

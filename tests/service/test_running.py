"""Small parts of a service: extras, reloads, pauses, sources, the inbox, standard input."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest

from pmfid.config.axis import Axis, load_axis
from pmfid.errors import UsageError
from pmfid.service.context import Context, Source, Take
from pmfid.service.plant import load_plant
from pmfid.service.running import Running
from pmfid.service.sources.mqtt import MqttSource, MqttSourceSection
from pmfid.service.sources.stdin import CsvLines, Piped, StdinSource
from pmfid.stream.delivery import Block, Delivery, Lines, Table, Unusable
from pmfid.stream.engine import Inbox
from pmfid.stream.outcome import Counters
from pmfid.stream.timeline import Line
from tests.patience import PATIENCE
from tests.refusals import refused
from tests.service.engine import wait_for
from tests.service.feed import standard_input
from tests.service.test_serve import PLANT, folder  # noqa: F401 a fixture


class Failing:
    """A source that fails at the first call."""

    name = "hall"

    def __init__(self) -> None:
        self.calls = 0

    def run(self, take: Take) -> None:
        self.calls += 1
        if self.calls == 1:
            raise RuntimeError("broken")
        take(Delivery(self.name, ()))

    def stop(self) -> None:
        """Do nothing: the source ends by itself."""


def test_a_source_that_begins_again_is_said_to_work_once_something_comes() -> None:
    reported = list[dict[str, Any]]()
    running = Running(Failing(), Inbox(), reported.append)
    running.start()
    while not running.ended:
        time.sleep(0.01)
    assert [event["problem"].partition(":")[0] for event in reported] == ["RuntimeError", ""]


AXIS = '[axes.x1]\nconfig = "cart.toml"\n'


def test_the_sections_that_a_reload_leaves_as_they_were_are_named(tmp_path: Path) -> None:
    place = tmp_path / "plant.toml"
    place.write_text(AXIS + '[sources.log]\nkind = "mqtt"\ntopics = ["a"]\n[sinks.db]\nkind = "mqtt"\n')
    before = load_plant(place)
    place.write_text(
        AXIS.replace("x1", "x2")
        + '[page]\nport = 0\n[sources.log]\nkind = "mqtt"\ntopics = ["b"]\n[sinks.db]\nkind = "mqtt"\n'
        + '[sinks.lines]\nkind = "mqtt"\n'
    )
    assert load_plant(place).unlike(before) == ["[page]", "[sources.log]", "[sinks.lines]"]
    assert load_plant(place).unlike(load_plant(place)) == []
    place.write_text(AXIS.replace("x1", "x2") + "[page]\n")
    assert load_plant(place).unlike(load_plant(place)) == []


def test_sections_and_sources_are_imported_without_their_libraries() -> None:
    modules = ("sources.mqtt", "sources.stdin", "sinks.mqtt")
    program = "\n".join(f"import pmfid.service.{module}" for module in modules)
    program += "\nimport sys\nprint(*{name.partition('.')[0] for name in sys.modules})"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert "paho" not in run.stdout.split()
    assert "pmfid" in run.stdout.split()


def test_a_missing_extra_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "paho"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "paho", None)
    source = MqttSource("a", MqttSourceSection(kind="mqtt", topics=("a",)), {}.get, lambda what: None)
    refused((r"needs \S+: pip install 'pmfid\[serve\]'$", lambda: source.run(lambda delivery: True)))


def delivery(k: int, blocks: int) -> Delivery:
    numbers, times = np.full(blocks, k), np.zeros(blocks)
    names = tuple(f"x{row}" for row in range(blocks))
    return Delivery(
        str(k), [Table(names, numbers, numbers, times, times, np.zeros((blocks, 2)), np.zeros((blocks, 2), int))]
    )


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


@pytest.fixture(scope="module")
def axis(plant_place: Path) -> Axis:
    return load_axis(plant_place / "axis.toml")


class Taken:
    """The deliveries of a source that runs in its own thread."""

    def __init__(self, source: Source, most: int = 10**9) -> None:
        self.deliveries: list[Delivery] = []
        self.error: Exception | None = None
        self._source, self._most = source, most
        self._thread = Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            self._source.run(self._take)
        except UsageError as error:
            self.error = error

    def _take(self, delivery: Delivery) -> bool:
        if len(self.deliveries) >= self._most:
            return False
        self.deliveries.append(delivery)
        return True

    @property
    def times(self) -> list[float]:
        return [round(line.time, 6) for line in self.lines]

    @property
    def lines(self) -> list[Line]:
        items = [item for delivery in self.deliveries for item in delivery.items]
        return [line for item in items if isinstance(item, Lines) for line in item.lines]

    @property
    def blocks(self) -> list[Block]:
        return [item for delivery in self.deliveries for item in delivery.items if isinstance(item, Block)]

    def until(self, holds: Callable[[], bool]) -> None:
        end = time.monotonic() + PATIENCE
        while not holds() and time.monotonic() < end:
            time.sleep(0.005)
        assert holds()

    def ended(self, stop: bool = True) -> Taken:
        if stop:
            self._source.stop()
        self._thread.join(PATIENCE)
        assert not self._thread.is_alive()
        return self


HEADER = "t,u,counts\n"


def rows(*numbers: int) -> str:
    return "".join(f"{0.01 * k:.2f},0.5,{k}\n" for k in numbers)


def test_a_pipe_is_read_to_its_end(axis: Axis) -> None:
    out, into = os.pipe()
    with os.fdopen(out, "rb") as stream:
        taken = Taken(Piped("input", CsvLines("x1", axis), stream))
        os.write(into, (HEADER + rows(0, 1)).encode())
        taken.until(lambda: len(taken.lines) == 2)
        os.write(into, rows(2).rstrip().encode())
        os.close(into)
        taken.ended(stop=False)
    assert taken.times == [0.0, 0.01, 0.02]


def test_a_pipe_without_a_header_is_an_error(axis: Axis) -> None:
    out, into = os.pipe()
    with os.fdopen(out, "rb") as stream:
        os.write(into, b"1,2,3\n1,2,3\n")
        taken = Taken(Piped("input", CsvLines("x1", axis), stream)).ended(stop=False)
        os.close(into)
    assert isinstance(taken.error, UsageError)


SENT = (
    b'{"fields":{"u":1.5,"counts":3,"q":"OK"},"name":"a","tags":{"axis":"x1"},"timestamp":1700000000000000000}\n'
    b'{"fields":{"usage":5},"name":"cpu","tags":{"host":"a"},"timestamp":1700000000000000000}\n'
    b"broken\n"
    b'\n{"axis":"x1","t":0.02,"u":1,"counts":4}\n'
    b'{"fields":{"u":1,"counts":5},"name":"x1","tags":{},"timestamp":1700000000010000000}\n'
)


def test_lines_of_telegraf_are_samples(axis: Axis, tmp_path: Path) -> None:
    context = Context("hall", tmp_path, Counters(), lambda what: None, {"x1": axis}.get)
    with standard_input() as send:
        taken = Taken(StdinSource(kind="stdin").make("telegraf", context))
        for k in range(0, len(SENT), 37):
            send(SENT[k : k + 37].decode())
        taken.until(lambda: len(taken.lines) == 3)
        taken.ended()
    assert [line.counts for line in taken.lines] == [3, 4, 5]
    assert taken.times == pytest.approx([1.7e9, 0.02, 1.7e9 + 0.01], abs=1e-6)
    items = [item for delivery in taken.deliveries for item in delivery.items]
    assert [item.reason for item in items if isinstance(item, Unusable)] == ["axis", "json"]

"""Records and standard input as sources."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from threading import Thread

import pytest

from pmfid.config.axis import Axis, load_axis
from pmfid.errors import UsageError
from pmfid.pipeline.monitored.timeline import Line
from pmfid.pipeline.tuning import TUNING
from pmfid.service.context import Context, Source
from pmfid.service.sources.stdin import CsvLines, Piped, StdinSource
from pmfid.service.wire.messages import LineSplitter
from pmfid.stream.delivery import Block, Delivery, Lines, Unusable
from pmfid.stream.outcome import Counters
from tests.patience import PATIENCE
from tests.service.feed import standard_input


@pytest.fixture(scope="module")
def axis(plant_folder: Path) -> Axis:
    return load_axis(plant_folder / "axis.toml")


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


def test_lines_longer_than_any_are_left_out() -> None:
    splitter = LineSplitter()
    assert splitter.feed(b"a\nb") == [b"a"]
    assert splitter.feed(b"c" * (TUNING.longest_line + 1)) == []
    assert splitter.feed(b"d" * 10 + b"\ne\n") == [b"e"]
    assert splitter.feed(b"x" * (TUNING.longest_line + 1) + b"\nf\n") == [b"f"]

"""Files as sources: played records, pipes, and files that grow, are replaced or are cut short."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest

from pmfid.config.axis import Axis, load_axis
from pmfid.errors import UsageError
from pmfid.pipeline.monitored.timeline import Line
from pmfid.service.context import Context, Source
from pmfid.service.sources.file import Follower, Piped, Player
from pmfid.stream.delivery import Block, Delivery, Lines, Mark
from pmfid.stream.outcome import Counters
from tests.patience import PATIENCE


@pytest.fixture(scope="module")
def axis(plant_folder: Path) -> Axis:
    return load_axis(plant_folder / "axis.toml")


class Taken:
    """The deliveries of a source that runs in its own thread."""

    def __init__(self, source: Source, mark: Mark | None = None, most: int = 10**9) -> None:
        self.deliveries: list[Delivery] = []
        self.error: Exception | None = None
        self._source, self._most = source, most
        self._thread = Thread(target=self._run, args=(mark,), daemon=True)
        self._thread.start()

    def _run(self, mark: Mark | None) -> None:
        try:
            self._source.run(self._take, mark)
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


def follower(path: Path, axis: Axis, reported: list[dict[str, Any]]) -> Follower:
    context = Context("hall", path.parent, None, Counters(), reported.append, lambda name: axis)
    return Follower("log", "x1", path, axis, context)


def test_a_growing_file_is_followed_through_rotation_and_cuts(tmp_path: Path, axis: Axis) -> None:
    path, reported = tmp_path / "log.csv", list[dict[str, Any]]()
    taken = Taken(follower(path, axis, reported))
    taken.until(lambda: len(reported) == 1)
    path.write_text("# a logger\n" + HEADER + rows(0, 1) + "0.02,0.5")
    taken.until(lambda: len(taken.lines) == 2)
    with path.open("a") as file:
        file.write(",2\n" + rows(3))
    taken.until(lambda: len(taken.lines) == 4)
    path.rename(tmp_path / "log.1")
    path.write_text(HEADER + rows(4, 5))
    taken.until(lambda: len(taken.lines) == 6)
    path.write_text(HEADER)
    time.sleep(0.3)
    with path.open("a") as file:
        file.write(rows(6))
    taken.until(lambda: len(taken.lines) == 7)
    assert taken.ended().times == [0.0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06]
    assert [line.counts for line in taken.lines] == list(range(7))
    assert [what["problem"] for what in reported[:2]] == ["log.csv: No such file or directory", ""], (
        "its end is reported, too"
    )


def test_a_file_goes_on_after_the_mark_and_another_one_from_its_start(tmp_path: Path, axis: Axis) -> None:
    path = tmp_path / "log.csv"
    path.write_text(HEADER + rows(0, 1, 2) + "0.03,0.5")
    taken = Taken(follower(path, axis, []))
    taken.until(lambda: len(taken.lines) == 3)
    mark = taken.ended().deliveries[-1].mark
    with path.open("a") as file:
        file.write(",3\n" + rows(4))
    again = Taken(follower(path, axis, []), mark)
    again.until(lambda: len(again.lines) == 2)
    assert again.ended().times == [0.03, 0.04]
    path.unlink()
    path.with_suffix(".new").write_text(HEADER + rows(7))
    path.with_suffix(".new").rename(path)
    other = Taken(follower(path, axis, []), {**(mark or {}), "file": -1})
    other.until(lambda: len(other.lines) == 1)
    assert other.ended().times == [0.07]


def test_what_a_source_could_not_hand_over_comes_again(tmp_path: Path, axis: Axis) -> None:
    path = tmp_path / "log.csv"
    path.write_text(HEADER + rows(*range(9000)))
    first = Taken(follower(path, axis, []), most=1).ended(stop=False)
    rest = Taken(follower(path, axis, []), first.deliveries[-1].mark)
    rest.until(lambda: len(first.lines) + len(rest.lines) == 9000)
    assert [line.counts for line in [*first.lines, *rest.ended().lines]] == list(range(9000))


def test_a_file_without_the_columns_is_said_and_the_next_one_taken(tmp_path: Path, axis: Axis) -> None:
    path, reported = tmp_path / "log.csv", list[dict[str, Any]]()
    path.write_text("time;force\n1;2\n")
    taken = Taken(follower(path, axis, reported))
    taken.until(lambda: len(reported) == 1)
    assert "no column" in reported[0]["problem"]
    path.unlink()
    path.write_text(HEADER + rows(1))
    taken.until(lambda: len(taken.lines) == 1)
    taken.ended()


def test_a_pipe_is_read_to_its_end(axis: Axis) -> None:
    out, into = os.pipe()
    with os.fdopen(out, "rb") as stream:
        taken = Taken(Piped("input", "x1", axis, stream))
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
        taken = Taken(Piped("input", "x1", axis, stream)).ended(stop=False)
        os.close(into)
    assert isinstance(taken.error, UsageError)


def test_a_record_is_played_and_goes_on_after_its_mark(plant_folder: Path, axis: Axis) -> None:
    path = plant_folder / "normal.csv"
    whole = Taken(Player("record", "x1", path, axis, 0.0)).ended(stop=False)
    counts = np.concatenate([block.counts for block in whole.blocks])
    assert counts.size == 6000
    assert [block.first for block in whole.blocks] == list(range(0, 6000, 1000))
    first = Taken(Player("record", "x1", path, axis, 0.0), most=2).ended(stop=False)
    rest = Taken(Player("record", "x1", path, axis, 0.0), first.deliveries[-1].mark).ended(stop=False)
    assert [block.first for block in rest.blocks] == [2000, 3000, 4000, 5000]
    assert {block.epoch for block in rest.blocks} == {0}
    changed = {**(first.deliveries[-1].mark or {}), "version": "another file"}
    again_ = Taken(Player("record", "x1", path, axis, 0.0), changed, most=1).ended(stop=False)
    assert (again_.blocks[0].first, again_.blocks[0].epoch) == (0, 1)


def test_a_record_keeps_its_time(plant_folder: Path, axis: Axis) -> None:
    begun = time.monotonic()
    taken = Taken(Player("record", "x1", plant_folder / "normal.csv", axis, 10.0))
    taken.until(lambda: len(taken.blocks) >= 20)
    assert time.monotonic() - begun > 20 * 0.05 / 10 * 0.9
    taken.ended()

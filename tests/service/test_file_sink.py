"""A file of JSON lines stays whole after any failure of the disk, the file or the process."""

from __future__ import annotations

import errno
import json
import os
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from pmfid.service.sinks.file import FileSink, FileSinkSection
from tests.patience import PATIENCE
from tests.service.feed import Host, alarm, block, kindred, notice
from tests.service.test_sqlite_sink import full_at

GROUP = kindred(2)


def opened(path: str, folder: Path) -> FileSink:
    sink = FileSinkSection(path=path).make("lines", Host(folder))
    sink.open()
    return sink


def lines_of(path: Path) -> list[dict[str, Any]]:
    text = path.read_text(encoding="utf-8")
    assert text.endswith("\n")
    return [json.loads(line) for line in text.splitlines()]


def test_a_row_is_a_line(tmp_path: Path) -> None:
    sink = opened("out/rows.jsonl", tmp_path)
    rows = block(GROUP, 5)
    sink.put([replace(rows, std=np.array([[0.5, np.inf], [0.5, 0.25]]), time=np.array([1.7e9 + 0.25, np.nan]))])
    sink.close()
    first, second = lines_of(tmp_path / "out" / "rows.jsonl")
    assert first == {
        "axis": "x0",
        "number": 5,
        "time": 1.7e9 + 0.25,
        "u": 2.5,
        "counts": 35,
        "theta": {"mass": 5.0, "friction": 5.25},
        "std": {"mass": 0.5, "friction": None},
        "innovation": 0.125,
        "status": 2,
        "state": "watching",
    }
    assert (second["axis"], second["time"], second["std"]["friction"]) == ("x1", None, 0.25)


def test_a_notice_is_a_line_with_its_event(tmp_path: Path) -> None:
    sink = opened("rows.jsonl", tmp_path)
    sink.put([alarm(7), notice(8, "sink", axis="", problem='a "b"\nc')])
    sink.close()
    one, other = lines_of(tmp_path / "rows.jsonl")
    assert (one["axis"], one["event"], one["number"], one["parameter"]) == ("x1", "alarm", 7, "mass")
    assert (other["axis"], other["problem"]) == ("", 'a "b"\nc')


def test_events_alone_are_written_where_rows_are_not_wanted(tmp_path: Path) -> None:
    outlet = FileSinkSection(path="events.jsonl", rows=False).outlet("lines", Host(tmp_path))
    outlet.start()
    outlet.rows(block(GROUP, 1))
    outlet.notice(alarm(2))
    assert outlet.close(PATIENCE)
    assert [line["number"] for line in lines_of(tmp_path / "events.jsonl")] == [2]


def test_estimates_alone_are_a_table(tmp_path: Path) -> None:
    outlet = FileSinkSection(path="rows.jsonl", events=False).outlet("lines", Host(tmp_path))
    outlet.start()
    outlet.notice(alarm(1))
    outlet.rows(replace(block(GROUP, 1), std=np.full((2, 2), np.inf)))
    outlet.rows(block(GROUP, 2, samples=200))
    assert outlet.close(PATIENCE)
    table = pl.read_ndjson(tmp_path / "rows.jsonl", infer_schema_length=None).unnest("theta")
    assert table["number"].to_list() == [number for number in range(1, 202) for _ in range(2)]
    assert table["mass"].to_list()[:4] == [1.0, 1.001, 2.0, 2.001]
    assert table["std"].struct.field("mass").null_count() == 2


def test_a_file_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="rows and events are both false"):
        FileSinkSection(path="a.jsonl", rows=False, events=False)


def test_a_full_disk_leaves_whole_lines(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    sink = opened("rows.jsonl", tmp_path)
    sink.put([block(GROUP, 1)])
    size = path.stat().st_size
    with full_at(size + 500), pytest.raises(OSError, match="File too large"):
        sink.put([block(GROUP, 2, samples=20)])
    assert path.stat().st_size == size
    sink.open()
    sink.put([block(GROUP, 2, samples=20)])
    sink.close()
    assert [line["number"] for line in lines_of(path)][::2] == list(range(1, 22))


def test_a_line_that_a_kill_cut_off_spoils_no_other(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    path.write_bytes(b'{"axis":"x0"}\n{"axis":"x')
    sink = opened("rows.jsonl", tmp_path)
    sink.put([block(GROUP, 1)])
    sink.close()
    assert path.read_bytes().startswith(b'{"axis":"x0"}\n{"axis":"x\n{"axis":"x0","number":1,')


def test_a_file_that_is_renamed_or_removed_is_made_again(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    sink = opened("rows.jsonl", tmp_path)
    sink.put([block(GROUP, 1)])
    path.rename(tmp_path / "rows.jsonl.1")
    sink.put([block(GROUP, 2)])
    path.unlink()
    sink.put([block(GROUP, 3)])
    sink.close()
    assert [lines_of(tmp_path / name)[0]["number"] for name in ("rows.jsonl.1", "rows.jsonl")] == [1, 3]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_a_device_that_is_full_is_an_error_that_may_pass(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="No space left on device") as error:
        opened("/dev/full", tmp_path).put([alarm(1)])
    assert error.value.errno == errno.ENOSPC


def test_a_pipe_that_nobody_reads_holds_up_only_its_sink(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    got: list[bytes] = []

    def read() -> None:
        with open(tmp_path / "pipe", "rb") as file:
            got.append(file.readline())

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    outlet = FileSinkSection(path="pipe", queue_rows=100).outlet("lines", Host(tmp_path))
    outlet.start()
    for number in range(1, 500):
        outlet.rows(block(GROUP, number))
    reader.join(PATIENCE)
    outlet.close(PATIENCE)
    assert json.loads(got[0])["axis"] == "x0"

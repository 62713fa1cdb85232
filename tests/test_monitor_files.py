"""Output of the commands survives: restarts with the same name, kill -9, full disks, hang-ups, existing files."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from click.testing import CliRunner

from pmfid.cli.main import main
from pmfid.io.row_file import RowFile
from pmfid.pipeline.monitored.rows import rows_path
from pmfid.simulation import CART_DT
from studies.monitoring.pipe import lines, write_axis
from tests.patience import PATIENCE

#: The command in a process of its own.
START = "from pmfid.cli.main import main; main()"
N = 400


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("files")
    write_axis(place, 60.0)
    return place


def watch(folder: Path, *arguments: str) -> Any:
    """Run `pmfid monitor -` on N samples in this process."""
    command = ["monitor", "-", "--config", str(folder / "axis.toml"), "--json", *arguments]
    return CliRunner().invoke(main, command, input=b"".join(lines(N * CART_DT)))


def start(
    folder: Path, *arguments: str, before: Callable[[], None] | None = None, samples: int = N, **pipes: Any
) -> Any:
    """Start `pmfid monitor -` and write `samples` samples to it; its input stays open."""
    command = [sys.executable, "-c", START, "monitor", "-", "--config", str(folder / "axis.toml"), "--json", *arguments]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **pipes}
    process = subprocess.Popen(command, stdin=subprocess.PIPE, preexec_fn=before, **pipes)
    assert process.stdin is not None
    if samples:
        process.stdin.write(b"".join(lines(samples * CART_DT)))
        process.stdin.flush()
    return process


def wait_for_rows(path: Path, rows: int, process: Any) -> None:
    while not path.exists() or path.read_bytes().count(b"\n") < rows + 1:
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.05)


def end(process: Any) -> tuple[str, str]:
    out, error = process.communicate(timeout=PATIENCE)
    return (out or b"").decode(), (error or b"").decode()


@pytest.mark.parametrize("kind", [pytest.param("csv", marks=pytest.mark.long), "parquet"])
def test_kill_and_restart_lose_no_row(folder: Path, kind: str) -> None:
    out = folder / f"killed.{kind}"
    rows = out if kind == "csv" else rows_path(out)
    process = start(folder, "--out", str(out))
    wait_for_rows(rows, N, process)
    process.send_signal(signal.SIGKILL)
    end(process)
    assert pl.read_csv(rows).height == N
    before = rows.read_bytes()
    again = start(folder, "--out", str(out))
    text, _ = end(again)
    assert again.returncode == 0
    assert rows.read_bytes() == before
    second = Path(json.loads(text.splitlines()[0])["out"])
    assert second == folder / f"killed-2.{kind}"
    assert (pl.read_csv if kind == "csv" else pl.read_parquet)(second).height == N


def test_a_restart_writes_to_a_new_file(folder: Path) -> None:
    out = folder / "again.parquet"
    for name in ("again.parquet", "again-2.parquet"):
        assert watch(folder, "--out", str(out)).exit_code == 0
        assert pl.read_parquet(folder / name).height == N
    assert not rows_path(out).exists()


def limited() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))


@pytest.mark.parametrize("kind", ["csv", pytest.param("parquet", marks=pytest.mark.long)])
def test_a_full_disk_does_not_end_the_watch(folder: Path, kind: str) -> None:
    out = folder / f"small.{kind}"
    process = start(folder, "--out", str(out), before=limited)
    text, error = end(process)
    events = [json.loads(line) for line in text.splitlines()]
    (problem,) = [event for event in events if event["event"] == "write error" and "File too large" in event["problem"]]
    assert str(out) in problem["file"]
    (last,) = [event for event in events if event["event"] == "end"]
    assert last["samples"] == N
    table = pl.read_csv(out) if kind == "csv" else pl.read_parquet(out)
    assert 50 < table.height == N - last["rows_lost"]
    assert process.returncode == 2
    assert f"{last['rows_lost']} rows are missing in" in error


# --- the file itself --------------------------------------------------------------------------------------------------


class Disk:
    """A stand-in for os.write with `room` bytes left."""

    def __init__(self, room: int) -> None:
        self.room = room

    def write(self, file: int, data: bytes) -> int:
        if self.room == 0:
            raise OSError(28, "No space left on device")
        part = bytes(data[: self.room])
        self.room -= len(part)
        return REAL_WRITE(file, part)


REAL_WRITE = os.write


def test_a_file_goes_on_where_it_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk, reported = Disk(12), []
    monkeypatch.setattr(os, "write", disk.write)
    file = RowFile(tmp_path / "a.csv", reported.append)
    for k in range(6):
        file.put(f"row {k}")
    assert (tmp_path / "a.csv").read_text() == "row 0\nrow 1\n"
    disk.room = 1000
    file.put("row 6")
    file.close()
    assert (tmp_path / "a.csv").read_text() == "".join(f"row {k}\n" for k in range(7))
    assert [event["event"] for event in reported] == ["write error", "written again"]
    assert file.lost == 0

"""Output of the commands survives: restarts with the same name, kill -9, full disks, hang-ups, existing files."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from click.testing import CliRunner

from pmfid.cli.main import main
from pmfid.io import row_file
from pmfid.io.row_file import RowFile, fresh
from pmfid.pipeline.monitored.rows import rows_path
from pmfid.pipeline.monitored.stream import Stop
from pmfid.report.html import replace_file
from pmfid.simulation import CART_DT
from studies.monitoring.pipe import lines, write_axis
from tests.command import run_command
from tests.patience import PATIENCE

#: A calibration of half an hour is enough here.
START = "import pmfid.pipeline.monitored.setup as m; m.HOURS = 0.5; from pmfid.cli.main import main; main()"
N = 400


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    place = tmp_path_factory.mktemp("files")
    write_axis(place, 60.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PMFID_CACHE", str(place / "cache"))
        patch.setattr("pmfid.pipeline.monitored.setup.HOURS", 0.5)
        yield place


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


def test_no_input_is_written_over(folder: Path) -> None:
    normal = (folder / "normal.csv").read_bytes()
    assert watch(folder, "--out", str(folder / "normal.csv")).exit_code == 0
    assert (folder / "normal.csv").read_bytes() == normal
    assert pl.read_csv(folder / "normal-2.csv").height == N
    for name in ("normal.csv", "axis.toml"):
        refused = watch(folder, "--report", str(folder / name))
        assert f"would overwrite {folder / name}; choose another name" in refused.stderr
        assert refused.exit_code == 2
    assert (folder / "normal.csv").read_bytes() == normal


def test_the_page_of_a_pipe_replaces_none(folder: Path) -> None:
    page = folder / "page.html"
    page.write_text("yesterday")
    assert watch(folder, "--report", str(page)).exit_code == 0
    assert page.read_text() == "yesterday"
    assert "<svg" in (folder / "page-2.html").read_text()


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


def test_a_device_without_room(folder: Path) -> None:
    (folder / "device.csv").symlink_to("/dev/full")
    process = start(folder, "--out", str(folder / "device.csv"))
    text, error = end(process)
    assert json.loads(text.splitlines()[-1])["rows_lost"] == N + 1  # one of them is the header
    assert "No space left on device" in text
    assert process.returncode == 2
    assert "rows are missing in" in error


def test_events_that_find_no_room_do_not_end_the_watch(folder: Path) -> None:
    with Path("/dev/full").open("wb") as full:
        process = start(folder, "--out", str(folder / "silent.csv"), stdout=full)
        _, error = end(process)
    assert "events cannot be written: No space left on device; monitoring continues" in error
    assert pl.read_csv(folder / "silent.csv").height == N


def test_a_hang_up_ends_in_order(folder: Path) -> None:
    out = folder / "hangup.parquet"
    process = start(folder, "--out", str(out))
    wait_for_rows(rows_path(out), N, process)
    process.send_signal(signal.SIGHUP)
    text, _ = end(process)
    assert process.returncode == 0
    assert json.loads(text.splitlines()[-1])["samples"] == N
    assert pl.read_parquet(out).height == N


def test_a_hang_up_that_is_ignored_stays_so() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with Stop().handling() as stop:
            os.kill(os.getpid(), signal.SIGHUP)
        assert not stop.requested
    finally:
        signal.signal(signal.SIGHUP, before)


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


def test_what_never_finds_room_is_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "write", Disk(15).write)
    monkeypatch.setattr(row_file, "MOST_WAITING", 30)
    file = RowFile(tmp_path / "a.csv", lambda event: None)
    for k in range(9):
        file.put(f"row {k}")
    file.close()
    assert (tmp_path / "a.csv").read_text() == "row 0\nrow 1\n"
    assert file.lost == 7


def test_numbers_of_files(tmp_path: Path) -> None:
    assert fresh(tmp_path / "a.csv").name == "a.csv"
    (tmp_path / "a.csv").symlink_to(tmp_path / "nowhere")  # a link without a target also exists
    (tmp_path / "a-2.csv").write_text("")
    assert fresh(tmp_path / "a.csv").name == "a-3.csv"
    with pytest.raises(FileExistsError):
        RowFile(tmp_path / "a.csv", lambda event: None)


def test_a_link_is_replaced_and_not_followed(tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("keep")
    (tmp_path / "report.html").symlink_to(tmp_path / "precious")
    replace_file(tmp_path / "report.html", b"new")
    assert (tmp_path / "precious").read_text() == "keep"
    assert (tmp_path / "report.html").read_text() == "new"
    assert sorted(os.listdir(tmp_path)) == ["precious", "report.html"]


def test_identify_leaves_the_track_of_another_run(folder: Path) -> None:
    out = folder / "result"
    out.mkdir()
    (out / "track.parquet").write_bytes(b"mine")
    (out / "result.json").symlink_to(folder / "elsewhere")
    (folder / "elsewhere").write_text("mine")
    arguments = ["identify", str(folder / "normal.csv"), "--config", str(folder / "axis.toml"), "--out", str(out)]
    run_command(*arguments, "--method", "ls")
    assert not (out / "track.parquet").exists()
    run_command(*arguments, "--method", "rls")
    assert (out / "track-2.parquet").read_bytes() == b"mine"
    assert pl.read_parquet(out / "track.parquet").height > N
    assert (folder / "elsewhere").read_text() == "mine"
    assert json.loads((out / "result.json").read_text())

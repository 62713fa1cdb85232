"""A closed standard stream, as by `<&-`, is empty for reads and accepts all writes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import polars as pl
import pytest

from tests.conftest import PROGRESS
from tests.test_monitor_files import N, end, folder, start

__all__ = ["folder"]


def command(arguments: list[str], *closed: int) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-c", "from pmfid.cli.main import main; main()", *arguments]

    def close() -> None:
        for number in closed:
            os.close(number)

    return subprocess.run(words, capture_output=True, text=True, preexec_fn=close)


@pytest.mark.parametrize("closed", [(0, 1, 2), *(pytest.param((one,), marks=pytest.mark.long) for one in range(3))])
def test_a_command_goes_its_way_without_its_streams(tmp_path: Path, closed: tuple[int, ...]) -> None:
    run = command(["simulate", "prbs", "--out", str(tmp_path / "run.csv"), "--duration", "1"], *closed)
    assert run.returncode == 0
    assert PROGRESS.sub("", run.stderr) == ""
    assert pl.read_csv(tmp_path / "run.csv").columns == ["t", "u", "counts"]
    wrong = command(["identify", "nowhere.csv", "--config", str(tmp_path / "run.toml")], *closed)
    assert wrong.returncode == 2
    assert "Traceback" not in wrong.stderr


def test_a_pipe_that_is_closed_is_empty(folder: Path) -> None:
    process = start(folder, before=lambda: os.close(0), samples=0)
    _, error = end(process)
    assert error == "pmfid: standard input is empty: write the header with the names of the columns first\n"
    assert process.returncode == 2


def test_events_that_nobody_takes_end_nothing(folder: Path) -> None:
    """The events also do not go into an opened file."""
    process = start(folder, "--out", str(folder / "unheard.csv"), before=lambda: os.close(1))
    _, error = end(process)
    assert (process.returncode, PROGRESS.sub("", error)) == (0, "")
    assert pl.read_csv(folder / "unheard.csv").height == N

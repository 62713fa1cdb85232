"""`pmfid monitor`: records, pipes with bad lines and gaps, files, signals, events, the page."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner

from pmfid.cli.main import main
from pmfid.simulation import CART, CART_DT, Schedule
from studies.monitoring.axis import INCREMENTS, changing
from studies.monitoring.pipe import lines, resident, write_axis
from tests.patience import PATIENCE
from tests.processes import run_process

CHANGE = 15.0
#: The command in a process of its own.
START = "from pmfid.cli.main import main; main()"
SKIPPED = ("bad_lines", "repeated_lines", "comments", "gaps", "missing", "clock_jumps")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write axis.toml, its reference, and run.csv, in which the mass grows by a fifth."""
    place = tmp_path_factory.mktemp("monitor")
    write_axis(place, 300.0)
    heavier = Schedule(((0.0, CART), (CHANGE, replace(CART, mass=1.2 * CART.mass))))
    u, counts = changing(heavier, 5, INCREMENTS, 40.0)
    rows = (f"{k * CART_DT:.2f},{a!r},{b}" for k, (a, b) in enumerate(zip(u.tolist(), counts.tolist(), strict=True)))
    (place / "run.csv").write_text("\n".join(["t,u,counts", *rows]) + "\n")
    return place


def invoke(folder: Path, *arguments: str, stdin: bytes | None = None, code: int = 0) -> str:
    record = "-" if stdin is not None else str(folder / "run.csv")
    result = CliRunner().invoke(
        main, ["monitor", record, "--config", str(folder / "axis.toml"), *arguments], input=stdin
    )
    assert result.exit_code == code, result.output
    return result.stdout if code == 0 else result.output


@pytest.fixture(scope="module")
def read(folder: Path) -> str:
    """Return the output of the command for run.csv; it also writes page.html and out.parquet."""
    return invoke(folder, "--json", "--report", str(folder / "page.html"), "--out", str(folder / "out.parquet"))


def command(axis: Path, *arguments: str) -> list[str]:
    """Return the words that start `pmfid monitor -` in its own process."""
    return [sys.executable, "-c", START, "monitor", "-", "--config", str(axis), *arguments]


def events(text: str, kind: str) -> list[dict[str, Any]]:
    found = [json.loads(line) for line in text.splitlines()]
    return [event for event in found if event["event"] == kind]


# --- a record ---------------------------------------------------------------------------------------------------------


def test_a_record_with_a_heavier_load(folder: Path, read: str) -> None:
    (start,), (alarm,) = events(read, "start"), events(read, "alarm")
    assert start["nominal"]["mass"] == pytest.approx(CART.mass, rel=2e-3)
    assert (alarm["parameter"], alarm["direction"], alarm["unit"]) == ("mass", "up", "kg")
    assert alarm["relative"] == pytest.approx(0.2, abs=0.03)
    assert CHANGE < alarm["time"] < CHANGE + 3
    (settled,) = events(read, "settled")
    assert settled["parameters"]["mass"]["change"] == pytest.approx(0.2, abs=0.01)
    nothing = dict.fromkeys(SKIPPED, 0) | {"outliers": 0, "rows_lost": 0, "problem": ""}
    assert events(read, "end") == [{"event": "end", "samples": 4000, "alarms": 1, **nothing}]
    table = pl.read_parquet(folder / "out.parquet")
    assert table.height == 4000
    assert table["mass"][-1] == pytest.approx(1.2 * CART.mass, rel=0.01)
    assert {"watching", "suspicious", "settling"} <= set(table["state"])
    page = (folder / "page.html").read_text()
    assert "mass +" in page
    assert "mathdefault" not in page  # formulas are not typeset, because units may contain a $
    assert "<svg" in page
    assert not re.search(r"(src|href)=\"http", page)


# --- a pipe -----------------------------------------------------------------------------------------------------------


def test_a_pipe_gives_what_the_record_gives(folder: Path, read: str) -> None:
    piped = invoke(folder, "--json", stdin=(folder / "run.csv").read_bytes())
    assert events(piped, "alarm") == [
        {key: pytest.approx(value) if isinstance(value, float) else value for key, value in alarm.items()}
        for alarm in events(read, "alarm")
    ]


@pytest.mark.parametrize(
    ("stdin", "message"),
    [
        (b"", "standard input is empty"),
        (b"t,v,counts\n0,1,2\n", "standard input has no column 'u'; it has t, v, counts"),
    ],
)
def test_a_pipe_without_its_columns(folder: Path, stdin: bytes, message: str) -> None:
    assert message in invoke(folder, stdin=stdin, code=2)


@pytest.mark.parametrize(
    ("kind", "number"),
    [
        pytest.param("csv", signal.SIGINT, marks=pytest.mark.long),
        ("parquet", signal.SIGTERM),
        pytest.param("parquet", signal.SIGHUP, marks=pytest.mark.long),
    ],
)
def test_a_signal_ends_with_a_whole_file(folder: Path, kind: str, number: signal.Signals) -> None:
    out, n = folder / f"killed-{number}.{kind}", 1500
    words = command(folder / "axis.toml", "--out", str(out), "--json")
    with run_process(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        process.stdin.write(b"".join(lines(n * CART_DT)))
        process.stdin.flush()
        assert any(b"watching" in line for line in iter(process.stdout.readline, b""))
        time.sleep(0.2)
        assert resident(process.pid) > 10
        process.send_signal(number)
        rest, _ = process.communicate(timeout=PATIENCE)
    end = json.loads(rest.splitlines()[-1])
    assert process.returncode == 0
    table = pl.read_csv(out) if kind == "csv" else pl.read_parquet(out)
    assert table.height == end["samples"]
    assert 100 < table.height <= n
    assert table["t"].to_numpy() == pytest.approx(np.arange(table.height) * CART_DT)
    assert not list(folder.glob("*.parquet.csv"))

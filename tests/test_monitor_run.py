"""`pmfid monitor`: records, pipes with bad lines and gaps, files, signals, events, the page."""

from __future__ import annotations

import io
import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner

from pmfid.cli.main import main
from pmfid.config.axis import load_axis
from pmfid.errors import UsageError
from pmfid.pipeline.monitored.rows import CsvSink, ParquetSink
from pmfid.pipeline.monitored.run import RunHistory
from pmfid.pipeline.monitored.setup import cache_dir
from pmfid.pipeline.monitored.stream import Stop, line_samples
from pmfid.pipeline.monitored.timeline import Sample, Skipped
from pmfid.pipeline.tuning import TUNING
from pmfid.simulation import CART, CART_DT, Schedule
from studies.monitoring.axis import INCREMENTS, changing
from studies.monitoring.pipe import lines, resident, write_axis
from tests.command import run_command
from tests.patience import PATIENCE
from tests.processes import run_process

CHANGE = 15.0
#: Hours of a calibration that is enough here, also for the command in its own process.
HOURS = 4.0
START = f"import pmfid.pipeline.monitored.setup as m; m.HOURS = {HOURS}; from pmfid.cli.main import main; main()"
SKIPPED = ("bad_lines", "repeated_lines", "comments", "gaps", "missing", "clock_jumps")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Write axis.toml, its reference, and run.csv, in which the mass grows by a fifth; all tests share one
    calibration.
    """
    place = tmp_path_factory.mktemp("monitor")
    write_axis(place, 300.0)
    heavier = Schedule(((0.0, CART), (CHANGE, replace(CART, mass=1.2 * CART.mass))))
    u, counts = changing(heavier, 5, INCREMENTS, 40.0)
    rows = (f"{k * CART_DT:.2f},{a!r},{b}" for k, (a, b) in enumerate(zip(u.tolist(), counts.tolist(), strict=True)))
    (place / "run.csv").write_text("\n".join(["t,u,counts", *rows]) + "\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PMFID_CACHE", str(place / "cache"))
        patch.setattr("pmfid.pipeline.monitored.setup.HOURS", HOURS)
        yield place


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


#: The shortest pipe that shows the first output of the command.
TWO_LINES = b"t,u,counts\n0,1,2\n0.01,1,2\n"


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


def test_the_lines_for_people(folder: Path) -> None:
    text = invoke(folder)
    assert re.search(
        r"^\d+\.\d\d s  ALARM  mass \+(19|20)\.\d % \(\+0\.\d+ ± 0\.\d+ kg\) since \d+\.\d\d s; \d.* the tolerance of",
        text,
        re.M,
    )
    assert re.search(r"^normal: mass 1\.0\d* kg, viscous_friction 12", text)
    assert "a false alarm in 1 h on average" in text
    assert text.endswith("4000 samples, 1 alarm\n")


def test_options_go_before_the_file(folder: Path) -> None:
    text = invoke(folder, "--json", "--mtbf-hours", "5", "--tolerance", "0.5")
    (start,) = events(text, "start")
    assert (start["mtbf_hours"], start["tolerance"]) == (5.0, 0.5)
    assert events(text, "alarm") == []


@pytest.mark.usefixtures("read")
def test_the_calibration_is_made_once(folder: Path) -> None:
    (start,) = events(invoke(folder, "--json", "--tolerance", "0.5", stdin=TWO_LINES), "start")
    assert start["cached"] is True
    path = Path(start["calibration"])
    assert path.parent == folder / "cache"
    path.write_text(path.read_text()[:100])  # a broken file is made again
    (start,) = events(invoke(folder, "--json", stdin=TWO_LINES), "start")
    assert start["cached"] is False


def test_the_cache_has_a_place(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("PMFID_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_dir() == tmp_path / "pmfid"
    monkeypatch.setenv("PMFID_CACHE", str(tmp_path / "own"))
    assert cache_dir() == tmp_path / "own"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('reference = "normal.csv"', ""), r"\[monitor\] reference is missing: name a record of normal work"),
        (('reference = "normal.csv"', 'reference = "absent.csv"'), r"absent.csv: cannot read the record"),
        (('reference = "normal.csv"', "nominal = { mass = 1.0 }"), r"\[monitor\] nominal must name \['mass', "),
        (("mtbf_hours = 1.0", "mtbf_hours = 0"), r"\[monitor\] mtbf_hours = 0: .* give the mean time between"),
        (("mtbf_hours = 1.0", 'detector = "glr"'), r"\[monitor\] detector"),
        (("forgetting = 0.99", 'method = "iv"'), r"method = 'iv' does not run sample by sample"),
    ],
)
def test_a_wrong_configuration_is_one_line(folder: Path, tmp_path: Path, change: tuple[str, str], message: str) -> None:
    (tmp_path / "normal.csv").write_text((folder / "normal.csv").read_text())
    (tmp_path / "run.csv").write_text((folder / "run.csv").read_text())
    (tmp_path / "axis.toml").write_text((folder / "axis.toml").read_text().replace(*change))
    text = invoke(tmp_path, code=2)
    assert re.search(message, text)
    assert "Traceback" not in text
    assert len(text.splitlines()) == 1


def test_a_transfer_function_is_refused_before_its_record_is_read(tmp_path: Path) -> None:
    config = Path(__file__).parents[1] / "examples" / "second_order.toml"
    (tmp_path / "run.csv").write_text("t,u,y\n" + "".join(f"{0.05 * k},1,{1 - 0.5**k}\n" for k in range(50)))
    result = run_command("monitor", str(tmp_path / "run.csv"), "--config", str(config), code=2)
    assert result.stderr.startswith("pmfid: the monitor is for a machine with friction")


def test_without_a_reference_the_nominal_values_do(folder: Path, tmp_path: Path) -> None:
    nominal = "nominal = { mass = 1.07, viscous_friction = 12.8, coulomb_friction = 0.8 }"
    (tmp_path / "run.csv").write_text((folder / "run.csv").read_text())
    (tmp_path / "axis.toml").write_text((folder / "axis.toml").read_text().replace('reference = "normal.csv"', nominal))
    text = invoke(tmp_path)
    assert "note: no reference record: thresholds hold for the encoder's noise alone" in text
    assert "ALARM  mass" in text
    assert "reference is missing" in invoke(tmp_path, stdin=b"t,u,counts\n0,0,0\n", code=2)


# --- a pipe -----------------------------------------------------------------------------------------------------------


def test_a_pipe_gives_what_the_record_gives(folder: Path, read: str) -> None:
    piped = invoke(folder, "--json", stdin=(folder / "run.csv").read_bytes())
    assert events(piped, "alarm") == [
        {key: pytest.approx(value) if isinstance(value, float) else value for key, value in alarm.items()}
        for alarm in events(read, "alarm")
    ]


def test_bad_lines_are_counted_and_harmless(folder: Path) -> None:
    rows = (folder / "run.csv").read_bytes().splitlines(keepends=True)
    for k, bad in ((300, b"garbage\n"), (500, b"4.99,nan,1\n"), (700, b"6.99,1.0,\xff\xfe\n"), (900, b"8.99,1,0.5\n")):
        rows[k] = bad
    rows.insert(1100, b"\n")
    text = invoke(folder, "--json", "--out", str(folder / "bad.csv"), stdin=b"".join(rows))
    problems = [event["problem"] for event in events(text, "bad line")]
    assert problems[0] == "1 cells in place of 3"
    assert len(problems) == 4
    (end,) = events(text, "end")
    assert (end["samples"], end["bad_lines"], end["alarms"], end["missing"]) == (4000, 4, 1, 0)
    (alarm,) = events(text, "alarm")
    assert alarm["time"] > CHANGE
    table = pl.read_csv(folder / "bad.csv")
    assert table.height == 4000
    assert np.isfinite(table[["t", "mass", "innovation"]].to_numpy()).all()
    assert np.isfinite(table["mass_std"][200:].to_numpy()).all()


def test_lines_that_are_missing_are_reported(folder: Path) -> None:
    rows = (folder / "run.csv").read_bytes().splitlines(keepends=True)
    del rows[400:460], rows[800]
    text = invoke(folder, "--json", stdin=b"".join(rows))
    assert [event["missing"] for event in events(text, "gap")] == [60, 1]
    (alarm,) = events(text, "alarm")
    assert CHANGE < alarm["time"] < CHANGE + 4
    assert events(text, "end")[0]["missing"] == 61


@pytest.mark.parametrize(
    ("stdin", "message"),
    [
        (b"", "standard input is empty"),
        (b"t,v,counts\n0,1,2\n", "standard input has no column 'u'; it has t, v, counts"),
    ],
)
def test_a_pipe_without_its_columns(folder: Path, stdin: bytes, message: str) -> None:
    assert message in invoke(folder, stdin=stdin, code=2)


def test_a_pipe_of_two_samples_says_so(folder: Path) -> None:
    assert invoke(folder, stdin=TWO_LINES).endswith("2 samples, 0 alarms\n")


def samples_of(text: bytes, axis: Any) -> list[Any]:
    return list(line_samples(io.BytesIO(text), axis, 0.01, Stop()))


def test_lines_become_samples(folder: Path) -> None:
    axis = load_axis(folder / "axis.toml")
    head = b'\xef\xbb\xbf"t", u ,counts\n'
    good = samples_of(head + b"5.0,1.5,7\n5.01,2,8\n", axis)
    assert [(s.time, s.u, s.counts, s.missing) for s in good] == [(5.0, 1.5, 7, 0), (5.01, 2.0, 8, 0)]
    late = samples_of(head + b"5.0,1,7\n5.05,1,8\n5.05,1,8\n5.06,1,9\n5.07,1,1e99\n", axis)
    assert [(s.time, s.missing, s.counts) for s in late if isinstance(s, Sample)] == [
        (5.0, 0, 7),
        (5.05, 4, 8),
        (5.06, 0, 9),
        (5.07, 0, 9),
    ]
    assert math.isnan(late[-1].u)
    assert [(s.kind, s.problem) for s in late if isinstance(s, Skipped)] == [
        ("bad line", "its time 5.05 s is later than the expected 5.01 s"),
        ("bad line", "counts must be whole numbers below 2**53, got 1e+99"),
    ]


def test_positions_and_scales_in_a_pipe(folder: Path) -> None:
    axis = load_axis(folder / "axis.toml", {"record.output_kind": "position", "record.input_scale": 2.0})
    step = axis.encoder.resolution
    (sample,) = samples_of(f"t,u,counts\n0,1.5,{7 * step!r}\n".encode(), axis)
    assert (sample.u, sample.counts) == (3.0, 7)
    with pytest.raises(UsageError, match="a pipe needs a number"):
        samples_of(b"t,u,counts\n", load_axis(folder / "axis.toml", {"record.input_scale": "gain"}))


def test_estimates_come_out_one_by_one(folder: Path) -> None:
    """The test uses a real pipe: each line is answered before the next one is sent. A study measures the delay."""
    words = command(folder / "axis.toml", "--out", "-")
    with run_process(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        for k, line in enumerate(lines(2.0)):
            process.stdin.write(line)
            process.stdin.flush()
            answer = process.stdout.readline().split(b",")
            assert len(answer) == 10
            assert k == 0 or float(answer[0]) == pytest.approx((k - 1) * CART_DT)
        process.communicate(timeout=PATIENCE)
    assert process.returncode == 0


@pytest.mark.parametrize(
    ("kind", "number"),
    [
        ("csv", signal.SIGINT),
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
        time.sleep(1.0)
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


# --- parts ------------------------------------------------------------------------------------------------------------


def test_parquet_is_made_of_rows_at_the_end(tmp_path: Path) -> None:
    sink = ParquetSink(tmp_path / "a.parquet", ["t", "status", "state"], print)
    for k in range(24):
        sink.write((k / 3, k, "watching"))
    assert pl.read_csv(tmp_path / "a.parquet.csv")["t"].to_list() == [k / 3 for k in range(24)]
    sink.close()
    table = pl.read_parquet(tmp_path / "a.parquet")
    assert table["t"].to_list() == [k / 3 for k in range(24)]
    assert table.schema == {"t": pl.Float64, "status": pl.UInt32, "state": pl.String}
    assert os.listdir(tmp_path) == ["a.parquet"]
    empty = ParquetSink(tmp_path / "b.parquet", ["t", "state"], print)
    empty.close()
    assert pl.read_parquet(tmp_path / "b.parquet").height == 0


def test_csv_is_there_after_every_row(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    sink = CsvSink(path, ["t", "state"], print)
    sink.write((0.1, "watching"))
    assert path.read_text() == "t,state\n0.1,watching\n"
    sink.close()


def test_estimates_in_another_kind_of_file_are_refused(folder: Path) -> None:
    assert "a .csv or .parquet file" in invoke(folder, "--out", str(folder / "x.xlsx"), code=2)


@pytest.mark.parametrize("option", ["--out", "--report"])
def test_a_place_that_is_not_there_is_reported_before_the_run(folder: Path, option: str) -> None:
    text = invoke(folder, option, str(folder / "nowhere" / "x.csv"), code=2)
    assert "does not exist" in text
    assert "normal:" not in text


class Known:
    theta = std = theta_std = np.ones(3)
    innovation, status = 0.1, 0


def test_the_history_stays_small() -> None:
    history = RunHistory()
    for k in range(5 * TUNING.most_rows):
        estimate = Known()
        if k == 12_345:
            estimate.innovation, estimate.status = -7.0, 64
        history(Sample(k * 0.01, 0.0, k), estimate, "watching")
    assert TUNING.most_rows / 2 <= len(history.rows) <= TUNING.most_rows
    times = [row[0] for row in history.rows]
    assert np.allclose(np.diff(times), 0.01 * history.stride)
    assert times[-1] > 0.99 * 5 * TUNING.most_rows * 0.01

"""The command in a pipe: delay from input line to estimate, lost samples, memory, end by a signal."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO

import numpy as np

from pmfid.simulation.drive import Schedule
from pmfid.simulation.scenarios import CART, CART_DT, resolution_of
from studies.monitoring.axis import CUTOFF, FORGETTING, INCREMENTS, changing, normal_work

AXIS = """[record]
input = "u"
output = "counts"
output_kind = "counts"
time = "t"

[encoder]
resolution = {resolution!r}

[model]
input_gain = {gain!r}

[estimator]
cutoff = {cutoff!r}
forgetting = {forgetting!r}

[monitor]
reference = "normal.csv"
mtbf_hours = 1.0
"""


@dataclass(frozen=True)
class PipeFigures:
    """The figures of the pipe.

    The delays are from input line to estimate [s]. Further fields count sent lines and received estimates, and give the
    resident memory [MiB] after a tenth of the long run and at its end. The samples of the long run, its rate [1/s], and
    the lines of a short run follow.
    """

    median: float
    worst: float
    sent: int
    received: int
    early_memory: float
    late_memory: float
    long_samples: int
    rate: float
    example: list[str]


def write_axis(folder: Path, seconds: float = 600.0) -> Path:
    """Write AXIS.toml and normal.csv into a folder; return the path of the first."""
    u, counts = normal_work(1, INCREMENTS, seconds / 3600)
    rows = (f"{k * CART_DT:.2f},{a!r},{b}" for k, (a, b) in enumerate(zip(u.tolist(), counts.tolist(), strict=True)))
    (folder / "normal.csv").write_text("\n".join(["t,u,counts", *rows]) + "\n")
    axis = folder / "axis.toml"
    values = {"resolution": resolution_of(INCREMENTS), "gain": CART.input_gain}
    axis.write_text(AXIS.format(cutoff=CUTOFF, forgetting=FORGETTING, **values))
    return axis


def command(axis: Path, *arguments: str) -> list[str]:
    """Return the words that start `pmfid monitor -` in this interpreter."""
    start = "from pmfid.cli.main import main; main()"
    return [sys.executable, "-c", start, "monitor", "-", "--config", str(axis), *arguments]


def lines(seconds: float, seed: int = 2) -> list[bytes]:
    """Return a header and the samples of normal work."""
    u, counts = normal_work(seed, INCREMENTS, seconds / 3600)
    rows = enumerate(zip(u.tolist(), counts.tolist(), strict=True))
    return [b"t,u,counts\n", *(f"{k * CART_DT:.2f},{a!r},{b}\n".encode() for k, (a, b) in rows)]


def delays(axis: Path, seconds: float, rate: float = 1000.0) -> tuple[np.ndarray, int, int]:
    """Return the delay of every sample [s], the sent lines and the received estimates; one line is sent every
    1/rate s.
    """
    sent_at: list[float] = []
    back_at: list[float] = []
    process = subprocess.Popen(
        command(axis, "--out", "-"), stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    if process.stdin is None or process.stdout is None:
        raise OSError("the process has no pipes")

    reader = threading.Thread(target=_receive, args=(process.stdout, back_at))
    reader.start()
    head, *samples = lines(seconds * rate * CART_DT)
    process.stdin.write(head)
    process.stdin.flush()
    while not back_at:  # the header arrives when the calibration is complete
        time.sleep(0.01)
    start = time.perf_counter()
    for k, line in enumerate(samples):
        wait = start + k / rate - time.perf_counter()
        if wait > 0:
            time.sleep(wait)
        sent_at.append(time.perf_counter())
        process.stdin.write(line)
        process.stdin.flush()
    process.stdin.close()
    process.wait()
    reader.join()
    process.stdout.close()
    n = min(len(sent_at), len(back_at) - 1)
    return np.array(back_at[1 : n + 1]) - np.array(sent_at[:n]), len(sent_at), len(back_at) - 1


def _receive(stream: IO[bytes], times: list[float]) -> None:
    for _ in stream:
        times.append(time.perf_counter())  # noqa: PERF401 (another thread reads it meanwhile)


def memory(axis: Path, samples: int, out: Path) -> tuple[float, float, float]:
    """Return the resident memory [MiB] after a tenth of the samples and at the end, and samples per second."""
    process = subprocess.Popen(command(axis, "--out", str(out)), stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)
    if process.stdin is None:
        raise OSError("the process has no pipe")
    head, *part = lines(600.0)
    process.stdin.write(head)
    start, early = time.perf_counter(), 0.0
    text = [line.split(b",", 1)[1] for line in part]
    for k in range(samples):
        process.stdin.write(b"%.2f," % (k * CART_DT) + text[k % len(text)])
        if k == samples // 10:
            process.stdin.flush()
            early = resident(process.pid)
    process.stdin.flush()
    late = resident(process.pid)
    process.stdin.close()
    process.wait()
    return early, late, samples / (time.perf_counter() - start)


def resident(pid: int) -> float:
    """Return the resident memory of a process [MiB], from /proc."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def terminated(axis: Path, out: Path, samples: int = 3000) -> tuple[int, int]:
    """End a run by SIGTERM after `samples` lines with the pipe open; return its exit code and the rows of the file."""
    import polars as pl

    process = subprocess.Popen(command(axis, "--out", str(out)), stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    if process.stdin is None or process.stdout is None:
        raise OSError("the process has no pipes")
    process.stdin.write(b"".join(lines(samples * CART_DT)))
    process.stdin.flush()
    for line in process.stdout:
        if b"watching" in line:
            break
    time.sleep(1.0)
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=60)
    read = pl.read_csv if out.suffix == ".csv" else pl.read_parquet
    return process.returncode, read(out).height


def example(folder: Path) -> list[str]:
    """Return the lines of a run in which the load grows by a fifth after 20 s."""
    axis = write_axis(folder)
    heavier = Schedule(((0.0, CART), (20.0, replace(CART, mass=1.2 * CART.mass))))
    u, counts = changing(heavier, 3, INCREMENTS, 45.0)
    rows = (f"{k * CART_DT:.2f},{a!r},{b}" for k, (a, b) in enumerate(zip(u.tolist(), counts.tolist(), strict=True)))
    text = "\n".join(["t,u,counts", *rows]) + "\n"
    found = subprocess.run(command(axis), input=text, capture_output=True, text=True, check=True)
    return [line for line in found.stdout.splitlines() if " s  " in line or line.endswith(("alarm", "alarms"))]


def measure(folder: Path, seconds: float, samples: int) -> PipeFigures:
    """Measure all figures."""
    axis = write_axis(folder)
    found, sent, received = delays(axis, seconds)
    early, late, rate = memory(axis, samples, folder / "long.parquet")
    median, worst = float(np.median(found)), float(np.max(found))
    return PipeFigures(median, worst, sent, received, early, late, samples, rate, example(folder))

"""Measure CPU time and memory from a CSV of a million lines to an estimate: `python -m benchmarks.reading
FIGURES.json`.
"""

from __future__ import annotations

import json
import multiprocessing
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import polars as pl

import pmfid
from pmfid.config.axis import Axis
from pmfid.records.record import read_record
from pmfid.simulation.drive import quantize, simulate_drive
from pmfid.simulation.scenarios import CART, CART_DT
from pmfid.simulation.signals import prbs

LINES, STEP = 1_000_000, 22.75e-6
#: Size of the columns of eight bytes [MB].
COLUMNS = 3 * 8 * LINES / 1e6
#: Lines of the file that is read first to load the imports; runs of each step, of which the shortest counts.
FEW, TIMES = 2000, 3
AXIS = Axis.model_validate(
    {
        "record": {"input": "u", "output": "counts", "output_kind": "counts", "time": "t"},
        "encoder": {"resolution": STEP},
        "model": {"input_gain": CART.input_gain},
        "estimator": {"cutoff": 20.0},
    }
)

PAGE = """\
## Reading

A CSV of a million lines (time, input, counts), read as `pmfid identify` reads it, and RIV's `run` on it; CPU seconds of
the shortest of three runs. Memory: the peak beyond a process that has read a small file before.

| | measured |
|---|---:|
| Polars reads the file | {polars:.2f} s |
| `run` | {run:.2f} s |
| pmfid reads the record | {reading:.2f} s |
| reading and `run` over Polars and `run`, goal: at most 2 | {times:.2f} |
| memory over that of the columns used ({columns:.0f} MB), goal: at most 4 | {memory:.2f} |
"""


def write(path: Path, lines: int) -> None:
    u = prbs(lines, clock=10, amplitude=3.0, rng=np.random.default_rng(1))
    counts = quantize(simulate_drive(CART, u, CART_DT).x, STEP)
    time_column = np.round(np.arange(lines) * CART_DT, 4)
    pl.DataFrame({"t": time_column, "u": u, "counts": counts}).write_csv(path)


def cpu(work: Callable[[], object]) -> float:
    """Return the CPU seconds of the shortest of several runs."""

    def once() -> float:
        start = time.process_time()
        work()
        return time.process_time() - start

    return min(once() for _ in range(TIMES))


def memory(path: Path, small: Path) -> float:
    """Return the peak memory of reading [MB] beyond the process's memory after reading a small file; Linux only."""
    read_record(small, AXIS)
    Path("/proc/self/clear_refs").write_text("5")  # start a new measurement of the peak
    before = _status("VmRSS")
    record = read_record(path, AXIS)
    return _status("VmHWM") - before if record.u.size else 0.0


def _status(key: str) -> float:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(key)) * 1024 / 1e6


def measured() -> dict[str, float]:
    """Return the seconds of each step, and the memory [MB], from a separate process."""
    with tempfile.TemporaryDirectory() as folder:
        path, small = Path(folder) / "run.csv", Path(folder) / "small.csv"
        write(path, LINES)
        write(small, FEW)
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            peak = pool.apply(memory, (path, small))
        polars, reading = cpu(lambda: pl.read_csv(path)), cpu(lambda: read_record(path, AXIS))
        record = read_record(path, AXIS)
    estimator = pmfid.RIV(pmfid.Drive(CART.input_gain), AXIS.encoder.make_encoder(STEP), record.dt, 20.0)
    run = cpu(lambda: estimator.run(record.u, record.counts))
    return {"polars": polars, "reading": reading, "run": run, "peak": peak, "columns": COLUMNS}


def section(figures: Mapping[str, float]) -> str:
    """Return the page's section on reading."""
    times = (figures["reading"] + figures["run"]) / (figures["polars"] + figures["run"])
    return PAGE.format(**figures, times=times, memory=figures["peak"] / figures["columns"])


def main(arguments: list[str]) -> None:
    """Write the figures to the given path."""
    if len(arguments) != 1:
        sys.exit("one path is needed: python -m benchmarks.reading FIGURES.json")
    Path(arguments[0]).write_text(json.dumps(measured(), indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])

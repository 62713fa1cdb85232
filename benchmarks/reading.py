"""From a CSV of a million lines to an estimate: CPU time and memory of each step. `python -m benchmarks.reading`."""

from __future__ import annotations

import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl

import pmfid
from pmfid.session.config import Axis
from pmfid.session.records import read_record
from pmfid.simulation.drive import quantize, simulate_drive
from pmfid.simulation.scenarios import CART, CART_DT
from pmfid.simulation.signals import prbs

LINES, STEP = 1_000_000, 22.75e-6


def write(path: Path) -> None:
    u = prbs(LINES, clock=10, amplitude=3.0, rng=np.random.default_rng(1))
    counts = quantize(simulate_drive(CART, u, CART_DT).x, STEP)
    time_column = np.round(np.arange(LINES) * CART_DT, 4)
    pl.DataFrame({"t": time_column, "u": u, "counts": counts}).write_csv(path)


def cpu(work: Callable[[], object]) -> float:
    start = time.process_time()
    work()
    return time.process_time() - start


def main() -> None:
    """Prints a line for each step."""
    axis = Axis.model_validate(
        {
            "record": {"input": "u", "output": "counts", "output_kind": "counts", "time": "t"},
            "encoder": {"resolution": STEP},
            "model": {"input_gain": CART.input_gain},
            "estimator": {"cutoff": 20.0},
        }
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.csv"
        write(path)
        read_record(path, axis)  # imports, and the file in memory
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        polars, reading = cpu(lambda: pl.read_csv(path)), cpu(lambda: read_record(path, axis))
        after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        record = read_record(path, axis)
    estimator = pmfid.RIV(pmfid.Drive(CART.input_gain), axis.encoder.made(STEP), record.dt, 20.0)
    run = cpu(lambda: estimator.run(record.u, record.counts))
    most = (reading + run) / (polars + run)
    print(f"Polars reads in {polars:.2f} s, run takes {run:.2f} s: {polars + run:.2f} s")
    print(f"read_record takes {reading:.2f} s, with run {reading + run:.2f} s: {most:.2f} times")
    print(f"memory beyond a first reading {(after - before) / 1024:.0f} MB, the columns have {LINES * 24 / 1e6:.0f} MB")


if __name__ == "__main__":
    main()

"""Measure how many axes `pmfid fleet stream` can process on this machine without falling behind.

python -m studies.fleet_stream --out results/fleet_stream.md

A gateway writes a Parquet file with a block of each axis at fixed intervals; the stream runs as a separate process. The
stream holds a rate if its lag at the end is at most two batches.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from pmfid.simulation import CART, CART_DT, Schedule
from pmfid.stream.blocks import MAGIC, PLAIN, block_type
from studies.monitoring.axis import INCREMENTS, changing
from studies.monitoring.pipe import write_axis

#: Samples of a block: one second.
BLOCK = 100
#: Number of different motions, and the latest start within them [samples]: no two axes have the same state.
MOTIONS, LATEST = 8, 6000
#: Factor from a failed rate to the next rate.
LESS = 0.7
#: Longest time for the start of Java with the first batch, and for the last batches [s].
STARTED, ENDED = 180.0, 600.0


@dataclass(frozen=True)
class Run:
    """The figures of a run.

    `axes` and `seconds` give the data, and `done` counts the processed samples. `lag` is the delay at the end [s], and
    `batch` the median time between two batches [s]. `caught_up` lasts from the last sample until all are processed [s].
    `cpu` is the time of all processes in units of one processor. `memory` is the peak of all processes [byte], and
    `state` the size of all axes' states in a batch [byte].
    """

    axes: int
    seconds: float
    done: int
    lag: float
    batch: float
    caught_up: float
    cpu: float
    memory: int
    state: int

    def holds(self) -> bool:
        """Return whether the stream holds the rate and loses no sample."""
        return self.lag <= 2 * self.batch + 1 and self.done == round(self.axes * self.seconds / CART_DT)


class Gateway:
    """A writer of files with blocks of all axes."""

    def __init__(self, folder: Path, axes: int, seconds: float) -> None:
        self._folder, self._form = folder, block_type(0, BLOCK, 10)
        self._names = [f"axis-{k:05d}" for k in range(axes)]
        plain = Schedule(((0.0, CART),))
        motions = [changing(plain, k, INCREMENTS, seconds + 1 + LATEST / BLOCK) for k in range(min(MOTIONS, axes))]
        self._u, self._counts = (np.stack([motion[k] for motion in motions]) for k in (0, 1))
        self._which = np.arange(axes) % len(motions)
        self._begin = (np.arange(axes) // len(motions) * 7) % LATEST

    def write(self, second: int) -> None:
        """Write the file of a second; readers see the whole file or none."""
        rows = np.zeros(len(self._names), self._form)
        part = self._which[:, None], self._begin[:, None] + np.arange(second * BLOCK, (second + 1) * BLOCK)
        rows["magic"], rows["version"], rows["samples"], rows["letters"] = MAGIC, PLAIN, BLOCK, 10
        rows["first"], rows["time"], rows["dt"] = second * BLOCK, second * BLOCK * CART_DT, CART_DT
        rows["name"], rows["u"], rows["counts"] = self._names, self._u[part], self._counts[part]
        size, data = self._form.itemsize, bytearray(rows.tobytes())
        for place in range(0, len(data), size):
            data[place + size - 4 : place + size] = zlib.crc32(data[place : place + size - 4]).to_bytes(4, "little")
        blocks = [bytes(data[place : place + size]) for place in range(0, len(data), size)]
        path = self._folder / f"second-{second:06d}.parquet"
        pl.DataFrame({"axis": self._names, "block": blocks}).write_parquet(path.with_suffix(".part"), compression="lz4")
        path.with_suffix(".part").rename(path)


@contextmanager
def stream(folder: Path, shards: int, interval: float) -> Iterator[subprocess.Popen[bytes]]:
    """Run `pmfid fleet stream` on the folder, and end the stream with all its processes."""
    places = [str(folder / "in"), "--config", str(folder / "axis.toml"), "--out", str(folder / "out")]
    pace = ["--checkpoint", str(folder / "checkpoint"), "--shards", str(shards), "--interval", str(interval)]
    command = [str(Path(sys.executable).with_name("pmfid")), "fleet", "stream", *places, *pace]
    environment = {**os.environ, "PMFID_CACHE": str(folder / "cache")}
    with (
        open(folder / "said", "ab") as said,
        subprocess.Popen(command, env=environment, start_new_session=True, stdout=said, stderr=said) as process,
    ):
        try:
            yield process
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)


def measured(axes: int, seconds: int, shards: int, interval: float) -> Run:
    """Run the stream with the gateway for the given time."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "in").mkdir()
        write_axis(folder, 60.0)
        gateway = Gateway(folder / "in", axes, float(seconds))
        with stream(folder, shards, interval) as process:
            gateway.write(0)
            if not _wait(folder, axes, 1, STARTED, process):
                raise RuntimeError(f"the stream has done nothing: {_end_of(folder / 'said')}")
            begun, memory, cpu = time.monotonic(), 0, _cpu(process.pid)
            for second in range(1, seconds):
                time.sleep(max(0.0, begun + second - time.monotonic()))
                gateway.write(second)
                memory = max(memory, _memory(process.pid))
            ended = time.monotonic()
            lag = seconds - _done(folder) * CART_DT / axes
            cpu = (_cpu(process.pid) - cpu) / (ended - begun)
            _wait(folder, axes, seconds, ENDED, process)
            caught_up = time.monotonic() - ended
        times = sorted(path.stat().st_mtime for path in (folder / "out" / "batches").iterdir())
        batch = float(np.median(np.diff(times))) if len(times) > 1 else interval
        return Run(axes, seconds, _done(folder), lag, batch, caught_up, cpu, memory, _state(folder))


def _done(folder: Path) -> int:
    """Return the number of processed samples."""
    place = folder / "out" / "batches"
    files = list(place.glob("*.json")) if place.is_dir() else []
    return sum(int(json.loads(path.read_text()).get("samples", 0)) for path in files)


def _wait(folder: Path, axes: int, seconds: int, longest: float, process: subprocess.Popen[bytes]) -> bool:
    """Wait for the samples; return whether they came before the time limit and the end of the process."""
    end = time.monotonic() + longest
    while _done(folder) < axes * seconds * BLOCK and time.monotonic() < end and process.poll() is None:
        time.sleep(0.2)
    return _done(folder) >= axes * seconds * BLOCK


def _end_of(path: Path) -> str:
    return path.read_text("utf-8", "replace")[-2000:] or "it said nothing, and was given no more time"


def _family(number: int) -> list[Path]:
    """Return the process and all its descendants in /proc."""
    known, found = {number}, list[Path]()
    for place in sorted(Path("/proc").glob("[0-9]*"), key=lambda path: int(path.name)):
        with suppress(OSError, IndexError):
            parent = int((place / "stat").read_text().rpartition(")")[2].split()[1])
            if int(place.name) in known or parent in known:
                known.add(int(place.name))
                found.append(place)
    return found


def _memory(number: int) -> int:
    total = 0
    for place in _family(number):
        with suppress(OSError, IndexError):
            total += int((place / "statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return total


def _cpu(number: int) -> float:
    """Return the processor time so far [s]."""
    total = 0.0
    for place in _family(number):
        with suppress(OSError, IndexError):
            fields = (place / "stat").read_text().rpartition(")")[2].split()
            total += sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")
    return total


def _state(folder: Path) -> int:
    """Return the bytes that the last batch wrote for the states, in Spark's compression."""
    sizes: dict[int, int] = {}
    for path in (folder / "checkpoint" / "spark" / "state").rglob("*.changelog"):
        batch = int(path.name.partition("_")[0].partition(".")[0])
        sizes[batch] = sizes.get(batch, 0) + path.stat().st_size
    return sizes[max(sizes)] if sizes else 0


def searched(axes: int, seconds: int, shards: int, interval: float) -> list[Run]:
    """Reduce the number of axes until the stream holds the rate."""
    found = list[Run]()
    while not found or not (found[-1].holds() or axes < MOTIONS):
        found.append(measured(axes, seconds, shards, interval))
        print(found[-1], flush=True)
        axes = int(axes * LESS)
    return found


def _row(run: Run) -> str:
    cells = [
        f"{run.axes}",
        f"{run.seconds:g}",
        f"{run.axes / CART_DT:.0f}",
        "yes" if run.holds() else "no",
        *(f"{value:.1f} s" for value in (run.lag, run.batch, run.caught_up)),
        f"{run.cpu:.2f}",
        f"{run.memory / 2**30:.1f} GiB",
        f"{run.state / 2**20:.0f} MiB",
    ]
    return f"| {' | '.join(cells)} |"


def page(runs: Sequence[Run], shards: int, interval: float, others: float) -> str:
    """Return the page; `others` is the mean number of waiting processes before the first run."""
    lines = [
        "# What a stream on Spark keeps up with",
        "",
        f"Made by `python -m studies.fleet_stream`, on {os.cpu_count()} processors that also wrote the blocks: Parquet "
        f"files of one block of {BLOCK} samples (1 s) of each axis every second, {shards} shards, {interval:g} s "
        "between batches. A rate holds if the stream is at the end not further behind than two batches and a second, "
        f"and no sample is missing or double. Other work on the machine before the first run: {others:.1f} processes "
        "that wanted a processor, which these figures have in them.",
        "",
        "| axes | seconds | samples/s | holds | lag at the end | a batch takes | all done after | processors "
        "| memory | states written with a batch |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    lines += map(_row, runs)
    tail = (
        "An axis has about 19 kB of state (its estimator, its watch), and every batch writes the states of the axes "
        "that it touched: what a batch costs is therefore mostly that of its axes, not of its samples. Longer "
        "intervals cost less and answer later."
    )
    return "\n".join([*lines, "", tail, ""])


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--axes", type=int, default=10_000)
    parser.add_argument("--seconds", type=int, default=600)
    parser.add_argument("--shards", type=int, default=4)
    parser.add_argument("--interval", type=float, default=10.0)
    parser.add_argument("--out", type=Path, required=True)
    given, others = parser.parse_args(arguments), os.getloadavg()[0]
    runs = searched(given.axes, given.seconds, given.shards, given.interval)
    given.out.write_text(page(runs, given.shards, given.interval, others))


if __name__ == "__main__":
    main()

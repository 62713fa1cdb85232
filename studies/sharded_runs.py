"""Measure the cost of a sharded fleet; each size runs in a separate process with its own memory."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmfid import BCRLS, Drive, Encoder, Fleet, ShardedFleet
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.simulation import CART, CART_DT, prbs, quantize, simulate_drive

__all__ = ["Cost", "Spent", "estimator", "in_a_process", "kills", "motion", "per_sample"]

RESOLUTION, CUTOFF, FORGETTING = 9.1e-5, 50.0, 0.999
#: Number of axes with different motions, larger than any vector. All other axes are copies.
APART = 64
#: Samples of each axis before a measurement, and samples of a measured call.
BEFORE, CALL = 60, 10


def estimator(cls: type[RecursiveEstimator] = BCRLS, **options: object) -> RecursiveEstimator:
    """Return the estimator of the cart with other options."""
    settings = {"model": Drive(CART.input_gain), "encoder": Encoder(RESOLUTION), "dt": CART_DT, "cutoff": CUTOFF}
    return cls(**(settings | {"forgetting": FORGETTING} | options))  # type: ignore[arg-type]


@cache
def _apart(samples: int) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    rng = np.random.default_rng(7)
    inputs, counts = [], []
    for _ in range(APART):
        u = prbs(samples, clock=5, amplitude=5.0, rng=rng)
        drive = replace(CART, mass=CART.mass * float(rng.uniform(0.7, 1.4)))
        inputs.append(u.astype(np.float32))
        counts.append(quantize(simulate_drive(drive, u, CART_DT).x, RESOLUTION).astype(np.int32))
    return np.stack(inputs), np.stack(counts)


def motion(axes: int, first: int, samples: int) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return u, counts (axes, samples) of carts with different masses under random binary inputs, from a sample on."""
    u, counts = _apart(first + samples)
    copies = (-(-axes // APART), 1)
    return np.tile(u[:, first:], copies)[:axes], np.tile(counts[:, first:], copies)[:axes]


@dataclass
class Spent:
    """Wall time and processor time [s]."""

    wall: float = 0.0
    processor: float = 0.0


@contextmanager
def spent() -> Iterator[Spent]:
    """Measure the time in a block."""
    found, wall, processor = Spent(), time.perf_counter(), time.process_time()
    yield found
    found.wall, found.processor = time.perf_counter() - wall, time.process_time() - processor


def resident() -> float:
    """Return the present memory of this process [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


@dataclass(frozen=True)
class Cost:
    """The cost of a fleet.

    `state` is the size of an axis [byte]. `empty`, `stepped` and `restored` are the memory of the process before it,
    after the calls, and of another process after the restore [MB]. `step` is a call of `CALL` samples. `first`, `again`
    and `few` are checkpoints of all axes, of all axes again, and of one shard. `disk` is the size of the folder [byte].
    """

    axes: int
    state: int
    empty: float
    stepped: float
    restored: float
    add: Spent
    step: Spent
    first: Spent
    again: Spent
    few: Spent
    restore: Spent
    disk: int


def _run_fleet(folder: Path, axes: int) -> dict[str, object]:
    """Measure everything except the restore in this process."""
    single = estimator()
    Fleet(single, 8).run(*motion(8, 0, CALL))  # loads the libraries of the first call
    empty = resident()
    with ShardedFleet(folder, [single]) as fleet:
        with spent() as add:
            handles = fleet.add(single, axes)
        fleet.run(handles, *motion(axes, 0, BEFORE))
        u, counts = motion(axes, BEFORE, CALL)
        with spent() as step:
            fleet.run(handles, u, counts)
        with spent() as first:
            written = fleet.checkpoint(1)
        fleet.run(handles, u, counts)
        del u, counts
        with spent() as again:
            fleet.checkpoint(2)
        fleet.gap(int(handles[0]), 0)
        with spent() as few:
            fleet.checkpoint(3)
        stepped = resident()
    disk = sum(path.stat().st_size for path in folder.iterdir())
    times: dict[str, object] = {"add": add, "step": step, "first": first, "again": again, "few": few}
    return times | {"axes": axes, "state": written // axes, "empty": empty, "stepped": stepped, "disk": disk}


def _restore(folder: Path) -> dict[str, object]:
    single = estimator()
    with spent() as restore:
        fleet = ShardedFleet(folder, [single])
    with fleet:
        return {"restore": restore, "restored": resident()}


def in_a_process(axes: int) -> Cost:
    """Return the cost of a fleet, measured in separate processes."""
    with tempfile.TemporaryDirectory(dir=os.environ.get("TMPDIR")) as name:
        found = _reported("run", name, axes) | _reported("restore", name, axes)
    times = {key: Spent(**value) for key, value in found.items() if isinstance(value, dict)}
    return Cost(**(found | times))  # type: ignore[arg-type]


def _reported(what: str, folder: str, axes: int) -> dict[str, object]:
    command = [sys.executable, "-m", "studies.sharded_runs", what, folder, str(axes)]
    reported: dict[str, object] = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    return reported


# --- kills ------------------------------------------------------------------------------------------------------------


def _sums(fleet: ShardedFleet) -> list[int]:
    """Return a checksum of the states of every shard."""
    return [zlib.crc32(shard.used.reshape(-1).data) for shard in fleet._shards]


def _child(folder: Path, axes: int) -> None:
    """Run steps and checkpoints without end; print the content of each checkpoint before it."""
    with ShardedFleet(folder, [estimator()]) as fleet:
        handles = fleet.handles() if fleet.restored else fleet.add(estimator(), axes)
        mark = int(fleet.restored.mark) if fleet.restored else 0  # type: ignore[call-overload]
        while True:
            fleet.run(handles, *motion(axes, 0, CALL))
            mark += 1
            print(json.dumps({"mark": mark, "sums": _sums(fleet)}), flush=True)
            fleet.checkpoint(mark)
            print(json.dumps({"done": mark}), flush=True)


@dataclass(frozen=True)
class Kill:
    """The outcome of a kill.

    `after` is the time since the start of the current checkpoint [s], and `within` means an incomplete checkpoint.
    `whole` means that the states have the bits of the last complete or the current checkpoint, and `newer` means the
    current one. `damaged` counts files that were set aside.
    """

    after: float
    within: bool
    whole: bool
    newer: bool
    damaged: int


def kills(axes: int, times: int, seed: int = 5) -> Iterator[Kill]:
    """Yield SIGKILLs within a checkpoint of all axes, at random in equal parts of its duration."""
    rng = random.Random(seed)
    with tempfile.TemporaryDirectory(dir=os.environ.get("TMPDIR")) as name:
        for part in range(times):
            after, lines = _killed(Path(name), axes, (part + rng.random()) / times)
            reported = {line["mark"]: line["sums"] for line in lines if "mark" in line}
            done = [line["done"] for line in lines if "done" in line]
            with ShardedFleet(name, [estimator()]) as fleet:
                mark = int(fleet.restored.mark) if fleet.restored else 0  # type: ignore[call-overload]
                damaged = len(fleet.restored.damaged) if fleet.restored else 0
                whole = mark >= done[-1] and _sums(fleet) == reported[mark]
            yield Kill(after, len(done) == 1, whole, mark > done[-1], damaged)


def _killed(folder: Path, axes: int, part: float) -> tuple[float, list[dict[str, Any]]]:
    """Run a child and kill it in its second checkpoint, after a fraction of the first one's time. Returns that time [s]
    and the child's output."""
    command = [sys.executable, "-m", "studies.sharded_runs", "child", str(folder), str(axes)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        output = child.stdout or sys.stdin  # always a pipe
        lines = [json.loads(output.readline())]
        begun = time.perf_counter()
        lines.append(json.loads(output.readline()))
        after = part * (time.perf_counter() - begun)
        lines.append(json.loads(output.readline()))
        time.sleep(after)
        child.send_signal(signal.SIGKILL)
        return after, lines + [json.loads(line) for line in output]


# --- samples, models, methods -----------------------------------------------------------------------------------------


def per_sample(
    single: RecursiveEstimator, axes: int, samples: int, workers: int | None = 1, quantile: float = 0.0
) -> tuple[float, int]:
    """Return the processor time of a sample of an axis [s], and the bytes of an axis. The calls have `samples` samples.
    The time is a quantile of five calls; 0 means the least."""
    fleet = Fleet(single, axes, workers=workers)
    fleet.run(*motion(axes, 0, BEFORE))
    times = [_timed(partial(fleet.run, *motion(axes, BEFORE + k * samples, samples))) for k in range(5)]
    return float(np.quantile(times, quantile)) / (axes * samples), fleet._many.kernel.states.shape[1]


def _timed(action: Callable[[], object]) -> float:
    with spent() as found:
        action()
    return found.processor


def main() -> None:
    what, folder, axes = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3])
    if what == "child":
        _child(folder, axes)
    found = _run_fleet(folder, axes) if what == "run" else _restore(folder)
    print(json.dumps(found, default=vars))


if __name__ == "__main__":
    main()

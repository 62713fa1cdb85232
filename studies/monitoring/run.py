"""Run the study: `python -m studies.monitoring --out results/monitoring.md`.

The page up to its heading "Figures" is written by hand and stays.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from pmfid.monitor.calibration import Calibration
from pmfid.monitor.names import DETECTORS
from studies.monitoring import detection, false_alarms, page
from studies.monitoring.axis import CALIBRATIONS, INCREMENTS, calibrated
from studies.monitoring.detection import RECOVERY_INCREMENTS as RECOVERY
from studies.monitoring.pipe import measure

HOURS, SEEDS, PIPE_SECONDS, LONG_SAMPLES = 512.5, 100, 60.0, 1_000_000


def tasks(hours: float, seeds: int) -> dict[str, list[tuple[Any, ...]]]:
    """Return the arguments of the work of every section."""
    per_task = false_alarms.RUN_HOURS * false_alarms.RUNS_PER_TASK
    mass = [("mass +10 %", detector, 0.02) for detector in DETECTORS]
    others = [(change, "glr", 0.02) for change in detection.CHANGES]
    cases = list(dict.fromkeys([*mass, ("mass +10 %", "glr", 0.0), *others]))
    return {
        "false alarms": [(task,) for task in range(max(1, round(hours / per_task)))],
        "detection": [(detector, change, tol, seed) for change, detector, tol in cases for seed in range(seeds)],
        "recovery": [(inc, 500 + seed) for inc in detection.RECOVERY_INCREMENTS for seed in range(max(1, seeds // 2))],
        "standstill": [(detector, seed) for detector in DETECTORS for seed in range(max(1, min(2, seeds // 50)))],
    }


WORK: dict[str, Callable[..., Any]] = {
    "false alarms": false_alarms.work,
    "detection": detection.work,
    "recovery": detection.recovery,
    "standstill": detection.standstill,
}


def _know(made: dict[int, Calibration]) -> None:
    CALIBRATIONS.update(made)


def _work(task: tuple[str, tuple[Any, ...]]) -> Any:
    name, arguments = task
    return WORK[name](*arguments)


def results_of(every: dict[str, list[tuple[Any, ...]]], jobs: int) -> dict[str, list[Any]]:
    """Compute the results in new processes with one thread each."""
    from rich.console import Console
    from rich.progress import track

    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "POLARS_MAX_THREADS"):
        os.environ.setdefault(variable, "1")
    flat = [(name, arguments) for name, rows in every.items() for arguments in rows]
    console = Console(stderr=True)
    context = multiprocessing.get_context("spawn")
    needed = sorted({INCREMENTS, *RECOVERY})
    with context.Pool(jobs) as pool:
        made = dict(zip(needed, pool.map(calibrated, needed, chunksize=1), strict=True))
    with context.Pool(jobs, _know, (made,)) as pool:
        found = pool.imap(_work, flat)
        shown = list(track(found, "monitoring", total=len(flat), console=console, disable=not console.is_terminal))
    results: dict[str, list[Any]] = {name: [] for name in every}
    for (name, _), result in zip(flat, shown, strict=True):
        results[name].append(result)
    return results


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="the page")
    parser.add_argument("--hours", type=float, default=HOURS, help="of normal work (default: %(default)s)")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="runs of each change (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default: %(default)s)")
    parser.add_argument("--no-pipe", action="store_true", help="leave out the two minutes of the pipe")
    options = parser.parse_args(arguments)
    every = tasks(options.hours, options.seeds)
    pipe = None
    if not options.no_pipe:
        with tempfile.TemporaryDirectory() as folder:
            pipe = measure(Path(folder), PIPE_SECONDS, LONG_SAMPLES)
    lines = page.figures(results_of(every, options.jobs), every, pipe)
    options.out.write_text("\n".join(lines).rstrip("\n") + "\n", "utf-8")
    return 0

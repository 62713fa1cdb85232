"""The study of all methods by Monte Carlo: `python -m pmfid.studies.accuracy --out docs/accuracy.md`."""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pmfid.errors import UsageError
from pmfid.studies import coverage, open_loop, starts, stop_and_go, wrong_models
from pmfid.studies.truth import Study, Task

STUDIES: dict[str, Study] = {
    study.name: study
    for study in (
        open_loop.STUDY,
        stop_and_go.STUDY,
        starts.STUDY,
        coverage.STUDY,
        wrong_models.STUDY,
        wrong_models.CREEP,
    )
}
SEEDS = 50
INTRODUCTION = """\
All on the simulated cart: 1.07 kg, 12.8 N s/m, 0.8 N, 2 N/V, T = 10 ms, filters of order 2, the default pre-filter
zeros; an encoder of 4096 increments has 22.75 µm per count. The simulation solves for stops and reversals exactly,
except where a section says otherwise. Each table states how many seeds it has."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the study and writes the page; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m pmfid.studies.accuracy", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="Markdown page to write")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="of the largest tables (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default: %(default)s)")
    parser.add_argument("--only", nargs="+", choices=list(STUDIES), default=list(STUDIES), help="sections to run")
    options = parser.parse_args(arguments)
    try:
        page = run(options.seeds, options.jobs, options.only)
        options.out.write_text(page, encoding="utf-8")
    except (UsageError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def run(seeds: int = SEEDS, jobs: int = 2, only: Sequence[str] = tuple(STUDIES)) -> str:
    """The page. seeds: of the open-loop table, >= 1; the other tables have their own part or multiple of it.

    The same seeds and sections give the same page, whatever the number of processes, jobs >= 1. Raises UsageError.
    """
    for name, value in (("seeds", seeds), ("jobs", jobs)):
        if value < 1:
            raise UsageError(f"{name} must be at least 1, got {value}")
    names = [name for name in STUDIES if name in only]
    tasks = [(name, task) for name in names for task in STUDIES[name].tasks(seeds)]
    results: dict[str, dict[Task, Any]] = {name: {} for name in names}
    for (name, task), result in zip(tasks, _results(tasks, jobs), strict=True):
        results[name][task] = result
    lines = [*_head(seeds, names), ""]
    for name in names:
        lines += STUDIES[name].write(seeds, results[name])
    return "\n".join(lines).rstrip("\n") + "\n"


def _head(seeds: int, names: Sequence[str]) -> list[str]:
    command = "python -m pmfid.studies.accuracy --out docs/accuracy.md"
    command += "" if seeds == SEEDS else f" --seeds {seeds}"
    command += "" if len(names) == len(STUDIES) else f" --only {' '.join(names)}"
    return ["# Accuracy", "", "Written by", "", f"    {command}", "", *INTRODUCTION.splitlines()]


def _results(tasks: Sequence[tuple[str, Task]], jobs: int) -> list[Any]:
    """In processes that start afresh with one thread each: neither jobs nor threads change the last bit."""
    from rich.console import Console
    from rich.progress import track

    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    with multiprocessing.get_context("spawn").Pool(jobs) as pool:
        found = pool.imap(_work, tasks, chunksize=2)
        console = Console(stderr=True)
        shown = track(
            found, "accuracy", total=len(tasks), console=console, disable=not console.is_terminal, transient=True
        )
        return list(shown)


def _work(task: tuple[str, Task]) -> Any:
    name, arguments = task
    return STUDIES[name].work(*arguments)


if __name__ == "__main__":
    sys.exit(main())

"""The study of transfer functions by Monte Carlo: `python -m pmfid.studies.black_box --out docs/black_box.md`."""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pmfid.errors import UsageError
from pmfid.studies import discretizations, efficiency, processes, published, structures, uneven, varying
from pmfid.studies.truth import Study, Task

STUDIES: dict[str, Study] = {
    study.name: study
    for study in (
        processes.STUDY,
        efficiency.STUDY,
        published.STUDY,
        discretizations.STUDY,
        uneven.STUDY,
        structures.STUDY,
        varying.STUDY,
    )
}
SEEDS = 100
#: Parts of the seeds for sections that need fewer or more.
PARTS = {"efficiency": 10.0, "discretizations": 0.05, "varying": 0.05}
INTRODUCTION = """\
Transfer functions from input and output alone, no parameter known. The records are simulated exactly for a held input
and start at rest; the methods do not know that. Each table states how many runs it has."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the study and writes the page; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m pmfid.studies.black_box", description=__doc__)
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
    """The page. seeds: of each table, >= 1, but for those that need only a part.

    The same seeds and sections give the same page, whatever the number of processes, jobs >= 1. Raises UsageError.
    """
    for name, value in (("seeds", seeds), ("jobs", jobs)):
        if value < 1:
            raise UsageError(f"{name} must be at least 1, got {value}")
    names = [name for name in STUDIES if name in only]
    tasks = [(name, task) for name in names for task in STUDIES[name].tasks(_seeds(name, seeds))]
    results: dict[str, dict[Task, Any]] = {name: {} for name in names}
    for (name, task), result in zip(tasks, _results(tasks, jobs), strict=True):
        results[name][task] = result
    lines = [*_head(seeds, names), ""]
    for name in names:
        lines += STUDIES[name].write(_seeds(name, seeds), results[name])
    return "\n".join(lines).rstrip("\n") + "\n"


def _seeds(name: str, seeds: int) -> int:
    return max(1, round(seeds * PARTS.get(name, 1.0)))


def _head(seeds: int, names: Sequence[str]) -> list[str]:
    command = "python -m pmfid.studies.black_box --out docs/black_box.md"
    command += "" if seeds == SEEDS else f" --seeds {seeds}"
    command += "" if len(names) == len(STUDIES) else f" --only {' '.join(names)}"
    return [
        "# Transfer functions as a black box",
        "",
        "Written by",
        "",
        f"    {command}",
        "",
        *INTRODUCTION.splitlines(),
    ]


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
            found, "black box", total=len(tasks), console=console, disable=not console.is_terminal, transient=True
        )
        return list(shown)


def _work(task: tuple[str, Task]) -> Any:
    name, arguments = task
    return STUDIES[name].work(*arguments)


if __name__ == "__main__":
    sys.exit(main())

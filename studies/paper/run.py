"""Run the figures on all cores; write their pictures, their data and one table."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from multiprocessing.pool import Pool
from pathlib import Path
from typing import TypeVar

from pmfid.errors import UsageError, did_you_mean
from studies.paper import encoders, figure2, figure3, figure4, figure5
from studies.paper.figure import PaperFigure, Task
from studies.paper.merit import Merit, write_table

T = TypeVar("T")

FIGURES: dict[str, PaperFigure] = {
    f.name: f for f in (figure2.FIGURE, figure3.FIGURE, figure4.FIGURE, figure5.FIGURE, encoders.FIGURE)
}
SEEDS = 200


def reproduce(
    names: Sequence[str],
    out: Path,
    seeds: int = SEEDS,
    jobs: int | None = None,
    done: Callable[[float], None] | None = None,
) -> list[Merit]:
    """Return the table's rows for the figures `names` (none: all); write pictures, data and table.csv into `out`.

    `seeds` >= 1 is the number of runs of each row. `jobs` is the number of processes; None means one for each core.
    `done` is called with the completed fraction. The same seeds give the same files for any number of processes. Raises
    UsageError for an unknown figure, and OSError.
    """
    chosen = [_figure(name) for name in dict.fromkeys(names or FIGURES)]
    for name, value in (("seeds", seeds), ("jobs", 1 if jobs is None else jobs)):
        if value < 1:
            raise UsageError(f"{name} must be at least 1, got {value}")
    out.mkdir(parents=True, exist_ok=True)
    tasks = [(figure.name, task) for figure in chosen for task in figure.tasks(seeds)]
    results: dict[str, dict[Task, object]] = {figure.name: {} for figure in chosen}
    with _pool(jobs) as pool:
        found = pool.imap(_work, tasks, chunksize=8)
        for figure in chosen:  # while the other processes work
            figure.draw(out)
        for (name, task), result in zip(tasks, _counted(found, len(tasks), done), strict=True):
            results[name][task] = result
    rows = [row for figure in chosen for row in figure.rows(results[figure.name])]
    write_table(rows, out / "table.csv")
    return rows


def _figure(name: str) -> PaperFigure:
    if name not in FIGURES:
        raise UsageError(f"unknown figure {name!r}{did_you_mean(name, FIGURES)}; there are {', '.join(FIGURES)}")
    return FIGURES[name]


def _pool(jobs: int | None) -> Pool:
    """Return a pool of new processes with one thread each, so that jobs and threads do not change a bit."""
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    # only the parent process handles an interrupt, and ends all other processes
    ignored = (signal.SIGINT, signal.SIG_IGN)
    return multiprocessing.get_context("spawn").Pool(jobs or os.cpu_count() or 1, signal.signal, ignored)


def _counted(results: Iterable[T], total: int, done: Callable[[float], None] | None) -> Iterator[T]:
    """Yield the results; call `done` with the completed fraction."""
    for count, result in enumerate(results, 1):
        if done is not None:
            done(count / total)
        yield result


def _work(task: tuple[str, Task]) -> object:
    name, arguments = task
    return FIGURES[name].work(*arguments)

"""A page of several studies: computed in processes, written as Markdown."""

from __future__ import annotations

import argparse
import inspect
import multiprocessing
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pmfid.errors import UsageError
from studies.paper.truth import Study, Task


@dataclass(frozen=True)
class Page:
    """A page: `name` is the name of its module and of the page in docs/, `seeds` the seeds of the largest tables.

    `parts` is the factor of the seeds for sections that need fewer or more.
    """

    name: str
    title: str
    introduction: str
    studies: Mapping[str, Study]
    seeds: int
    parts: Mapping[str, float] = field(default_factory=dict)

    def main(self, description: str | None, arguments: Sequence[str] | None) -> int:
        """Run the studies, write the page, and return the exit code."""
        names = list(self.studies)
        parser = argparse.ArgumentParser(prog=f"python -m studies.{self.name}", description=description)
        parser.add_argument("--out", type=Path, required=True, help="Markdown page to write")
        parser.add_argument(
            "--seeds", type=int, default=self.seeds, help="of the largest tables (default: %(default)s)"
        )
        parser.add_argument("--jobs", type=int, default=2, help="processes (default: %(default)s)")
        parser.add_argument("--only", nargs="+", choices=names, default=names, help="sections to run")
        options = parser.parse_args(arguments)
        try:
            page = self.run(options.seeds, options.jobs, options.only)
            options.out.write_text(page, encoding="utf-8")
        except (UsageError, OSError) as error:
            print(f"error: {error}", file=sys.stderr)
            return 2
        return 0

    def run(self, seeds: int, jobs: int, only: Sequence[str]) -> str:
        """Return the page for `seeds` and `jobs` >= 1.

        The same seeds and sections give the same page for any number of processes. Raises UsageError.
        """
        for name, value in (("seeds", seeds), ("jobs", jobs)):
            if value < 1:
                raise UsageError(f"{name} must be at least 1, got {value}")
        names = [name for name in self.studies if name in only]
        tasks = [(name, task) for name in names for task in self.studies[name].tasks(self._part(name, seeds))]
        work = [(self.studies[name].work, task) for name, task in tasks]
        results: dict[str, dict[Task, Any]] = {name: {} for name in names}
        for (name, task), result in zip(tasks, _results(work, jobs, self.title), strict=True):
            results[name][task] = result
        lines = [*self._head(seeds, names), ""]
        for name in names:
            lines += self.studies[name].write(self._part(name, seeds), results[name])
        return "\n".join(lines).rstrip("\n") + "\n"

    def _part(self, name: str, seeds: int) -> int:
        return max(1, round(seeds * self.parts.get(name, 1.0)))

    def _head(self, seeds: int, names: Sequence[str]) -> list[str]:
        command = f"python -m studies.{self.name} --out results/{self.name}.md"
        command += "" if seeds == self.seeds else f" --seeds {seeds}"
        command += "" if len(names) == len(self.studies) else f" --only {' '.join(names)}"
        return [f"# {self.title}", "", "Written by", "", f"    {command}", "", *self.introduction.splitlines()]


def write_page(page: Callable[..., str], description: str | None) -> None:
    """Write the page to the file of --out; each parameter of `page` is an option with the type of its default."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--out", type=Path, required=True, help="Markdown page to write")
    for name, parameter in inspect.signature(page).parameters.items():
        default = parameter.default
        parser.add_argument(f"--{name}", type=type(default), default=default, help="(default: %(default)s)")
    options = vars(parser.parse_args())
    out = options.pop("out")
    out.write_text(page(**options), encoding="utf-8")


def by_name(*studies: Study) -> dict[str, Study]:
    """Return the studies by name, in this order."""
    return {study.name: study for study in studies}


def _results(work: Sequence[tuple[Callable[..., Any], Task]], jobs: int, title: str) -> list[Any]:
    """Return the results of new processes with one thread each, so that jobs and threads do not change a bit."""
    from rich.console import Console
    from rich.progress import track

    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    console = Console(stderr=True)
    with multiprocessing.get_context("spawn").Pool(jobs) as pool:
        found = pool.imap(_apply, work, chunksize=2)
        quiet = not console.is_terminal
        return list(track(found, title.lower(), total=len(work), console=console, disable=quiet, transient=True))


def _apply(task: tuple[Callable[..., Any], Task]) -> Any:
    work, arguments = task
    return work(*arguments)

"""Judge a fit on random machines: `python -m studies.referee --machines 30 --seed 1 --out results/referee.md`.

The page and its table, `referee.csv`, have a line for each kind of truth. `referee_rows.csv` grows by a row for each
machine.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Iterator, Sequence
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from studies.referee.cases import Case, make_cases
from studies.referee.judge import Row, judge
from studies.referee.machines import KINDS, RIGHT
from studies.referee.table import compare, tabulate, write_page


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m studies.referee", description=__doc__)
    parser.add_argument("--kinds", nargs="+", choices=[*KINDS], default=[*KINDS], help="kinds of truth")
    parser.add_argument("--machines", type=int, default=30, help="machines of each wrong kind")
    parser.add_argument("--right", type=int, default=200, help="machines with the right model")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--call", default="studies.referee.judge:identify", help="the fit, as module:function")
    parser.add_argument("--out", type=Path, default=Path("results/referee.md"), help="the page")
    parser.add_argument("--against", type=Path, help="the table (.csv) of an earlier run; print what is worse")
    parser.add_argument("--resume", action="store_true", help="keep the machines of an interrupted run")
    return parser.parse_args(arguments)


def list_cases(options: argparse.Namespace, done: set[tuple[str, int]]) -> list[Case]:
    """Simulate all machines that are not done, and mix the kinds, so that a part of the run shows all of them."""
    order: list[tuple[float, Case]] = []
    for kind in options.kinds:
        size = options.right if kind == RIGHT else options.machines
        indices = [index for index in range(size) if (kind, index) not in done]
        order += [(case.index / size, case) for case in (make_cases(options.seed, kind, indices) if indices else [])]
    return [case for _, case in sorted(order, key=lambda pair: pair[0])]


def run(options: argparse.Namespace, cases: Sequence[Case]) -> Iterator[Row]:
    """Judge the cases in `jobs` processes, and yield each row as soon as it is ready."""
    work = partial(judge, options.call)
    if options.jobs < 2:
        yield from map(work, cases)
        return
    with get_context("spawn").Pool(options.jobs) as pool:
        yield from pool.imap_unordered(work, cases)


def read_rows(path: Path) -> list[Row]:
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        return [dict(row) for row in csv.DictReader(file)]


def write_rows(path: Path, rows: Sequence[Row], mode: str = "w") -> None:
    with path.open(mode, encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        if mode == "w":
            writer.writeheader()
        cells = [{k: f"{v:.5g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows]
        writer.writerows(cells)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the referee, write rows, table and page, and return the exit code."""
    options = parse(arguments)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    path = options.out.with_name(f"{options.out.stem}_rows.csv")
    rows = read_rows(path) if options.resume else []
    cases = list_cases(options, {(str(row["kind"]), int(row["index"])) for row in rows})
    for count, row in enumerate(run(options, cases), 1):
        write_rows(path, [row], "a" if rows else "w")
        rows.append(row)
        if sys.stderr.isatty():
            print(f"\r{count} of {len(cases)}", end="", file=sys.stderr, flush=True)
    lines = tabulate(sorted(rows, key=lambda row: [*KINDS].index(str(row["kind"]))))
    write_rows(options.out.with_suffix(".csv"), lines)
    options.out.write_text(write_page(lines, options.seed), encoding="utf-8")
    for text in compare(lines, read_rows(options.against)) if options.against else []:
        print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""The figures and claims of the paper: `python -m studies.paper --out docs/paper.md --images docs/images/paper`."""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from studies.paper.page import do_job, jobs, write_page

SEEDS = 20


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the page and its pictures; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m studies.paper", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/paper.md"), help="the page (default: %(default)s)")
    parser.add_argument("--images", type=Path, default=Path("docs/images/paper"), help="folder of the pictures")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="runs of each case, at least 2 (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes (default: one for each core)")
    options = parser.parse_args(arguments)
    if options.seeds < 2 or options.jobs < 1:
        parser.error("--seeds must be at least 2, and --jobs at least 1")
    options.images.mkdir(parents=True, exist_ok=True)
    results = run_jobs(options.seeds, options.images, options.jobs)
    images = os.path.relpath(options.images, options.out.parent).replace(os.sep, "/")
    options.out.write_text(write_page(results, options.seeds, images), encoding="utf-8")
    print(f"page: {options.out}")
    return 0


def run_jobs(seeds: int, images: Path, processes: int) -> dict[str, object]:
    """Return the results of all parts by name, and print each part as it ends."""
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(variable, "1")  # the threads of several processes would wait for each other
    results, began = dict[str, object](), time.monotonic()
    tasks = [(name, seeds, images) for name in jobs()]
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        for name, result in pool.imap_unordered(do_job, tasks):
            results[name] = result
            print(f"{time.monotonic() - began:5.1f} s  {len(results):2} of {len(tasks)}  {name}", flush=True)
    return results


if __name__ == "__main__":
    sys.exit(main())

"""Study transfer functions by Monte Carlo: `python -m studies.black_box --out results/black_box.md`."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from studies import process_confidence, real_processes
from studies.sections import Page, by_name

STUDIES = by_name(real_processes.STUDY, process_confidence.STUDY)
SEEDS = 100
PARTS = {"process-confidence": 0.1}
INTRODUCTION = """\
Transfer functions from input and output alone, no parameter known. The records are simulated exactly for a held input
and start at rest; the methods do not know that. Each table states how many runs it has."""
PAGE = Page("black_box", "Transfer functions as a black box", INTRODUCTION, STUDIES, SEEDS, PARTS)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study, write the page, and return the exit code."""
    return PAGE.main(__doc__, arguments)


def run(seeds: int = SEEDS, jobs: int = 2, only: Sequence[str] = tuple(STUDIES)) -> str:
    """Return the page; raise UsageError for invalid arguments.

    `seeds` >= 1 applies to each table; some tables use a fraction or a multiple.
    """
    return PAGE.run(seeds, jobs, only)


if __name__ == "__main__":
    sys.exit(main())

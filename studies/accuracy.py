"""Study all methods by Monte Carlo: `python -m studies.accuracy --out results/accuracy.md`."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from studies import open_loop, starts, stop_and_go, wrong_models
from studies.sections import Page, by_name

STUDIES = by_name(open_loop.STUDY, stop_and_go.STUDY, starts.STUDY, wrong_models.STUDY, wrong_models.CREEP)
SEEDS = 50
INTRODUCTION = """\
All on the simulated cart: 1.07 kg, 12.8 N s/m, 0.8 N, 2 N/V, T = 10 ms, filters of order 2, the default pre-filter
zeros; an encoder of 4096 increments has 22.75 µm per count. The simulation solves for stops and reversals exactly,
except where a section says otherwise. Each table states how many seeds it has."""
PAGE = Page("accuracy", "Accuracy", INTRODUCTION, STUDIES, SEEDS)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study, write the page, and return the exit code."""
    return PAGE.main(__doc__, arguments)


def run(seeds: int = SEEDS, jobs: int = 2, only: Sequence[str] = tuple(STUDIES)) -> str:
    """Return the page; raise UsageError for invalid arguments.

    `seeds` >= 1 applies to the open-loop table; the other tables use their own fraction or multiple.
    """
    return PAGE.run(seeds, jobs, only)


if __name__ == "__main__":
    sys.exit(main())

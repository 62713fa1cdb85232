"""Study: is anything confident and wrong? Six machines, their models right and wrong, motions and encoders.

`python -m studies.confidence --out results/confidence.md`
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from itertools import product
from typing import Any

import numpy as np

from pmfid.diagnostics.drives import judge
from pmfid.encoder import Encoder
from pmfid.errors import NotIdentifiableError
from pmfid.estimators.adequacy import Adequacy, weigh
from pmfid.estimators.auto import AUTO, first_choice
from pmfid.estimators.batch import BatchEstimator
from pmfid.estimators.iv import IV
from pmfid.estimators.output_error import OE, IntervalML
from pmfid.estimators.results import Fit
from pmfid.findings import codes
from pmfid.models.drive import Drive
from pmfid.status import status_names
from studies.machines import AXES, MOTIONS, WRONG, machine_record, truth
from studies.paper.truth import CartRecord, Study, Task, table, tally
from studies.sections import Page, by_name

METHODS = (AUTO, "iv", "output-error", "interval")
INCREMENTS = (4096, 512, 128, 32)
SEEDS = 100
FAR, QUANTILE = 3.0, 0.9
#: Seeds of which the scatter of one cell can be reported.
FEWEST = 8


def tasks(seeds: int) -> list[Task]:
    return list(product(AXES, WRONG, MOTIONS, INCREMENTS, range(seeds)))


def work(name: str, wrong: str, motion: str, increments: int, seed: int) -> dict[str, Any]:
    """Method -> errors over the error bars (3,), errors (3,) and bars (3,) in parts of the truth, flags."""
    axis = AXES[name]
    record, known = machine_record(axis, wrong, motion, increments, seed), truth(axis)
    settings = Drive(axis.drive.input_gain), Encoder(record.resolution), axis.dt, 1 / (3 * axis.dt)
    found: dict[str, Any] = {}
    for method, (estimator, fit, adequacy) in estimates(
        IV(*settings), OE(*settings), IntervalML(*settings), record
    ).items():
        flags = codes(judge(estimator, record.u, record.counts, fit.theta, fit.theta_std, adequacy))
        error, said = fit.theta - known, (*flags, *status_names(fit.status))
        found[method] = (error / fit.theta_std, error / known, fit.theta_std / known, said)
    return found


Found = tuple[BatchEstimator, Fit, Adequacy | None]


def estimates(iv: IV, squares: OE, interval: IntervalML, record: CartRecord) -> dict[str, Found]:
    """Method -> estimator, fit, and what the counts say on the model; without the methods that refuse. The motion that
    fits best is looked for once: it is that of three of the methods."""
    found: dict[str, Found] = {}
    best, adequacy = None, None
    with suppress(NotIdentifiableError):
        best = interval.best(record.u, record.counts)
        adequacy = weigh(best)
        found["output-error"] = squares, squares.make_least_squares_fit(best), adequacy
        found["interval"] = interval, interval.fit_of(best), adequacy
    with suppress(NotIdentifiableError):
        found["iv"] = iv, iv.fit(record.u, record.counts), adequacy
    with suppress(NotIdentifiableError):
        choice = first_choice(iv, record.u, record.counts, best)
        found[AUTO] = choice.estimator, choice.fit, choice.adequacy
    return found


def write(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    rows = [row for wrong in WRONG for method in METHODS for row in _rows(wrong, method, seeds, results)]
    return [
        "## Error over error bar",
        "",
        f"{seeds} seeds for each of {len(AXES)} machines, {len(MOTIONS)} motions and {INCREMENTS} increments; "
        "Tf = 3 T. Refused: no estimate. Silent: a parameter off by more than "
        f"{FAR:g} error bars without a flag. Cells: of one machine, motion and encoder, in which the {QUANTILE:.0%} "
        "quantile of the unflagged is beyond that. Error over bar: of all runs and parameters, half and nine tenths "
        "are below; a normal error has 0.67 and 1.64. Bar over error: median error bar over root mean square error "
        f"of the worst and the best cell and parameter, from {FEWEST} seeds on.",
        "",
        *table(
            [
                "wrong",
                "method",
                "runs",
                "refused",
                "unflagged",
                "silent",
                "cells",
                "error over bar",
                "bar over error",
                "flags",
            ],
            rows,
        ),
    ]


def _rows(wrong: str, method: str, seeds: int, results: Mapping[Task, Any]) -> list[list[str]]:
    runs = refused = unflagged = silent = bad = 0
    ratios: list[float] = []
    sizes: list[float] = []
    flags: list[Sequence[str]] = []
    for axis in AXES:
        for motion in MOTIONS:
            for increments in INCREMENTS:
                cell = [results[axis, wrong, motion, increments, seed].get(method) for seed in range(seeds)]
                there = [run for run in cell if run is not None]
                quiet = [float(np.max(np.abs(z))) for z, _, _, said in there if not said]
                runs, refused = runs + len(cell), refused + len(cell) - len(there)
                unflagged, silent = unflagged + len(quiet), silent + sum(z > FAR for z in quiet)
                bad += bool(quiet) and float(np.quantile(quiet, QUANTILE)) > FAR
                flags += [said for *_, said in there]
                sizes += [float(size) for z, *_ in there for size in np.abs(z)]
                if len(there) >= FEWEST:
                    error = np.sqrt(np.mean([run[1] ** 2 for run in there], axis=0))
                    ratios += list(np.median([run[2] for run in there], axis=0) / error)
    span = f"{min(ratios):.2g} to {max(ratios):.2g}" if ratios else "–"
    counts = [str(number) for number in (runs, refused, unflagged, silent, bad)]
    usual = f"{np.median(sizes):.2f}, {np.quantile(sizes, QUANTILE):.2f}" if sizes else "–"
    return [[wrong, f"`{method}`", *counts, usual, span, tally(flags)]]


STUDY = Study("confidence", tasks, work, write)
INTRODUCTION = """\
A small error bar with no flag on a wrong number is the worst that an estimator can do. Six machines that differ in
everything, simulated with the model's friction and with what it lacks: friction larger at rest, more than linear at
speed, different by direction, and a dead time of the input."""
PAGE = Page("confidence", "Confidence", INTRODUCTION, by_name(STUDY), SEEDS)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the study and writes the page; returns the exit code."""
    return PAGE.main(__doc__, arguments)


if __name__ == "__main__":
    sys.exit(main())

"""Study: do the intervals with model spread cover, and are they short where the model is right?

`python -m studies.model_spread --out results/model_spread.md`
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

from pmfid.diagnostics.drives import examine_estimate
from pmfid.diagnostics.tuning import TUNING
from pmfid.diagnostics.verdict import model_spread
from pmfid.encoder import Encoder
from pmfid.estimators.auto import AUTO
from pmfid.estimators.iv import IV
from pmfid.estimators.output_error import OE, IntervalML
from pmfid.models.drive import Drive
from pmfid.types import Floats
from studies.confidence import estimates
from studies.friction_axes import BENCHES, FRICTIONS, HELD_BACK
from studies.machines import MOTIONS, record_of, truth
from studies.paper.truth import CartRecord, Study, Task, table, triple
from studies.said import SAID
from studies.sections import Page, by_name

METHODS = (AUTO, "iv", "output-error", "interval")
INCREMENTS = (4096, 1024, 128)
SEEDS = 8
#: The constants of the model spread were chosen on seed 0 of three machines: the study begins after it.
FIRST_SEED = 100
NOTHING = "nothing"
#: Times the actual error that an interval may be long where the model is right.
LONG = 3.0


def wrong_tasks(seeds: int) -> list[Task]:
    return _tasks([name for name in FRICTIONS if name != NOTHING], seeds)


def right_tasks(seeds: int) -> list[Task]:
    return _tasks([NOTHING], seeds)


def _tasks(frictions: Iterable[str], seeds: int) -> list[Task]:
    return list(product(BENCHES, frictions, MOTIONS, INCREMENTS, range(FIRST_SEED, FIRST_SEED + seeds)))


def work(bench: str, friction: str, motion: str, increments: int, seed: int) -> dict[str, Any]:
    """Method -> error, standard deviation, model spread, each (3,) in parts of the truth."""
    axis = BENCHES[bench]
    record, known = record_of(axis, FRICTIONS[friction](axis), motion, increments, seed), truth(axis)
    return {method: tuple(part / known for part in parts) for method, parts in _estimated(axis, record, known).items()}


def _estimated(axis: Any, record: CartRecord, known: Floats) -> dict[str, tuple[Floats, Floats, Floats]]:
    settings = Drive(axis.drive.input_gain), Encoder(record.resolution), axis.dt, 1 / (3 * axis.dt)
    found = {}
    for method, (estimator, fit, adequacy) in estimates(
        IV(*settings), OE(*settings), IntervalML(*settings), record
    ).items():
        known_model = examine_estimate(estimator, record.u, record.counts, fit.theta, adequacy)
        spread = np.full(fit.theta.size, np.nan)
        if known_model is not None:
            spread = model_spread(estimator, record.u, record.counts, fit.theta, fit.theta_std, known_model)
        found[method] = (fit.theta - known, fit.theta_std, spread)
    return found


def write_wrong(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    rows = []
    for held_back in (False, True):
        for friction in [name for name in FRICTIONS if name != NOTHING]:
            rows += [_wrong_row(friction, method, held_back, results) for method in METHODS]
    return [
        "## Friction that the model lacks",
        "",
        f"{len(BENCHES)} machines, {len(MOTIONS)} motions, {INCREMENTS} increments, seeds: {seeds}. Held back: those "
        f"on which no constant was chosen ({', '.join(HELD_BACK)}). Covered: runs in percent whose 95 % interval "
        "contains the parameter of the machine's own equation, by mass, viscous and Coulomb friction, and for all "
        "three at once; in brackets with the standard deviation alone. Length: half the interval over the actual "
        "error, median.",
        "",
        *table(
            ["machines", "friction", "method", "runs", "covered [%]", "all three [%]", "length"],
            rows,
        ),
    ]


def _wrong_row(friction: str, method: str, held_back: bool, results: Mapping[Task, Any]) -> list[str]:
    runs = [
        result.get(method)
        for (bench, what, *_), result in results.items()
        if what == friction and (bench in HELD_BACK) == held_back
    ]
    error, std, spread = _stacked([run for run in runs if run is not None])
    both, alone = (np.abs(error) <= TUNING.normal_95 * bar for bar in (np.hypot(std, spread), std))
    length = np.median(TUNING.normal_95 * np.hypot(std, spread) / np.abs(error), axis=0)
    return [
        "held back" if held_back else "others",
        friction,
        f"`{method}`",
        str(len(error)),
        triple(100 * both.mean(axis=0), (0, 0, 0), ""),
        f"{100 * both.all(axis=1).mean():.0f} ({100 * alone.all(axis=1).mean():.0f})",
        triple(length, (1, 1, 1), ""),
    ]


def _stacked(runs: Sequence[Sequence[Floats]]) -> tuple[Floats, Floats, Floats]:
    error, std, spread = (np.array([run[i] for run in runs]).reshape(-1, 3) for i in range(3))
    return error, std, spread


def write_right(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    rows = [_right_row(method, held_back, results) for held_back in (False, True) for method in METHODS]
    return [
        "## Where the model is right",
        "",
        f"The same machines, motions and encoders, {seeds} seeds. Length: half the interval, median over the seeds, "
        f"over {TUNING.normal_95} times the root mean square error over the seeds, so that 1 is an interval of "
        "just the size "
        "of the error; of the cells of machine, motion and encoder half are below the first number and nine tenths "
        "below the second, by mass, viscous and Coulomb friction. Cells: part of them in which it is at most "
        f"{LONG:g}. Coverage as above.",
        "",
        *table(
            ["machines", "method", "runs", "covered [%]", "all three [%]", "length, half", "nine tenths", "cells [%]"],
            rows,
        ),
    ]


def _right_row(method: str, held_back: bool, results: Mapping[Task, Any]) -> list[str]:
    cells: dict[tuple[object, ...], list[Any]] = {}
    for (bench, _, motion, increments, _), result in results.items():
        if (bench in HELD_BACK) == held_back and method in result:
            cells.setdefault((bench, motion, increments), []).append(result[method])
    lengths, inside = [], []
    for runs in cells.values():
        error, std, spread = _stacked(runs)
        half = TUNING.normal_95 * np.hypot(std, spread)
        inside.append(np.abs(error) <= half)
        lengths.append(np.median(half, axis=0) / (TUNING.normal_95 * np.sqrt(np.mean(error**2, axis=0))))
    length, covered = np.array(lengths), np.concatenate(inside)
    return [
        "held back" if held_back else "others",
        f"`{method}`",
        str(len(covered)),
        triple(100 * covered.mean(axis=0), (0, 0, 0), ""),
        f"{100 * covered.all(axis=1).mean():.0f}",
        triple(np.median(length, axis=0), (1, 1, 1), ""),
        triple(np.quantile(length, 0.9, axis=0), (1, 1, 1), ""),
        triple(100 * np.mean(length <= LONG, axis=0), (0, 0, 0), ""),
    ]


INTRODUCTION = """\
Every estimate of a machine has two error bars. `std` is for what varies: repeat the experiment, and the value scatters
by so much. `model_spread` is for what does not vary: friction, a load or a dead time that the machine has and the
model has not moves the value by the same amount in every record. `interval_95` is for both.

## How to read it

- **Where the model spread is below the std**, the record has shown that the model is enough, for the purpose of these
  parameters: a longer record makes the interval shorter.
- **Where it is above**, a longer record helps little. A finer encoder or a richer motion shows more of what there may
  be, and a model with the force that the notes name takes it out.
- **The flag `unmodelled`** says that the counts contradict the model. The parameters are then those of no equation; the
  model spread is made of the forces that the counts ask for, of another method, and of the parts of the record (halves,
  slow and fast, forward and backward), whichever is largest. It says how wrong the number may be, not which number is
  right: set the term that is missing, and the number moves, mostly by less than this.
- **The note `model_spread`** is more cautious than the number: it is there where a force as large as machines well may
  have, and the record would not show, moves a parameter by more than its std. The number weighs each force by how
  likely the record leaves it.
- **The interval is of the machine's own parameters**: mass, and the friction of the equation's terms next to what it
  lacks. Of Coulomb friction next to Stribeck friction that is the level to which it falls.
- **What nothing here can see**: a wrong input gain scales every parameter alike and leaves no trace in any motion; no
  interval contains that. Nor is there anything in it for a force that none of those in
  `pmfid/estimators/adequacy.py` resembles and the counts do not show.
- **null, or a dash**: not known, where no motion of the model can be simulated.
"""
PAGE = Page(
    "model_spread",
    "Model spread",
    INTRODUCTION,
    by_name(
        Study("wrong", wrong_tasks, work, write_wrong),
        Study("right", right_tasks, work, write_right),
        SAID,
    ),
    SEEDS,
    {"wrong": 1 / 8, "said": 1 / 8},
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the study and writes the page; returns the exit code."""
    return PAGE.main(__doc__, arguments)


if __name__ == "__main__":
    sys.exit(main())

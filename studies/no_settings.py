"""Study fourteen real axes without a setting of the estimator: bias, coverage, and status.

`python -m studies.no_settings --out results/no_settings.md`
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

import pmfid
from pmfid.diagnostics.tuning import TUNING
from pmfid.errors import NotIdentifiableError
from pmfid.estimators import Method
from pmfid.simulation import Machine
from studies.machines import MOTIONS, record_of, truth
from studies.paper.truth import Study, Task, table, triple
from studies.real_axes import REAL
from studies.sections import Page, by_name

METHODS: tuple[Method, ...] = ("auto", "iv", "bcls", "ls", "riv", "bcrls")
#: Factors that make the axis's encoder coarser.
COARSER = (1, 16)
SEEDS = 4
FIRST_SEED = 300
#: Number of combined error bars beyond which an estimate is wrong.
WRONG = 3.0
#: Relative error below which a too small error bar does not matter.
SMALL = 1e-3


def tasks(seeds: int) -> list[Task]:
    return list(product(REAL, MOTIONS, COARSER, range(FIRST_SEED, FIRST_SEED + seeds)))


def work(name: str, motion: str, coarser: int, seed: int) -> dict[str, Any]:
    """Return by method the errors, standard deviations and model spreads (3,), relative to the truth, and flags.

    None means that the method refuses the record.
    """
    axis = REAL[name]
    record, known = record_of(axis, Machine(axis.drive), motion, 4096 // coarser, seed), truth(axis)
    model, encoder = pmfid.Drive(axis.drive.input_gain), pmfid.Encoder(record.resolution)
    found: dict[str, Any] = {}
    for method in METHODS:
        try:
            result = pmfid.identify(record.u, record.counts, method=method, model=model, encoder=encoder, dt=axis.dt)
        except NotIdentifiableError:
            found[method] = None
            continue
        spread = np.nan_to_num(np.asarray(result.model_spread, dtype=np.float64))
        found[method] = (result.theta / known - 1, result.theta_std / known, spread / known, result.status)
    return found


def write(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    lines = [
        f"{len(REAL)} axes, {len(MOTIONS)} motions, the encoder of the axis and one {COARSER[1]} times coarser, "
        f"{seeds} seeds. Error: root mean square over the runs with an estimate, and its median, of mass, viscous and "
        "Coulomb friction in percent. Covered: runs whose 95 % interval contains the parameter, in brackets with the "
        f"standard deviation alone. Wrong: a parameter further off than {WRONG:g} of both bars together, and by more "
        f"than {100 * SMALL:g} %; without a word: of these with an empty status.",
        "",
    ]
    for coarser in COARSER:
        of = "The encoder of the axis" if coarser == 1 else f"{coarser} times coarser"
        rows = [_row(method, motion, coarser, results) for motion in MOTIONS for method in METHODS]
        header = ["motion", "method", "refused", "median error [%]", "rms [%]", "covered [%]", "wrong", "unsaid"]
        lines += [f"## {of}", "", *table(header, rows)]
    return [*lines, *_worst(results)]


def _runs(method: str, motion: str, coarser: int, results: Mapping[Task, Any]) -> list[Any]:
    return [found[method] for (_, moved, by, _), found in results.items() if (moved, by) == (motion, coarser)]


def _row(method: str, motion: str, coarser: int, results: Mapping[Task, Any]) -> list[str]:
    runs = _runs(method, motion, coarser, results)
    found = [run for run in runs if run is not None]
    if not found:
        return [motion, f"`{method}`", f"{len(runs)}/{len(runs)}", "–", "–", "–", "–", "–"]
    error, std, spread = (np.array([run[i] for run in found]) for i in range(3))
    both, alone = (np.abs(error) <= TUNING.normal_95 * bar for bar in (np.hypot(std, spread), std))
    wrong = [run for run in found if _wrong(run)]
    return [
        motion,
        f"`{method}`",
        f"{len(runs) - len(found)}/{len(runs)}",
        triple(100 * np.median(np.abs(error), axis=0), (3, 2, 2), ""),
        triple(100 * np.sqrt(np.mean(error**2, axis=0)), (3, 2, 2), ""),
        f"{triple(100 * both.mean(axis=0), (0, 0, 0), '')} ({triple(100 * alone.mean(axis=0), (0, 0, 0), '')})",
        str(len(wrong)),
        str(sum(not run[3] for run in wrong)),
    ]


def _wrong(run: Any) -> bool:
    error, std, spread, _ = run
    return bool(np.any((np.abs(error) > WRONG * np.hypot(std, spread)) & (np.abs(error) > SMALL)))


def _worst(results: Mapping[Task, Any]) -> list[str]:
    rows = [
        [*map(str, task), f"`{method}`", triple(100 * run[0], (3, 2, 2), ""), ", ".join(run[3]) or "nothing"]
        for task, found in results.items()
        for method, run in found.items()
        if run is not None and _wrong(run)
    ]
    header = ["axis", "motion", "coarser", "seed", "method", "error [%]", "said"]
    return ["## Every wrong run", "", *(table(header, rows) if rows else ["None."])]


INTRODUCTION = """\
Nothing but the encoder's resolution, the sample period and the input's gain is given: `pmfid.identify` without
`cutoff`, method by method. The axes are in `studies/real_axes.py`, from a mirror of 1e-5 kg m2 every 0.1 ms to a crane
of 500 kg every 20 ms.
"""
PAGE = Page("no_settings", "Axes without settings", INTRODUCTION, by_name(Study("axes", tasks, work, write)), SEEDS)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study, write the page, and return the exit code."""
    return PAGE.main(__doc__, arguments)


if __name__ == "__main__":
    sys.exit(main())

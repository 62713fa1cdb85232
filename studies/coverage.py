"""Accuracy study: do the error bars cover the truth, and does the judgement find those that do not?"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from studies.paper.truth import SLOW, TRUTH, Study, Task, estimate, scenario_record, table, tally

CONDITIONS = tuple((name, inc) for name in ("prbs", "stop-and-go") for inc in (1024, 256))
METHODS = ("iv", "known-step", "bcls", *SLOW)
#: The judgement of the others runs iv itself, which takes most of the time.
CHEAP_JUDGEMENT = ("iv",)
RUNS_PER_SEED = 10
QUANTILE = 1.96


def judged_runs(method: str, seeds: int) -> int:
    return (
        RUNS_PER_SEED * seeds if method in CHEAP_JUDGEMENT else 2 * seeds if method not in SLOW else max(1, seeds // 2)
    )


def runs(method: str, seeds: int) -> int:
    return judged_runs(method, seeds) if method in SLOW else RUNS_PER_SEED * seeds


def tasks(seeds: int) -> list[Task]:
    return [
        (*condition, seed, tuple(method for method in METHODS if seed < runs(method, seeds)), seeds)
        for condition in CONDITIONS
        for seed in range(RUNS_PER_SEED * seeds)
    ]


def work(scenario: str, increments: int, seed: int, methods: tuple[str, ...], seeds: int) -> dict[str, Any]:
    """For each method: which parameters' intervals cover the truth (3,), the flags or None, the failure."""
    record = scenario_record(scenario, seed, increments)
    result = {}
    for method in methods:
        judged = seed < judged_runs(method, seeds)
        outcome = estimate(method, record, judged=judged)
        covered = np.abs(outcome.theta - TRUTH) < QUANTILE * outcome.std
        result[method] = (covered, outcome.flags if judged else None, outcome.failure)
    return result


def write(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    rows = []
    for condition in CONDITIONS:
        found = [result for task, result in results.items() if task[:2] == condition]
        for method in METHODS:
            outcomes = [result[method] for result in found if method in result]
            rows.append([f"{condition[0]}, {condition[1]}", f"`{method}`", *_cells(outcomes)])
    few = [f"`{m}` {runs(m, seeds)} runs, {judged_runs(m, seeds)} judged" for m in METHODS]
    scatter = 100 * np.sqrt(0.95 * 0.05 / (RUNS_PER_SEED * seeds))
    return [
        "## Coverage of the 95 % intervals",
        "",
        f"Percent of runs with |estimate - truth| < {QUANTILE} std, mass, viscous and Coulomb friction; Tf = 3 T, "
        f"forgetting 1. 95 is right; with {RUNS_PER_SEED * seeds} runs it scatters by {scatter:.1f}. Flags are those "
        f"of `pmfid.diagnostics.drives.judge`. For each condition: {'; '.join(few)}. On stop-and-go the seeds differ "
        "in the start phase on the lattice alone.",
        "",
        *table(
            [
                "condition",
                "method",
                "runs",
                "coverage [%]",
                "judged",
                "flagged [%]",
                "flags",
                "unflagged",
                "coverage of the unflagged [%]",
            ],
            rows,
        ),
    ]


def _cells(outcomes: list[Any]) -> list[str]:
    judged = [outcome for outcome in outcomes if outcome[1] is not None]
    clean = [outcome for outcome in judged if not outcome[1] and not outcome[2]]
    flagged = 100 * (1 - len(clean) / len(judged)) if judged else np.nan
    names = [[*outcome[1], *([outcome[2]] if outcome[2] else [])] for outcome in judged]
    return [
        str(len(outcomes)),
        _coverage(outcomes),
        str(len(judged)),
        f"{flagged:.0f}",
        tally(names),
        str(len(clean)),
        _coverage(clean),
    ]


def _coverage(outcomes: list[Any]) -> str:
    if not outcomes:
        return "–"
    return ", ".join(f"{100 * part:.1f}" for part in np.mean([outcome[0] for outcome in outcomes], axis=0))


STUDY = Study("coverage", tasks, work, write)

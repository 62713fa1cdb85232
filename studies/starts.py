"""Accuracy study of wrong starts from which the methods with an auxiliary model converge."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pmfid.simulation import CART_DT
from pmfid.status import Status
from studies.paper.truth import (
    NAMES,
    TRUTH,
    CartRecord,
    Study,
    Task,
    estimate,
    percent,
    scenario_record,
    table,
    track_of,
    vouched,
)

CONDITIONS = tuple((name, inc) for name in ("stop-and-go", "prbs") for inc in (1024, 256))
FACTORS = (0.25, 0.5, 2.0, 4.0)
WRONG = (*NAMES, "all")
STARTS = (("none given", 1.0), ("none wrong", 1.0), *((name, factor) for name in WRONG for factor in FACTORS))
FORGETTING = 0.99
MOST_SEEDS = 5
WITHIN = np.array([1.0, 1.0, 4.0])  # [%]
ASTRAY = np.array([5.0, 5.0, 20.0])  # [%]
END = 10.0  # [s]


def tasks(seeds: int) -> list[Task]:
    count = min(seeds, MOST_SEEDS)
    return [(*condition, *start, seed) for condition in CONDITIONS for start in STARTS for seed in range(count)]


def work(scenario: str, increments: int, wrong: str, factor: float, seed: int) -> dict[str, Any]:
    """Return the ends of iv and riv, and the status of riv until it stayed within 5, 5, 20 %."""
    record = scenario_record(scenario, seed, increments)
    initial = start_of(wrong, factor)
    outcome = estimate("iv", record, initial=initial)
    good = bool(np.all(np.abs(percent(outcome.theta)) < WITHIN))
    return {"iv": good, "iv failure": outcome.failure, **_riv(record, initial)}


def start_of(wrong: str, factor: float) -> dict[str, float] | None:
    """Return the start parameters: the truth, with some parameters multiplied by the factor."""
    if wrong == "none given":
        return None
    return {
        name: float(value) * (factor if wrong in (name, "all") else 1.0)
        for name, value in zip(NAMES, TRUTH, strict=True)
    }


def _riv(record: CartRecord, initial: dict[str, float] | None) -> dict[str, Any]:
    track = track_of("riv", record, forgetting=FORGETTING, initial=initial)
    error = percent(track.theta)
    astray = np.any(~(np.abs(error) < ASTRAY), axis=1)
    until = int(np.flatnonzero(astray)[-1]) + 1 if astray.any() else 0
    early = track.status[:until]
    starting = (early & (Status.STARTING | Status.SETTLING)) != 0
    fallback = ~starting & ((early & Status.FALLBACK) != 0)
    return {
        "riv": bool(np.all(np.abs(error[-round(END / CART_DT) :].mean(axis=0)) < WITHIN)),
        "until": until * CART_DT,
        "starting": float(starting.sum()) * CART_DT,
        "fallback": float(fallback.sum()) * CART_DT,
        "unsaid": float((astray & vouched(track)).sum()) * CART_DT,
    }


def write(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    count = min(seeds, MOST_SEEDS)
    lines = [
        "## How wrong a start may be",
        "",
        f'Each parameter of `initial` wrong by a factor, alone and all together; "none given": no `initial` at all. '
        f"{count} seeds, Tf = 3 T. `iv` is off-line; `riv` has forgetting {FORGETTING}. Ends within 1/1/4 % of mass, "
        f"viscous and Coulomb friction: `iv` its result, `riv` its mean over the last {END:g} s. Astray: more than "
        "5/5/20 % wrong. Last astray: end of the last such sample (worst seed); until then seconds with the status "
        "starting or settling, and with fallback (mean over the seeds). Astray and unsaid: seconds astray without any "
        "status bit that warns (starting, settling, fallback, poor excitation, unmodelled), worst seed.",
        "",
    ]
    for condition in CONDITIONS:
        rows = []
        for start in STARTS:
            runs = [results[(*condition, *start, seed)] for seed in range(count)]
            rows.append([start[0] if start[0].startswith("none") else f"{start[0]} × {start[1]:g}", *_cells(runs)])
        header = ["start", "iv", "riv", "last astray [s]", "starting [s]", "fallback [s]", "astray and unsaid [s]"]
        lines += [f"{condition[0]}, {condition[1]} increments:", "", *table(header, rows)]
    return lines


def _cells(runs: list[dict[str, Any]]) -> list[str]:
    failures = [run["iv failure"] for run in runs if run["iv failure"]]
    return [
        f"{sum(run['iv'] for run in runs)}/{len(runs)}" + (f" ({len(failures)} without result)" if failures else ""),
        f"{sum(run['riv'] for run in runs)}/{len(runs)}",
        f"{max(run['until'] for run in runs):.2f}",
        f"{np.mean([run['starting'] for run in runs]):.2f}",
        f"{np.mean([run['fallback'] for run in runs]):.2f}",
        f"{max(run['unsaid'] for run in runs):.2f}",
    ]


STUDY = Study("starts", tasks, work, write)

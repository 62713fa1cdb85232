"""Accuracy study: stop-and-go under position control through the encoder."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pmfid.simulation import CART_DT
from pmfid.status import Status
from pmfid.types import Floats
from studies.paper.truth import SLOW, Study, Task, estimate, percent, scenario_record, table, track_of, triple

TIME_CONSTANTS = (3, 5)
INCREMENTS = (4096, 2048, 1024, 512, 256, 128, 64)
METHODS = ("riv", "bcrls", "rls")
START = {"mass": 0.8, "viscous_friction": 10.0, "coulomb_friction": 0.3}
FORGETTING = 0.99
AFTER = 10.0  # [s]
MOST_SEEDS = 20
SLOW_SEEDS = 3


def tasks(seeds: int) -> list[Task]:
    count = min(seeds, MOST_SEEDS)
    return [(tc, inc, seed) for tc in TIME_CONSTANTS for inc in INCREMENTS for seed in range(count)]


def work(time_constant: int, increments: int, seed: int) -> dict[str, dict[str, Any]]:
    """Return errors in percent (k, 3) and the fraction of fallback samples. Off-line methods have k = 1."""
    record = scenario_record("stop-and-go", seed, increments)
    result: dict[str, dict[str, Any]] = {}
    slow = SLOW if seed < SLOW_SEEDS and time_constant == TIME_CONSTANTS[0] else ()
    for method in ("iv", *slow):
        options: dict[str, Any] = {"initial": START} if method == "iv" else {}
        result[method] = {"error": percent(estimate(method, record, time_constant, **options).theta)[None]}
    for method in METHODS:
        options = {"initial": START} if method == "riv" else {}
        track = track_of(method, record, time_constant, forgetting=FORGETTING, **options)
        late = round(AFTER / CART_DT)
        fallback = track.has_status(Status.FALLBACK)
        result[method] = {
            "error": percent(track.theta[late:]),
            "late": 100 * float(fallback[late:].mean()),
            "early": 100 * float(fallback[:late].mean()),
        }
    return result


def write(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    count = min(seeds, MOST_SEEDS)
    rows = []
    for tc in TIME_CONSTANTS:
        for inc in INCREMENTS:
            runs = [results[tc, inc, seed] for seed in range(count)]
            kept = {method: [run[method] for run in runs if method in run] for method in runs[0]}
            rows += [[f"{tc} T", str(inc), f"`{method}`", *_cells(found)] for method, found in kept.items()]
    start = ", ".join(f"{name} {value:g}" for name, value in START.items())
    few = f" {', '.join(SLOW)}: {min(count, SLOW_SEEDS)} seeds, Tf = {TIME_CONSTANTS[0]} T." if SLOW else ""
    return [
        "## Stop-and-go under position control through the encoder",
        "",
        f"Moves of 0.2 m in 0.8 s, dwells of 0.5 s, 30 s, {count} seeds (the seed is the start phase on the encoder's "
        f"lattice). `iv` is off-line, over the whole record; the others are recursive with forgetting {FORGETTING}, "
        f"all samples after {AFTER:g} s of all seeds. `iv` and `riv` start from {start}. Errors of mass, viscous and "
        "Coulomb friction in percent of the truth; std: scatter about that mean; largest: the worst single sample. "
        f"fallback: part of the samples with that status after {AFTER:g} s (and before).{few}",
        "",
        *table(["Tf", "increments", "method", "mean [%]", "std [%]", "largest [%]", "fallback [%]"], rows),
    ]


def _cells(runs: list[dict[str, Any]]) -> list[str]:
    error: Floats = np.concatenate([run["error"] for run in runs])
    fallback = "–"
    if "late" in runs[0]:
        late, early = (np.mean([run[part] for run in runs]) for part in ("late", "early"))
        fallback = f"{late:.1f} ({early:.1f})"
    largest = np.max(np.abs(error), axis=0)
    return [triple(error.mean(axis=0)), triple(error.std(axis=0), sign=""), triple(largest, sign=""), fallback]


STUDY = Study("stop-and-go", tasks, work, write)

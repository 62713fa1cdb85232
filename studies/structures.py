"""Study of the search for poles, zeros and dead time on the three plants."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pmfid.linear.experiment import Experiment
from pmfid.linear.order import DELAYS, ORDERS, search_structure
from pmfid.simulation.process import PLANTS, simulate_process
from studies.paper.truth import Study, Task, table

#: Ratio of the powers of output and noise.
SNR = 100.0
GOAL = 0.9


def tasks(seeds: int) -> list[Task]:
    return [(name, seed) for name in PLANTS for seed in range(seeds)]


def work(name: str, seed: int) -> tuple[tuple[int, int, int], tuple[int, int, int], float, int]:
    """Return the structures of the two best candidates, the difference of their criteria, and the number of fits."""
    plant, rng = PLANTS[name], np.random.default_rng(seed)
    u = np.roll(plant.u, rng.integers(plant.u.size))
    y = simulate_process(plant.b, plant.a, u, plant.dt)
    y = y + np.std(y) / np.sqrt(SNR) * rng.standard_normal(y.size)
    found = search_structure([Experiment(u, y, dt=plant.dt)], plant.cutoff).candidates
    first, second = found[:2]
    places = [(candidate.n, candidate.m, candidate.delay) for candidate in (first, second)]
    return places[0], places[1], second.bic - first.bic, len(found)


def write(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    rows, least = [], 1.0
    for name, plant in PLANTS.items():
        runs = [results[name, seed] for seed in range(seeds)]
        truth = (len(plant.a) - 1, len(plant.b) - 1, 0)
        hits = [run for run in runs if run[0] == truth]
        others = sorted({run[0] for run in runs if run[0] != truth})
        least = min(least, len(hits) / seeds)
        rows.append(
            [
                name,
                str(truth),
                f"{len(hits)}/{seeds}",
                "; ".join(str(place) for place in others) or "–",
                f"{np.median([run[2] for run in hits]):.1f}" if hits else "–",
                f"{np.mean([run[3] for run in runs]):.0f}",
            ]
        )
    verdict = "met" if least >= GOAL else "**not met**"
    return [
        "## Order and dead time",
        "",
        f"`pmfid terms` over n = {ORDERS[0]} to {ORDERS[-1]}, m = 0 to n - 1, delay {DELAYS[0]} to {DELAYS[-1]}, 90 "
        f"structures; white noise at {10 * np.log10(SNR):g} dB, {seeds} runs of each plant. First: how often the true "
        "structure has the best criterion; instead: what was first otherwise; apart: median of its lead over the "
        "second that settled; fitted: structures that were, the others cannot win.",
        "",
        *table(["plant", "(n, m, delay)", "first", "instead", "apart", "fitted"], rows),
        f"Check, first in at least {GOAL:.0%} of the runs: {verdict}; the least is {least:.0%}.",
        "",
    ]


STUDY = Study("structures", tasks, work, write)

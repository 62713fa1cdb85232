"""Study of the efficiency of `srivc` with white noise, over enough runs to exclude chance."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pmfid.simulation.process import PLANTS
from pmfid.types import Floats
from studies.paper.truth import Study, Task, table
from studies.processes import cramer_rao, efficiencies, last_estimate, model_of, noisy_record

METHOD = "srivc"
GOAL = 0.9
#: First seed of the section on efficiency. The runs differ from those of the other tables.
FIRST = 10_000


def tasks(seeds: int) -> list[Task]:
    return [(name, seed) for name in PLANTS for seed in range(FIRST, FIRST + seeds)]


def work(name: str, seed: int) -> dict[str, Floats]:
    """Return theta of `srivc` and the bound, in the form of `processes.work`."""
    plant = PLANTS[name]
    record = noisy_record(plant, "white", seed)
    return {METHOD: last_estimate(METHOD, model_of(plant), plant, record), "bound": cramer_rao(plant, record)}


def write(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    found = {
        name: efficiencies([results[name, seed] for seed in range(FIRST, FIRST + seeds)], METHOD, plant)
        for name, plant in PLANTS.items()
    }
    rows = [
        [
            name,
            ", ".join(f"{n} {value:.2f}" for n, value in zip(model_of(plant).equation.names, found[name], strict=True)),
        ]
        for name, plant in PLANTS.items()
    ]
    least = min(float(np.min(values)) for values in found.values())
    verdict = "met" if least >= GOAL else "**not met**"
    return [
        "## Efficiency of `srivc` over more runs",
        "",
        f"Cramér-Rao bound over the mean square error with white noise as above, {seeds} other runs of each plant: "
        f"each figure is uncertain by {100 * np.sqrt(2 / seeds):.0f} %.",
        "",
        *table(["plant", "efficiency"], rows),
        f"- At least {GOAL:g} for every parameter: {verdict}; the least is {least:.2f}.",
        "",
    ]


STUDY = Study("efficiency", tasks, work, write)

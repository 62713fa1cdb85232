"""Study of a measured cart on a belt, in which each record is predicted from another record."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pmfid.models.drive import Drive
from studies.paper.truth import Study, Task, table
from studies.predicted import METHODS, Motion, predicted

FOLDER = Path(__file__).parents[2] / "shared" / "data" / "real" / "cart_relay"
NEWTON_PER_AMPERE, RESOLUTION, CUTOFF = 3.3357, 8.8e-5, 30.0
MODELS: Mapping[str, Drive] = {
    "symmetric": Drive(NEWTON_PER_AMPERE),
    "symmetric, offset": Drive(NEWTON_PER_AMPERE, offset=True),
    "directional": Drive(NEWTON_PER_AMPERE, friction="directional"),
}


def tasks(seeds: int) -> list[Task]:
    names = sorted(path.name for path in FOLDER.glob("*.csv"))[::2]
    return [(name, model, method) for name in names for model in MODELS for method in METHODS]


def measured(name: str) -> Motion:
    """Return a record without its first row, which precedes the second by a tenth of a millisecond."""
    t, current, position, _ = np.loadtxt(FOLDER / name, delimiter=",")[1:].T
    dt = float(t[-1] - t[0]) / (t.size - 1)
    return Motion(current, np.floor(position / RESOLUTION + 1e-6).astype(np.int64), RESOLUTION, dt)


def work(name: str, model: str, method: str) -> list[list[float]]:
    """Return the errors [m] over the other records: free, and restarted every 1, 2, 5, 10 s; none without an
    estimate.
    """
    train, others = measured(name), sorted(path.name for path in FOLDER.glob("*.csv") if path.name != name)
    rows = []
    for other in others:
        answer = predicted(MODELS[model], method, CUTOFF, train, measured(other))
        if answer is None:
            return []
        rows.append([answer.run.rmse, *(part.rmse for part in answer.run.horizons)])
    return rows


def write(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    lines = ["## A cart on a belt", ""]
    if not results:
        return [*lines, "The records are not on this machine.", ""]
    rows = []
    for model in MODELS:
        for method in METHODS:
            found = [row for task, runs in results.items() if task[1:] == (model, method) for row in runs]
            errors = 1e3 * np.exp(np.mean(np.log(found), axis=0)) if found else np.zeros(0)
            rows.append([model, f"`{method}`", str(len(found)), *(f"{error:.3g}" for error in errors)])
    width = max(map(len, rows))
    heads = ["friction", "method", "pairs", "free run", *(f"every {s} s" for s in (1, 2, 5, 10))][:width]
    return [
        *lines,
        "Six records of 21 s under relay current, from every second one each of the others predicted: geometric mean "
        "of the root mean square error in mm, free over all 21 s, and restarted.",
        "",
        *table(heads, [row + ["–"] * (len(heads) - len(row)) for row in rows]),
    ]


STUDY = Study("cart", tasks, work, write)

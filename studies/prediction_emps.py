"""Study of a measured drive within one record: fitted to two thirds and simulated over the last third."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pmfid.encoder import Encoder
from pmfid.errors import PmfidError
from pmfid.models.drive import Drive
from pmfid.pipeline.arrays import search_terms
from pmfid.pipeline.terms import format_terms
from studies.paper.truth import Study, Task, table
from studies.predicted import EXPLAINED, METHODS, Motion, Predicted, free_run, predicted

EMPS = Path(__file__).parents[2] / "shared" / "data" / "emps" / "DATA_EMPS.mat"
CUTOFF, DT = 50.0, 1e-3
RESOLUTIONS = (5e-8, 1e-3)
#: Friction models; all `METHODS` predict with each of them.
MODELS: Mapping[str, Drive] = {
    "symmetric": Drive(1.0),
    "symmetric, offset": Drive(1.0, offset=True),
    "directional": Drive(1.0, friction="directional"),
}
#: A model with the terms that `pmfid terms` finds in the first two thirds, and the methods that use it.
SEARCHED, AFTERWARDS = "searched", ("output-error", "windows")
#: Least squares of the authors on the whole record, the last third included (Janot, Gautier and Brunot 2019).
PUBLISHED = {
    "symmetric, offset": np.array([95.1089, 203.5034, 20.3935, -3.1648]),
    "directional": np.array([95.1540, 166.7061, 240.4236, 20.1440, 20.6277]),
}


def tasks(seeds: int) -> list[Task]:
    if not EMPS.exists():
        return []
    published = [(resolution, model, "published") for resolution in RESOLUTIONS for model in PUBLISHED]
    searched = [(r, SEARCHED, method) for r in RESOLUTIONS for method in AFTERWARDS]
    return published + [(r, model, method) for r in RESOLUTIONS for model in MODELS for method in METHODS] + searched


def work(resolution: float, model: str, method: str) -> Predicted | None:
    whole = measured(resolution)
    cut = whole.u.size * 2 // 3
    train, test = whole.part(0, cut), whole.part(cut, whole.u.size)
    if method == "published":
        theta = PUBLISHED[model]
        return Predicted(free_run(MODELS[model], theta, CUTOFF, test), theta)
    if model == SEARCHED:
        return after_search(method, train, test)
    return predicted(MODELS[model], method, CUTOFF, train, test)


def after_search(method: str, train: Motion, test: Motion) -> Predicted | None:
    """Return the prediction with the terms that a search finds in `train`."""
    first, encoder = next(iter(MODELS.values())), Encoder(train.resolution)
    try:
        terms = search_terms(train.u, train.counts, model=first, dt=train.dt, encoder=encoder)
    except PmfidError:
        return None
    found = predicted(terms.model, method, CUTOFF, train, test)
    return found and replace(found, searched=format_terms(terms.added) or "nothing")


def measured(resolution: float) -> Motion:
    """Return the whole record with the counts of an encoder."""
    from scipy.io import loadmat

    data = loadmat(EMPS)
    counts = np.floor(data["qm"].ravel() / resolution + 1e-6).astype(np.int64)
    return Motion((data["vir"] * data["gtau"]).ravel(), counts, resolution, DT)


def write(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    lines = ["## EMPS within its record", ""]
    if not results:
        return [*lines, "The record is not on this machine.", ""]
    lines += [
        "The electro-mechanical positioning system, 24 841 samples at 1 kHz: fitted on the first two thirds, simulated "
        f"from the input alone over the last 8.28 s, which no estimate has seen but the published ones. Filters "
        f"{CUTOFF:g} rad/s. With an encoder of 1 mm everything is from its counts, the start and the errors, too. "
        f"{EXPLAINED} Errors are root mean squares in mm; every 1, 2, 5 s: restarted. The directional model has the "
        "offset as half the difference of its Coulomb frictions; with an offset of its own it is not identifiable. "
        "Searched: the symmetric model with the terms that `pmfid terms` finds in the first two thirds.",
        "",
    ]
    for resolution in RESOLUTIONS:
        rows = [
            [_named(model, results[r, model, method]), f"`{method}`", *_cells(results[r, model, method])]
            for r, model, method in sorted(results, key=lambda task: [*MODELS, SEARCHED].index(task[1]))
            if r == resolution
        ]
        lines += [f"### {resolution * 1e3:g} mm per count", ""]
        lines += table(["friction", "method", "free run", "largest", "fit %", "every 1, 2, 5 s", "window"], rows)
    return lines


def _named(model: str, found: Predicted | None) -> str:
    return f"{model}: {found.searched}" if found and found.searched else model


def _cells(found: Predicted | None) -> list[str]:
    if found is None:
        return ["no estimate", "", "", "", ""]
    run = found.run
    again = ", ".join(f"{1e3 * part.rmse:.2f}" for part in run.horizons)
    length = "; ".join(note.partition(",")[0] for note in found.notes) or "–"
    fit = "–" if run.fit is None else f"{run.fit:.2f}"
    return [f"{1e3 * run.rmse:.2f}", f"{1e3 * run.largest:.1f}", fit, again, length]


STUDY = Study("emps", tasks, work, write)

"""Study of real records: uneven spacing, missing samples, several records."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pmfid.encoder import Encoder
from pmfid.estimators.srivc import SRIVC
from pmfid.linear.experiment import Experiment
from pmfid.models.transfer_function import TransferFunction
from pmfid.simulation.process import PLANTS, SimulatedProcess, simulate_process
from pmfid.types import Floats
from studies.paper.truth import Study, Task, table

SNR = 10.0
JITTER, MISSING, RECORDS, BURSTS = 0.3, 0.1, 3, 10
#: Largest allowed root mean square error over that of the clean record.
GOAL = 1.5
CASES = ("clean", "jitter", "missing", "rows lost", "three records", "all")


def tasks(seeds: int) -> list[Task]:
    return [(name, seed) for name in PLANTS for seed in range(seeds)]


def work(name: str, seed: int) -> dict[str, Floats]:
    """Return theta (p,) of each case; all cases have the same number of instants."""
    plant, rng = PLANTS[name], np.random.default_rng(seed)
    std = float(np.std(plant.y)) / np.sqrt(SNR)
    n = plant.samples
    whole = {"clean": (1, 0.0, 0.0), "jitter": (1, JITTER, 0.0), "missing": (1, 0.0, MISSING)}
    several = {"three records": (RECORDS, 0.0, 0.0), "all": (RECORDS, JITTER, MISSING)}
    found = {}
    for case, (records, jitter, missing) in (whole | several).items():
        made = [_record(plant, n // records, jitter, missing, std, rng) for _ in range(records)]
        found[case] = _estimate(plant, made)
    found["rows lost"] = _estimate(plant, [_with_rows_lost(_record(plant, n, 0.0, 0.0, std, rng), rng)])
    return found


def _record(
    plant: SimulatedProcess, samples: int, jitter: float, missing: float, std: float, rng: np.random.Generator
) -> Experiment:
    """Return a part of the plant's input from a random place; each instant is off by up to `jitter` periods."""
    u = np.roll(plant.u, rng.integers(plant.u.size))[:samples]
    t = (np.arange(samples) + rng.uniform(-jitter, jitter, samples)) * plant.dt
    y = simulate_process(plant.b, plant.a, u, np.diff(t)) + std * rng.standard_normal(samples)
    y[rng.uniform(size=samples) < missing] = np.nan
    return Experiment(u, y, t=t)


def _with_rows_lost(record: Experiment, rng: np.random.Generator) -> Experiment:
    """Return the record with rows lost in a few bursts; the input in between is unknown."""
    kept, length = np.ones(record.u.size, bool), round(MISSING * record.u.size / BURSTS)
    for start in rng.integers(0, record.u.size - length, BURSTS):
        kept[start : start + length] = False
    return Experiment(record.u[kept], record.y[kept], t=record.times[kept])


def _estimate(plant: SimulatedProcess, records: list[Experiment]) -> Floats:
    model = TransferFunction(len(plant.a) - 1, len(plant.b) - 1)
    return SRIVC(model, Encoder(1.0), plant.dt, plant.cutoff).fit_experiments(records).theta


def write(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    lines = [
        "## Records as they come",
        "",
        f"`srivc`, white noise at {10 * np.log10(SNR):g} dB, {seeds} runs. jitter: every instant is off by up to "
        f"{JITTER:.0%} of the period; missing: {MISSING:.0%} of the output's samples are; rows lost: N rows are "
        f"not in the record at all, in {BURSTS} bursts: the input is not known there and the filters restart; three "
        f"records: {RECORDS} of a third of the length; all: jitter and missing in three records. All cases have the "
        "same number of instants. Root mean square error of each parameter in percent, and the largest ratio to that "
        "of the clean record.",
        "",
    ]
    worst = 0.0
    for name, plant in PLANTS.items():
        model = TransferFunction(len(plant.a) - 1, len(plant.b) - 1)
        rms = {case: _rms([results[name, seed][case] for seed in range(seeds)], plant) for case in CASES}
        ratio = {case: float(np.max(rms[case] / rms["clean"])) for case in CASES}
        worst = max(worst, ratio["all"])
        rows = [[case, *(f"{value:.2f}" for value in rms[case]), f"{ratio[case]:.2f}"] for case in CASES]
        lines += [f"{name}:", "", *table(["case", *model.equation.names, "ratio"], rows)]
    verdict = "met" if worst <= GOAL else "**not met**"
    return [*lines, f"Check, all at most {GOAL:g} times the error of the clean record: {verdict}; {worst:.2f}.", ""]


def _rms(runs: list[Floats], plant: SimulatedProcess) -> Floats:
    return np.asarray(np.sqrt(np.mean((100 * (np.array(runs) / plant.theta - 1)) ** 2, axis=0)))


STUDY = Study("uneven", tasks, work, write)

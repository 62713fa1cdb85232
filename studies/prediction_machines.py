"""Studies of machines with unmodelled friction, predicted on another motion; and of error bars for right models."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import Any

import numpy as np

from pmfid.encoder import Encoder
from pmfid.errors import PmfidError
from pmfid.estimators.output_error import OE
from pmfid.models.drive import Drive
from pmfid.simulation import DriveParameters, prbs, quantize, simulate_drive
from pmfid.types import Floats
from studies.machines import AXES, MOTIONS, machine_record
from studies.paper.truth import Study, Task, table
from studies.predicted import EXPLAINED, METHODS, Motion, predicted

LACKING = ("nothing", "Stribeck 30 %", "quadratic 15 %", "directional 15 %")
MACHINES = ("rotary", "stage", "gantry")
INCREMENTS = (512,)
#: Difference of the seeds between records for the estimate and for the prediction.
OTHER = 500


def tasks(seeds: int) -> list[Task]:
    return list(product(MACHINES, LACKING, MOTIONS, INCREMENTS, range(seeds)))


def work(name: str, wrong: str, motion: str, increments: int, seed: int) -> dict[str, tuple[float, float]]:
    """Return for each method the free run's misfit, 100 - fit [%], and its error relative to standstill. The error
    belongs to restarts at the shortest horizon; it is infinite without an estimate."""
    axis, found = AXES[name], {}
    model, cutoff = Drive(axis.drive.input_gain), 1 / (3 * axis.dt)
    train, test = (_motion(name, wrong, motion, increments, number) for number in (seed, seed + OTHER))
    for method in METHODS:
        answer = predicted(model, method, cutoff, train, test)
        found[method] = (np.inf, np.inf)
        if answer is not None:
            first = answer.run.horizons[0]
            found[method] = 100 - (answer.run.fit or 0.0), 100 * first.rmse / first.standstill
    return found


def _motion(name: str, wrong: str, motion: str, increments: int, seed: int) -> Motion:
    record = machine_record(AXES[name], wrong, motion, increments, seed)
    return Motion(record.u, record.counts, record.resolution, AXES[name].dt)


def write(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    encoders = ", ".join(map(str, INCREMENTS))
    lines = [
        "## Machines that lack nothing, and that the model lacks something of",
        "",
        f"{', '.join(MACHINES)} of [confidence.md](confidence.md), seen through {encoders} increments, {seeds} pair of "
        "records each: the model with symmetric friction is fitted on one and predicts another of the same kind of "
        "motion, free over all of it. Error in percent of the motion (100 less the fit), geometric mean over the "
        "machines; in brackets restarted every second, in percent of what standstill would be off by. "
        f"{EXPLAINED}",
        "",
    ]
    rows = []
    for wrong in LACKING:
        for motion in MOTIONS:
            cell = [runs for task, runs in results.items() if task[1:3] == (wrong, motion)]
            rows.append([wrong, motion, *(_cell(np.array([runs[method] for runs in cell])) for method in METHODS)])
    return [*lines, *table(["friction lacks", "motion", *(f"`{method}`" for method in METHODS)], rows)]


def _cell(values: Floats) -> str:
    """Return the geometric means of values (runs, 2), and the number of missing values."""
    there = values[np.isfinite(values[:, 0])]
    if not there.size:
        return "no estimate"
    whole, again = np.exp(np.mean(np.log(np.maximum(there, 1e-12)), axis=0))
    missing = f", {len(values) - len(there)} refused" if len(there) < len(values) else ""
    return f"{whole:.3g} ({again:.2g}){missing}"


STUDY = Study("machines", tasks, work, write)

#: Windows in filter time constants, and samples of a record.
WINDOWS, SAMPLES = (25.0, 100.0), 2000


def bar_tasks(seeds: int) -> list[Task]:
    return [
        (window, seed) for window in (*WINDOWS, "auto") for seed in range(seeds if window != "auto" else seeds // 4)
    ]


def bar_work(window: float | str, seed: int) -> Floats | None:
    """Return errors over error bars (3,) of a window on a random machine; None without an estimate. `window` is in
    filter time constants."""
    rng = np.random.default_rng([seed, 4])
    dt, mass, slow = 10 ** rng.uniform(-3.3, -1.9), 10 ** rng.uniform(-4, 2.5), rng.uniform(20.0, 120.0)
    clock, level = int(rng.integers(8, 30)), rng.uniform(0.1, 0.4)
    # force 1 N per unit at mass 1: speeds of about clock samples' acceleration
    drive = DriveParameters(mass, mass / (slow * dt), level * mass, mass)
    u = prbs(SAMPLES, clock=clock, amplitude=1.0, rng=rng) * rng.uniform(0.6, 1.0)
    x = simulate_drive(drive, u, dt).x
    resolution = float(np.std(np.diff(x))) * 10 ** rng.uniform(-2.0, 0.7)
    counts = quantize(x, resolution, resolution * rng.random())
    cutoff = 1 / (rng.uniform(2.5, 6.0) * dt)
    length: float | str = window if isinstance(window, str) else window / cutoff
    estimator = OE(Drive(mass), Encoder(resolution), dt, cutoff, window=length)
    try:
        fit = estimator.fit(u, counts)
    except PmfidError:
        return None
    truth = np.array([drive.mass, drive.viscous_friction, drive.coulomb_friction])
    return np.asarray((fit.theta - truth) / fit.theta_std)


def bar_write(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    rows = []
    for window in dict.fromkeys(task[0] for task in results):
        runs = [found for task, found in results.items() if task[0] == window]
        z = np.abs([found for found in runs if found is not None])
        share = ", ".join(f"{100 * value:.0f}" for value in np.mean(z < 2.0, axis=0))
        label = window if isinstance(window, str) else f"{window:g} Tf"
        rows.append([label, str(len(runs)), str(len(runs) - len(z)), share, f"{np.median(z):.2f}", f"{np.max(z):.1f}"])
    return [
        "## Error bars of windows where the model is right",
        "",
        f"Every run has a machine, a sample period, an encoder (0.2 to 100 counts per sample) and a filter Tf of its "
        f"own, drawn by its seed; {SAMPLES} samples under a random binary input. Inside: share of the truth within two "
        "error bars, of mass, viscous and Coulomb friction, in percent; a normal error has 95 and a median of 0.67.",
        "",
        *table(["window", "runs", "refused", "inside", "median", "largest"], rows),
    ]


BARS = Study("bars", bar_tasks, bar_work, bar_write)

"""Accuracy study of models that are wrong on purpose, and of a creep too slow for the encoder."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pmfid.estimators.registry import methods_for
from pmfid.models.drive import Drive
from pmfid.simulation import CART, CART_DT, position_control, resolution_of
from pmfid.status import Status, status_names
from studies.paper.truth import (
    SLOW,
    TRUTH,
    CartRecord,
    Outcome,
    Study,
    Task,
    estimate,
    percent,
    table,
    tally,
    track_of,
    triple,
    vouched,
)
from studies.wrong_plants import DESCRIPTIONS, KD, KP, PLANTS, U_MAX, wrong_record

SCENARIOS = ("prbs", "stop-and-go")
METHODS = ("iv", "riv", "bcls", "ls", *SLOW)
INCREMENTS = 1024
FORGETTING = 0.99
MOST_SEEDS = 5
#: Multiples of the truth outside which an estimate has diverged.
LOW, HIGH = 0.3, 3.0
AFTER = 5.0  # [s]
ON_DRIVES = tuple(methods_for(Drive(1.0)))
STEPS_OF_CREEP = (0.0, 0.001, 0.005)  # [m]
SAMPLES_PER_COUNT = 20


def tasks(seeds: int) -> list[Task]:
    return [
        (scenario, wrong, seed) for scenario in SCENARIOS for wrong in PLANTS for seed in range(min(seeds, MOST_SEEDS))
    ]


def work(scenario: str, wrong: str, seed: int) -> dict[str, Any]:
    record = wrong_record(PLANTS[wrong], scenario, seed, INCREMENTS)
    result: dict[str, Any] = outcomes(record, METHODS)
    track = track_of("riv", record, forgetting=FORGETTING)
    theta = track.theta[round(AFTER / CART_DT) :]
    outside = np.any((np.abs(theta) < LOW * TRUTH) | (np.abs(theta) > HIGH * TRUTH), axis=1)
    late = slice(round(AFTER / CART_DT), None)
    return result | {
        "outside": float(outside.sum()) * CART_DT,
        "unsaid": float((outside & vouched(track)[late]).sum()) * CART_DT,
        "fallback": 100 * float(track.has_status(Status.FALLBACK)[late].mean()),
    }


def outcomes(record: CartRecord, methods: tuple[str, ...]) -> dict[str, Outcome]:
    """Return every method's judged result; the recursive ones forget with 0.99."""
    options = {"forgetting": FORGETTING}
    recursive = ("rls", "bcrls", "riv")
    return {m: estimate(m, record, judged=True, **(options if m in recursive else {})) for m in methods}


def write(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    count = min(seeds, MOST_SEEDS)
    lines = [
        "## Models wrong on purpose",
        "",
        f"{INCREMENTS} increments, {count} seeds, Tf = 3 T; `riv` with forgetting {FORGETTING}, its last value. The "
        "plants are simulated by Runge-Kutta with ten steps per sample, stops by interpolation within a step: not the "
        "exact solver of the scenarios, and the first row shows what that makes.",
        "",
        *(f"- {wrong}: {text}." for wrong, text in DESCRIPTIONS.items()),
        "",
        "Errors of mass, viscous and Coulomb friction: mean over the seeds in percent of the cart's parameters. "
        "Unexplained: norm of the residual over that of the target, to be compared with the first row. Flags: of "
        f"`judge`. For `riv`: fallback, part of the samples after {AFTER:g} s; diverged, runs in which a parameter lay "
        f"outside {LOW:g} to {HIGH:g} times the truth after {AFTER:g} s, and the longest such time without a warning "
        "in the status.",
        "",
    ]
    for scenario in SCENARIOS:
        rows = []
        for wrong in PLANTS:
            runs = [results[scenario, wrong, seed] for seed in range(count)]
            rows += [[wrong, f"`{method}`", *_cells(runs, method)] for method in METHODS]
        header = ["wrong", "method", "error [%]", "unexplained [%]", "flags", "fallback [%]", "diverged"]
        lines += [f"{scenario}:", "", *table(header, rows)]
    return lines


def _cells(runs: list[dict[str, Any]], method: str) -> list[str]:
    found = [run[method] for run in runs]
    cells = [
        *_error(found),
        _unexplained(found),
        tally([[*o.flags, *([o.failure] if o.failure else [])] for o in found]),
    ]
    if method != "riv":
        return [*cells, "–", "–"]
    diverged = sum(run["outside"] > 0 for run in runs)
    unsaid = max(run["unsaid"] for run in runs)
    return [*cells, f"{np.mean([run['fallback'] for run in runs]):.1f}", f"{diverged}/{len(runs)} ({unsaid:.2f} s)"]


def _error(found: list[Outcome]) -> list[str]:
    theta = np.array([outcome.theta for outcome in found if not outcome.failure])
    return [triple(percent(theta).mean(axis=0))] if theta.size else ["no estimate"]


def _unexplained(found: list[Outcome]) -> str:
    values = [100 * outcome.relative_error for outcome in found if np.isfinite(outcome.relative_error)]
    return f"{np.mean(values):.2f}" if values else "–"


def creep_tasks(seeds: int) -> list[Task]:
    return [(step, seed) for step in STEPS_OF_CREEP for seed in range(min(seeds, MOST_SEEDS))]


def creep(step: float, seed: int) -> dict[str, Outcome]:
    """Return the outcomes for a ramp of one count per 20 samples with a step in alternating directions every two
    seconds.
    """
    resolution = resolution_of(INCREMENTS)
    k = np.arange(3000)
    reference = resolution * k / SAMPLES_PER_COUNT + step * (k // 200 % 2)
    phase = resolution * np.random.default_rng(seed).random()
    motion, counts = position_control(
        CART, reference, CART_DT, kp=KP, kd=KD, u_max=U_MAX, resolution=resolution, phase=phase
    )
    return outcomes(CartRecord(motion.u, counts, resolution), ON_DRIVES)


def write_creep(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    count = min(seeds, MOST_SEEDS)
    rows = []
    for step in STEPS_OF_CREEP:
        for method in ON_DRIVES:
            found = [results[step, seed][method] for seed in range(count)]
            flags = tally([[*o.flags, *([o.failure] if o.failure else [])] for o in found])
            status = tally([status_names(o.status) for o in found])
            rows.append([f"{1000 * step:g} mm", f"`{method}`", *_error(found), flags, status])
    speed = 1e6 * resolution_of(INCREMENTS) / (SAMPLES_PER_COUNT * CART_DT)
    return [
        "## Slow creep",
        "",
        f"Position control along a ramp of one count per {SAMPLES_PER_COUNT} samples at {INCREMENTS} increments "
        f"({speed:.0f} µm/s), and on it a step to and fro every 2 s; 30 s, {count} seeds (start phase), Tf = 3 T, "
        f"forgetting {FORGETTING} for the recursive methods, last value. Errors: mean over "
        "the seeds with an estimate. Status: off-line what occurred, else that of the last sample.",
        "",
        *table(["step", "method", "error [%]", "flags or failure", "status"], rows),
    ]


STUDY = Study("wrong-models", tasks, work, write)
CREEP = Study("creep", creep_tasks, creep, write_creep)

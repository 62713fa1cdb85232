"""Figures 3 and 4 of the paper, and the bias of the mass by filter, encoder, regressor and discretisation."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pmfid.simulation import CART, CART_DT, CART_LOADED, Schedule
from pmfid.types import Floats
from studies.paper.pictures import draw_masses
from studies.paper.result import Finding, judge, table
from studies.paper.runs import CUTOFFS, EXTENDED, FORGETTING, INCREMENTS, controlled, known_mass, mass_errors, step_at
from studies.paper.runs import track as track_of
from studies.paper.truth import CartRecord

DRAWN = INCREMENTS[:3]
#: Title of a panel -> method, and whether the discretisation is ours.
PANELS = {
    "RLS, the paper's setting": ("rls", False),
    "BCRLS, the paper's setting": ("bcrls", False),
    "riv, our setting": ("riv", True),
}
DURATION = 20.0  # [s]


def draw_monitoring(path: Path, duration: float, forgetting: float, schedule: Schedule) -> None:
    """Write the mass by each method of PANELS with three encoders."""
    records = {n: controlled(n, 1, duration, schedule) for n in DRAWN}
    t = CART_DT * np.arange(records[DRAWN[0]].u.size, dtype=np.float64)
    panels: dict[str, dict[str, Floats]] = {
        title: {
            f"{n} increments": known_mass(track_of(method, record, forgetting=forgetting, own=own))
            for n, record in records.items()
        }
        for title, (method, own) in PANELS.items()
    }
    draw_masses(path, t, schedule.sample(t, CART_DT)[0], panels, (0.7, 1.6))


def records_of(increments: int, seeds: int) -> list[CartRecord]:
    return [controlled(increments, seed, DURATION) for seed in range(seeds)]


def figure3(seeds: int, images: Path) -> Finding:
    """RLS and BCRLS without forgetting, one load."""
    draw_monitoring(images / "figure3.png", 10.0, 1.0, Schedule(((0.0, CART),)))
    errors: dict[tuple[str, int], float] = {}
    for method, own in PANELS.values():
        for n in DRAWN:
            last = [
                known_mass(track_of(method, record, forgetting=1.0, own=own))[-1] for record in records_of(n, seeds)
            ]
            errors[method, n] = 100 * float(np.mean(last) / CART.mass - 1)
    rows = [[f"`{method}`", *(f"{errors[method, n]:+.1f}" for n in DRAWN)] for method, _ in PANELS.values()]
    grows = errors["rls", 512] < errors["rls", 1024] < errors["rls", 4096] < 0
    worst = max(abs(errors["bcrls", n]) for n in DRAWN)
    return Finding(
        judge(grows and worst < abs(errors["rls", 512]) / 4),
        f"Without forgetting, after {DURATION:g} s, `rls` is off by {errors['rls', 4096]:+.1f} % with 4096 "
        "increments and "
        f"by {errors['rls', 512]:+.1f} % with 512. `bcrls` is off by at most {worst:.1f} %.",
        tuple(table(["error of the mass [%]", *(f"{n} increments" for n in DRAWN)], rows)),
    )


def figure4(seeds: int, images: Path) -> Finding:
    """RLS and BCRLS with forgetting while the load changes."""
    draw_monitoring(images / "figure4.png", 30.0, FORGETTING, step_at(15.0))
    after = slice(2500, None)
    errors: dict[tuple[str, int], float] = {}
    for n in DRAWN:
        records = [controlled(n, seed, 30.0, step_at(15.0)) for seed in range(seeds)]
        for method, own in PANELS.values():
            masses = [track_of(method, record, own=own)["mass"][after] for record in records]
            errors[method, n] = 100 * float(np.mean(masses) / CART_LOADED.mass - 1)
    rows = [[f"`{method}`", *(f"{errors[method, n]:+.1f}" for n in DRAWN)] for method, _ in PANELS.values()]
    worst = max(abs(errors["bcrls", n]) for n in DRAWN)
    grows = errors["rls", 512] < errors["rls", 1024] < errors["rls", 4096] < 0
    return Finding(
        judge(grows and worst < abs(errors["rls", 512]) / 4),
        "All methods follow the step of the mass. From 10 s after it, `rls` is off by "
        f"{errors['rls', 4096]:+.1f} % with "
        f"4096 increments and by {errors['rls', 512]:+.1f} % with 512, and `bcrls` by at most {worst:.1f} %.",
        tuple(table(["error after the step [%]", *(f"{n} increments" for n in DRAWN)], rows)),
    )


def errors_by_filter(seeds: int) -> dict[tuple[str, float, bool], list[tuple[float, float]]]:
    """Return mean and scatter of the error of the mass [%] by method, cutoff and discretisation, for each encoder."""
    records = {n: records_of(n, seeds) for n in INCREMENTS}
    choices = [(method, own) for own in (False, True) for method in ("rls", "bcrls")]
    choices += [(EXTENDED, False), ("riv", True)]
    return {
        (method, cutoff, own): [mass_errors(method, records[n], cutoff, own) for n in INCREMENTS]
        for cutoff in CUTOFFS
        for method, own in choices
    }


def bias_table(seeds: int) -> list[str]:
    """Return the table of the errors, with the reasons for a difference from the paper."""
    errors = errors_by_filter(seeds)
    rows = [
        [f"{1000 / cutoff:.0f} ms", f"`{method}`", "ours" if own else "paper's", *(_cell(*e) for e in each)]
        for (method, cutoff, own), each in errors.items()
    ]
    return table(["filter", "method", "discretisation", *(f"{n} increments" for n in INCREMENTS)], rows)


def _cell(mean: float, scatter: float) -> str:
    return f"{mean:+.1f} ± {scatter:.1f}" if abs(mean) < 100 and scatter < 100 else "useless"

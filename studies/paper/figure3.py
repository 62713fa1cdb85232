"""Figure 3: the mass by RLS and BCRLS with three encoders, without forgetting, one run for each of two loads."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pmfid.simulation import CART, CART_DT, CART_LOADED, Scenario, Schedule, make_scenario
from pmfid.simulation.encoder import sample_times
from pmfid.types import Floats
from studies.paper.drawing import Drawing, write_drawing
from studies.paper.estimates import (
    OFF_LINE,
    ON_LINE,
    TITLES,
    known_mass,
    mass_of,
    mass_score,
    record_of,
    track_of,
    track_score,
)
from studies.paper.figure import PaperFigure, Results, Task
from studies.paper.merit import Merit, Score, merit

INCREMENTS = (4096, 1024, 512)
LOADS = {"1.07 kg": CART, "1.44 kg": CART_LOADED}
TIME_CONSTANT = 3  # samples: 30 ms
DURATION = 10.0  # [s], length of each run
AFTER = 2.0  # [s]: twice the transient of the paper
LIMITS = (0.6, 1.6)  # [kg]


def scenario_of(load: str, increments: int, seed: int) -> Scenario:
    """Return stop-and-go under position control with one of the loads."""
    schedule = Schedule(((0.0, LOADS[load]),))
    return make_scenario("stop-and-go", seed=seed, increments=increments, duration=DURATION, schedule=schedule)


def tasks(seeds: int) -> list[Task]:
    return [(load, inc, seed) for load in LOADS for inc in INCREMENTS for seed in range(seeds)]


def work(load: str, increments: int, seed: int) -> dict[str, Score]:
    record, truth = record_of(scenario_of(load, increments, seed)), LOADS[load].mass
    window = slice(round(AFTER / CART_DT), None)
    scores = {m: track_score(track_of(m, record, TIME_CONSTANT, 1.0), window, truth) for m in ON_LINE}
    return scores | {m: mass_score(mass_of(m, record, TIME_CONSTANT), truth) for m in OFF_LINE}


def rows(results: Results) -> list[Merit]:
    return [
        merit("3", f"stop-and-go, {load}", m, inc, [r[m] for task, r in results.items() if task[:2] == (load, inc)])
        for load in LOADS
        for inc in INCREMENTS
        for m in (*ON_LINE, *OFF_LINE)
    ]


def draw(out: Path) -> list[Path]:
    """Draw the paper's two panels, and all methods; the run with the second load follows the run with the first."""
    runs = {inc: [scenario_of(load, inc, 0) for load in LOADS] for inc in INCREMENTS}
    samples = round(DURATION / CART_DT)
    t = sample_times(2 * samples, CART_DT)
    truth = np.repeat([load.mass for load in LOADS.values()], samples)
    panels = {_title(m): {f"{inc} inc": _curve(m, runs[inc]) for inc in INCREMENTS} for m in (*ON_LINE, *OFF_LINE)}

    def drawing(name: str, titles: list[str], columns: int) -> Drawing:
        shown = {title: panels[title] for title in titles}
        return Drawing(name, t, ("nominal", truth), shown, "mass [kg]", LIMITS, columns, (DURATION,))

    paper = drawing("figure3", [_title("rls"), _title("bcrls")], 1)
    every = drawing("figure3-methods", list(panels), 2)
    return [*write_drawing(paper, out), *write_drawing(every, out)]


def _title(method: str) -> str:
    return TITLES[method] + (", off-line over each run" if method == "auto" else "")


def _curve(method: str, runs: list[Scenario]) -> Floats:
    if method in ON_LINE:
        return np.concatenate([known_mass(track_of(method, record_of(run), TIME_CONSTANT, 1.0)) for run in runs])
    return np.concatenate([np.full(run.counts.size, mass_of(method, record_of(run), TIME_CONSTANT)[0]) for run in runs])


FIGURE = PaperFigure(
    "3",
    "Mass with 4096, 1024 and 512 increments by RLS and BCRLS; forgetting 1, filters of 30 ms, stop-and-go under "
    "position control through the encoder; after the first run the load is changed and the estimator starts again.",
    tasks,
    work,
    rows,
    draw,
)

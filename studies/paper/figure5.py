"""Figure 5: the mass by RLS under standard pulses and under the designed input."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from examples.demo.run import settling_time
from pmfid.design.simulated import simulate
from pmfid.simulation import CART, CART_DT, quantize, resolution_of, simulate_drive
from pmfid.types import Floats
from studies.paper.drawing import Drawing, Motions, write_drawing, write_motions
from studies.paper.estimates import OFF_LINE, TITLES, known_mass, mass_of, mass_score, track_of, track_score
from studies.paper.figure import PaperFigure, Results, Task
from studies.paper.inputs import HORIZON, INTERVALS, experiments, information, problem
from studies.paper.merit import Merit, Score, merit
from studies.paper.truth import CartRecord, make_estimator

ON_LINE = ("rls", "bcrls", "riv")
INCREMENTS = 4096
TIME_CONSTANT = 10  # samples: 100 ms
#: Number of strokes in both directions. The input of the way back has the opposite sign.
ROUNDS = 3
BAND = 0.02
#: Inputs of the paper's picture, which are the only inputs of the off-line methods.
SHOWN = ("pulses", "designed")
LIMITS = (0.9 * CART.mass, 1.1 * CART.mass)


def record_of(name: str, seed: int) -> CartRecord:
    """Return a record of the cart under an input in both directions; the seed draws the encoder's start phase."""
    stroke = np.repeat(experiments()[name], round(HORIZON / INTERVALS / CART_DT))
    u, resolution = np.tile(np.r_[stroke, -stroke], ROUNDS), resolution_of(INCREMENTS)
    phase = float(np.random.default_rng(seed).uniform(0.0, resolution))
    return CartRecord(u, quantize(simulate_drive(CART, u, CART_DT).x, resolution, phase), resolution)


def tasks(seeds: int) -> list[Task]:
    return [(name, seed) for name in ("pulses", "designed", "pulse train", "trapezoid") for seed in range(seeds)]


def work(name: str, seed: int) -> dict[str, Score]:
    """Return the scores after the first stroke. On-line scores include the time after which the error stays
    within 2 %.
    """
    record = record_of(name, seed)
    scores = {method: _score(method, record) for method in ON_LINE}
    off_line = OFF_LINE if name in SHOWN else ()
    return scores | {m: mass_score(mass_of(m, record, TIME_CONSTANT), CART.mass) for m in off_line}


def _score(method: str, record: CartRecord) -> Score:
    track = track_of(method, record, TIME_CONSTANT, 1.0)
    settled = settling_time(known_mass(track), CART.mass, CART_DT, BAND)
    return track_score(track, slice(round(HORIZON / CART_DT), None), CART.mass, settled)


def rows(results: Results) -> list[Merit]:
    found = []
    for name in dict.fromkeys(task[0] for task in results):
        runs = [result for task, result in results.items() if task[0] == name]
        known, joint = information(experiments()[name])
        plain = [merit("5", name, m, INCREMENTS, [run[m] for run in runs]) for m in runs[0]]
        found += [replace(row, information=known, joint=joint) for row in plain]
    return found


def settle_time() -> float:
    """Return the time [s] until the filters have forgotten their start; no earlier sample is used."""
    return CART_DT * make_estimator("rls", record_of("pulses", 0), TIME_CONSTANT).settle_samples


def draw(out: Path) -> list[Path]:
    """Draw the paper's panel, all on-line methods, and the inputs."""
    records = {name: record_of(name, 0) for name in SHOWN}
    t = CART_DT * np.arange(records["pulses"].u.size, dtype=np.float64)
    panels = {TITLES[m]: {name: _curve(m, record) for name, record in records.items()} for m in ON_LINE}
    nominal = ("nominal", np.full(t.size, CART.mass))
    paper = Drawing("figure5", t, nominal, {TITLES["rls"]: panels[TITLES["rls"]]}, "mass [kg]", LIMITS)
    every = Drawing("figure5-methods", t, nominal, panels, "mass [kg]", LIMITS, 2)
    return [*write_drawing(paper, out), *write_drawing(every, out), *write_motions(_motions(), out)]


def _curve(method: str, record: CartRecord) -> Floats:
    return known_mass(track_of(method, record, TIME_CONSTANT, 1.0))


def _motions() -> Motions:
    each = problem().samples_per_interval
    held = {name: np.append(np.repeat(u, each), u[-1]) for name, u in experiments().items()}
    motions = {name: simulate(problem(), u) for name, u in experiments().items()}
    return Motions("figure5-inputs", motions["pulses"].t, held, {name: m.x for name, m in motions.items()})


FIGURE = PaperFigure(
    "5",
    "Mass by RLS with filters of 100 ms and forgetting 1 under standard pulses and under the designed input, 4096 "
    "increments; strokes of 0.4 m in 2 s, to and fro.",
    tasks,
    work,
    rows,
    draw,
)

"""Figures 2 and 5 of the paper: designs with a wrong mass, and the estimate under each input."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from pmfid.design.body import simulate
from pmfid.simulation import CART, CART_DT, quantize, resolution_of, simulate_drive
from pmfid.types import Floats
from studies.paper.inputs import HORIZON, INTERVALS, designed, experiments, information, miss_end, problem
from studies.paper.pictures import draw_inputs, draw_masses
from studies.paper.result import Finding, Verdict, judge, table
from studies.paper.runs import known_mass, track
from studies.paper.truth import CartRecord

#: Filter time constant of figure 5 [s], from the paper.
FILTER = 0.1
#: Number of strokes in both directions. The input of the way back has the opposite sign.
ROUNDS = 3
BAND = 0.02
PULSES = ("one pulse", "four pulses")
SHOWN = ("one pulse", "design (5)")


def stroke_record(u: Floats, seed: int, increments: int = 4096) -> CartRecord:
    """Return a record of strokes in both directions under an input (INTERVALS,); the seed draws the start phase."""
    stroke = np.repeat(u, round(HORIZON / INTERVALS / CART_DT))
    whole, resolution = np.tile(np.r_[stroke, -stroke], ROUNDS), resolution_of(increments)
    phase = float(np.random.default_rng(seed).uniform(0.0, resolution))
    return CartRecord(whole, quantize(simulate_drive(CART, whole, CART_DT).x, resolution, phase), resolution)


def settling_time(mass: Floats) -> float:
    """Return the time [s] after which the mass (n,) stays within 2 % of the truth; inf means never."""
    outside = np.flatnonzero(~(np.abs(mass / CART.mass - 1) < BAND))
    if not outside.size:
        return 0.0
    return math.inf if outside[-1] == mass.size - 1 else CART_DT * (int(outside[-1]) + 1)


def redesigned(guess: float) -> Floats:
    """Return the input that is designed again, for the mass that BCRLS gives in a run of the first design."""
    first = stroke_record(designed(guess * CART.mass), 0)
    mass = float(track("bcrls", first, 1 / FILTER, 1.0)["mass"][-1])
    return designed(round(mass, 4))


def figure2(seeds: int, images: Path) -> Finding:
    """Designs for the nominal mass and for a mass that is 20 % wrong."""
    inputs = {
        "nominal mass": designed(),
        "mass + 20 %": designed(1.2 * CART.mass),
        "mass - 20 %": designed(0.8 * CART.mass),
        "mass + 20 %, designed again": redesigned(1.2),
    }
    t = np.linspace(0.0, HORIZON, INTERVALS + 1)
    every = problem().samples_per_interval
    ends = {label: simulate(problem(), u).x[::every] for label, u in inputs.items()}
    draw_inputs(images / "figure2.png", t, {"input [V]": inputs, "position [m]": ends})
    best = information(designed())[0]
    gains = {label: round(100 * (information(u)[0] / best - 1), 1) + 0.0 for label, u in inputs.items()}
    missed = {label: round(1000 * miss_end(u), 2) + 0.0 for label, u in inputs.items()}
    rows = [[label, f"{gains[label]:+.1f}", f"{missed[label]:+.2f}"] for label in inputs]
    large, small, again = list(inputs)[1:]
    holds = abs(gains[large]) < 20 and abs(gains[small]) < 20 and abs(missed[again]) < abs(missed[large]) / 5
    return Finding(
        judge(holds and abs(missed[large]) > 1),
        f"A mass that is 20 % too large changes the information by {gains[large]:+.0f} % and misses the end by "
        f"{missed[large]:+.1f} mm. A mass that is 20 % too small changes them by {gains[small]:+.1f} % and "
        f"{missed[small]:+.1f} mm. The standard error changes by about half of the information. One estimate and a "
        f"second design leave {missed[again]:+.2f} mm.",
        tuple(table(["design for", "information [%]", "end missed [mm]"], rows)),
    )


def figure5(seeds: int, images: Path) -> Finding:
    """RLS under standard pulses and under designs with the same limits and duration."""
    records = {name: stroke_record(u, 0) for name, u in experiments().items()}
    size = records[SHOWN[0]].u.size
    t = CART_DT * np.arange(size, dtype=np.float64)
    shown = (*SHOWN, "design, friction unknown")
    panels = {
        title: {name: known_mass(track(method, records[name], 1 / FILTER, 1.0, own)) for name in shown}
        for title, (method, own) in {
            "RLS, the paper's setting": ("rls", False),
            "riv, our setting": ("riv", True),
        }.items()
    }
    draw_masses(images / "figure5.png", t, np.full(size, CART.mass), panels, (0.9 * CART.mass, 1.1 * CART.mass))
    inputs = {name: experiments()[name] for name in shown}
    draw_inputs(images / "figure5_inputs.png", np.linspace(0, HORIZON, INTERVALS + 1), {"input [V]": inputs})
    rows, times, carried = [], dict[str, float](), dict[str, tuple[float, float]]()
    for name, u in experiments().items():
        masses = [known_mass(track("rls", stroke_record(u, seed), 1 / FILTER, 1.0)) for seed in range(seeds)]
        times[name] = float(np.median([settling_time(mass) for mass in masses]))
        carried[name] = information(u)
        last = 100 * (np.mean([mass[-1] for mass in masses]) / CART.mass - 1)
        settled = "never" if math.isinf(times[name]) else f"{times[name]:.2f}"
        rows.append([name, *(f"{value:.2e}" for value in carried[name]), settled, f"{last:+.2f}"])
    design, rest, pulse, four = (carried[name][0] for name in ("design (5)", "design (5) with rest", *PULSES))
    holds = rest > pulse and design > four and times["design (5)"] < times["one pulse"]
    more = design > pulse and times["design (5)"] < times["four pulses"]
    header = ["input", "information, friction known", "friction unknown", "RLS within 2 % after [s]", "last error [%]"]
    return Finding(
        judge(holds and more, Verdict.LIMITED if holds else Verdict.REFUTED),
        f"RLS comes within 2 % after {times['design (5)']:.2f} s with the design, after {times['one pulse']:.2f} s "
        f"with one pulse, and after {times['four pulses']:.2f} s with four pulses. The design for v > 0 has "
        f"{100 * (design / four - 1):+.0f} % information against four pulses, and {100 * (design / pulse - 1):+.0f} % "
        f"against one pulse, after which the cart rests. A design that may rest has {100 * (rest / pulse - 1):+.0f} %.",
        tuple(table(header, rows)),
    )

"""A load that falls on the cart: `REdge` with edges of 16 increments against `riv` with counts of 4096, one motion.

Errors and scatter are those of the mass in the last ten seconds. The time is from the step to the last estimate that is
more than 5 % off.

`python -m studies.edge_step --seeds 10 [--figure FILE]`
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pmfid import RIV, Drive, Encoder, REdge
from pmfid.simulation import CART, CART_DT, CART_LOADED, capture_edges, make_scenario, resolution_of, simulate_drive
from pmfid.simulation.drive import Schedule
from pmfid.types import Floats

FINE, TICK, OFF = 20, 1e-6, 0.01
COARSE, FINEST, SECONDS, MEMORY = 16, 4096, 60.0, 2.0
#: Motion -> scenario of the input.
MOTIONS = {"prbs": "mass-step", "stop-and-go": "stop-and-go-mass-step"}


class Step(NamedTuple):
    """Masses (n,) by method [kg]."""

    edges: Floats
    counts: Floats


def follow(motion: str, seed: int) -> Step:
    """Return the masses of both methods in one run. The load falls half-way."""
    rng = np.random.default_rng([seed, 36])
    u = make_scenario(MOTIONS[motion], seed=seed, increments=COARSE, duration=SECONDS).motion.u
    load = Schedule(((0.0, CART), (SECONDS / 2, CART_LOADED)))
    moved = simulate_drive(load, np.repeat(u, FINE), CART_DT / FINE)
    model, memory = Drive(CART.input_gain), MEMORY
    coarse, fine = resolution_of(COARSE), resolution_of(FINEST)
    errors = OFF * coarse * rng.uniform(-1, 1, COARSE)
    counts, ages = capture_edges(moved, coarse, coarse * rng.random(), every=FINE, tick=TICK, line_errors=errors)
    edges = REdge(model, Encoder(coarse), CART_DT, lines=COARSE, tick=TICK, memory=memory)
    riv = RIV(model, Encoder(fine), CART_DT, 0.2 / CART_DT, forgetting=1 - CART_DT / memory)
    dense = capture_edges(moved, fine, fine * rng.random(), every=FINE)[0]
    return Step(edges.run(u, counts, ages)["mass"], riv.run(u, dense)["mass"])


def judge(mass: Floats) -> tuple[float, float, float]:
    """Return mean error and scatter of the last ten seconds [%], and the time to within 5 % [s]."""
    relative = 100 * (mass / CART_LOADED.mass - 1)
    half, end = relative[mass.size // 2 :], relative[-round(10 / CART_DT) :]
    return float(np.mean(end)), float(np.std(end)), CART_DT * float(np.max(np.flatnonzero(np.abs(half) > 5)) + 1)


def write_figure(steps: dict[str, Step], path: Path) -> None:
    """Write the masses of one run of each motion."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 3.6), layout="constrained")
    for place, (motion, step) in zip(figure.subplots(1, len(steps), sharey=True), steps.items(), strict=True):
        t = CART_DT * np.arange(step.edges.size)
        place.plot(t, step.counts, lw=1, label=f"{FINEST} increments, counts (RIV)")
        place.plot(t, step.edges, lw=1, label=f"{COARSE} increments, edge times (REdge)")
        truth = np.where(t < SECONDS / 2, CART.mass, CART_LOADED.mass)
        place.plot(t, truth, "k--", lw=0.8, label="truth")
        place.set(title=motion, xlabel="time [s]", xlim=(SECONDS / 2 - 4, SECONDS / 2 + 12), ylim=(0.95, 1.6))
    figure.axes[0].set_ylabel("mass [kg]")
    figure.axes[-1].legend(loc="lower right", fontsize="small")
    figure.savefig(path, dpi=130)


def measure(seeds: range) -> dict[str, Step]:
    """Print a row for each motion and method, and return one run of each motion."""
    print("| motion | method | mean error [%] | scatter [%] | time to 5 %, median [s] | longest |")
    print("|---" * 6 + "|")
    first = {}
    for motion in MOTIONS:
        steps = [follow(motion, seed) for seed in seeds]
        first[motion] = steps[0]
        for name in Step._fields:
            error, scatter, time = np.array([judge(getattr(step, name)) for step in steps]).T
            numbers = np.mean(np.abs(error)), np.mean(scatter), np.median(time), np.max(time)
            print(f"| {motion} | {name} | " + " | ".join(f"{x:.3g}" for x in numbers) + " |", flush=True)
    return first


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--figure", type=Path)
    options = parser.parse_args()
    steps = measure(range(options.seeds))
    if options.figure:
        write_figure(steps, options.figure)

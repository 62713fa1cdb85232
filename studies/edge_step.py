"""A load that falls on the cart: `REdge` with edges of 16 increments against `riv` with counts of 4096, one motion.

Errors and scatter are those of the mass in the last ten seconds. The time is from the step to the last estimate that is
more than 5 % off.

`python -m studies.edge_step --seeds 10`
"""

from __future__ import annotations

import argparse
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


def measure(seeds: range) -> None:
    """Print a row for each motion and method."""
    print("| motion | method | mean error [%] | scatter [%] | time to 5 %, median [s] | longest |")
    print("|---" * 6 + "|")
    for motion in MOTIONS:
        steps = [follow(motion, seed) for seed in seeds]
        for name in Step._fields:
            error, scatter, time = np.array([judge(getattr(step, name)) for step in steps]).T
            numbers = np.mean(np.abs(error)), np.mean(scatter), np.median(time), np.max(time)
            print(f"| {motion} | {name} | " + " | ".join(f"{x:.3g}" for x in numbers) + " |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    measure(range(parser.parse_args().seeds))

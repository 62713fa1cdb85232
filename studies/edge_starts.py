"""The start of `REdge` from any guess, and its estimate through an hour of rest or of creep, on the cart.

Right is a mass within 1 % and friction within 5 %, after five seconds of motion from a guess that is off by up to a
factor of three in each parameter, or without a guess. Silent are runs that are not right, without a status and by more
than 3 standard errors. Drift is the largest relative change of a parameter during an hour, and spike the largest error
of the mass without a status in ten seconds of motion thereafter. A creeping axis has an edge every 20 samples.

`python -m studies.edge_starts --seeds 40 --waits 2`: seeds of the starts, and of the waits.
"""

from __future__ import annotations

import argparse

import numpy as np

from pmfid import Drive, Encoder, REdge
from pmfid.simulation import CART, CART_DT, capture_edges, prbs, resolution_of, simulate_drive
from pmfid.types import Counts, Floats

FINE, TICK, OFF = 10, 1e-6, 0.01
INCREMENTS, FACTOR, SECONDS, HOUR = (16, 64, 256, 1024, 4096), 3.0, 5.0, 3600.0
RIGHT = np.array([0.01, 0.05, 0.05])
TRUTH = np.array([CART.mass, CART.viscous_friction, CART.coulomb_friction])
CREEP = 20  # samples from edge to edge


def make_estimator(increments: int, memory: float | None = None) -> REdge:
    encoder = Encoder(resolution_of(increments))
    return REdge(Drive(CART.input_gain), encoder, CART_DT, lines=increments, tick=TICK, memory=memory)


def record(u: Floats, increments: int, rng: np.random.Generator) -> tuple[Floats, Counts, Floats]:
    """Return input, counts and ages (n,) of the cart from rest."""
    step = resolution_of(increments)
    motion = simulate_drive(CART, np.repeat(u, FINE), CART_DT / FINE)
    errors = OFF * step * rng.uniform(-1, 1, increments)
    return u, *capture_edges(motion, step, step * rng.random(), every=FINE, tick=TICK, line_errors=errors)


def shake(seconds: float, rng: np.random.Generator) -> Floats:
    return prbs(round(seconds / CART_DT), clock=10, amplitude=4.0, rng=rng)


def start(increments: int, guessed: bool, seed: int) -> tuple[bool, bool]:
    """Return whether the estimate of one run is right, and whether it is wrong without a status."""
    rng = np.random.default_rng([seed, increments])
    estimator = make_estimator(increments)
    if guessed:
        estimator.expect(TRUTH * FACTOR ** rng.uniform(-1, 1, TRUTH.size))
    estimator.run(*record(shake(SECONDS, rng), increments, rng))
    error = np.abs(estimator.theta - TRUTH)
    right = bool(np.all(error < RIGHT * TRUTH))
    return right, not right and not estimator.status and bool(np.any(error > 3 * estimator.theta_std))


def wait(increments: int, creeping: bool, memory: float | None, seed: int) -> tuple[float, float]:
    """Return drift and spike of one run through an hour between motions."""
    rng = np.random.default_rng([seed, increments, 2])
    estimator = make_estimator(increments, memory)
    speed = resolution_of(increments) / (CREEP * CART_DT)
    hold = (CART.viscous_friction * speed + CART.coulomb_friction) / CART.input_gain if creeping else 0.0
    first, last = shake(20.0, rng), shake(10.0, rng)
    u = np.concatenate([first, np.full(round(HOUR / CART_DT), hold), last])
    track = estimator.run(*record(u, increments, rng))
    between, after = slice(first.size + 100, u.size - last.size), slice(u.size - last.size, u.size)
    drift = np.max(np.abs(track.theta[between] / track.theta[first.size] - 1))
    spike = np.abs(track["mass"][after] / CART.mass - 1)[track.status[after] == 0]
    return float(drift), float(np.max(spike, initial=0.0))


def measure_starts(seeds: range) -> None:
    """Print a row for each encoder."""
    print("| increments | right with a guess | silent | right without a guess | silent |")
    print("|---" * 5 + "|")
    for increments in INCREMENTS:
        found = [
            np.array([start(increments, guessed, seed) for seed in seeds]).sum(axis=0) for guessed in (True, False)
        ]
        cells = [f"{right} of {len(seeds)} | {silent}" for right, silent in found]
        print(f"| {increments} | {' | '.join(cells)} |", flush=True)


def measure_waits(seeds: range) -> None:
    """Print a row for each hour of rest or creep."""
    print("| hour of | memory [s] | increments | drift, most [%] | spike, most [%] |")
    print("|---" * 5 + "|")
    for creeping, memory, increments in (
        (c, m, i) for c in (False, True) for m in (None, 10.0) for i in (16, 64, 1024)
    ):
        most = 100 * np.max([wait(increments, creeping, memory, seed) for seed in seeds], axis=0)
        name = "creep" if creeping else "rest"
        print(f"| {name} | {memory} | {increments} | {most[0]:.2g} | {most[1]:.2g} |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--waits", type=int, default=2)
    options = parser.parse_args()
    if options.seeds:
        measure_starts(range(options.seeds))
    if options.waits:
        measure_waits(range(options.waits))

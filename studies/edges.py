"""Edge times against counts, off-line: errors and coverage of `EdgeFit`, and errors of `interval` on the same counts.

`python -m studies.edges --seeds 5 [--held-back]`.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from contextlib import suppress

import numpy as np

from pmfid import EdgeFit, Encoder, IntervalML
from pmfid.errors import NotIdentifiableError
from pmfid.simulation import capture_edges, simulate_drive
from pmfid.types import Floats
from studies.uneven_clocks import HELD_BACK, MACHINES, MOTIONS, SAMPLES, Plant, make_plant, move

INCREMENTS, FINE, TICK = (512, 64, 16), 20, 1e-6
#: Largest distance of a line from its place, in steps, and mean lateness of an instant [s].
FAULTS = ((0.0, 0.0), (0.01, 0.0), (0.03, 0.0), (0.1, 0.0), (0.01, 1e-5), (0.01, 5e-5))


def run_once(plant: Plant, motion: str, increments: int, off: float, late: float, seed: int) -> tuple[Floats, Floats]:
    """Return errors (2, 3) of `EdgeFit`, relative and in standard deviations, and relative errors (3,) of `interval`.
    Errors are NaN if a method refuses the record."""
    axis, rng = plant.axis, np.random.default_rng([seed, 33])
    resolution = axis.resolution * 4096 / increments
    u, _ = move(plant, motion, resolution, np.full(SAMPLES, axis.dt), seed)
    motion_of = simulate_drive(axis.drive, np.repeat(u, FINE), axis.dt / FINE)
    errors = off * resolution * rng.uniform(-1, 1, increments)
    phase = rng.random() * resolution
    counts, ages = capture_edges(motion_of, resolution, phase, every=FINE, tick=TICK, line_errors=errors)
    ages = np.clip(ages - late * rng.exponential(size=ages.size), 0.0, axis.dt)
    cutoff = 0.2 / axis.dt
    method = EdgeFit(plant.model, Encoder(resolution), axis.dt, cutoff, lines=increments, tick=TICK)
    edges = np.full((2, 3), np.nan)
    with suppress(NotIdentifiableError):
        fit = method.fit(u, counts, ages)
        error = fit.theta - plant.truth
        edges = np.array([error / plant.truth, error / fit.theta_std])
    try:
        other = IntervalML(plant.model, Encoder(resolution), axis.dt, cutoff).fit(u, counts).theta / plant.truth - 1
    except NotIdentifiableError:
        other = np.full(3, np.nan)
    return edges, other


def measure(machines: Mapping[str, tuple[str, float]], seeds: range) -> None:
    """Print a row for each machine, motion, encoder and fault: root mean square errors over the seeds."""
    print("| machine | motion | increments | lines off [%] | late [us] | edges [%] | within 2 sd [%] | interval [%] |")
    print("|---|---|---|---|---|---|---|---|")
    for name, bench in machines.items():
        if bench[1]:
            continue  # `move` cannot simulate a pendulum finely enough
        plant = make_plant(*bench)
        for motion in MOTIONS:
            for increments in INCREMENTS:
                for off, late in FAULTS:
                    runs = [run_once(plant, motion, increments, off, late, seed) for seed in seeds]
                    found, other = (np.array(part) for part in zip(*runs, strict=True))
                    within = 100 * np.mean(np.abs(found[:, 1]) < 2)
                    parts = (_format_errors(one) for one in (found[:, 0], other))
                    edges, interval = parts
                    row = (
                        name,
                        motion,
                        increments,
                        f"{100 * off:g}",
                        f"{1e6 * late:g}",
                        edges,
                        f"{within:.0f}",
                        interval,
                    )
                    print(f"| {' | '.join(map(str, row))} |", flush=True)


def _format_errors(errors: Floats) -> str:
    """Return the root mean squares of relative errors (seeds, 3) in percent."""
    return " ".join(f"{value:.2g}" for value in 100 * np.sqrt(np.nanmean(errors**2, axis=0)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--held-back", action="store_true")
    options = parser.parse_args()
    machines = HELD_BACK if options.held_back else MACHINES
    measure(machines, range(options.first, options.first + options.seeds))

"""Measure ns for each sample of methods that every version of pmfid has; `python timings.py` prints them as JSON.

The script needs no file of the repository, so that the same lines measure an older version.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from time import process_time
from typing import Any

import numpy as np

import pmfid

DT, RESOLUTION, SAMPLES, STEPS, AXES, AXIS_SAMPLES, ROUNDS = 0.01, 22.75e-6, 100_000, 10_000, 10_000, 100, 3
#: Counts by which all counters of a fleet jump.
JUMP = 777_777
METHODS = {"rls": pmfid.RLS, "bcrls": pmfid.BCRLS, "riv": pmfid.RIV}


def simulate_cart(samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Return input [V] and counts (samples,) of a cart of 1.07 kg, with ten short Euler steps in each interval."""
    u = 3 * np.sign(np.random.default_rng(7).standard_normal(samples // 10 + 1)).repeat(10)[:samples]
    position, velocity, counts = 0.0, 0.0, np.empty(samples, np.int64)
    for k, voltage in enumerate(u):
        counts[k] = int(position // RESOLUTION)
        for _ in range(10):
            force = 2 * voltage - 12.8 * velocity - 0.8 * np.sign(velocity)
            velocity += force / 1.07 * DT / 10
            position += velocity * DT / 10
    return u, counts


def measure_best(run: Callable[[], Any], samples: int, reset: Callable[[], Any]) -> float:
    """Return the CPU time of the fastest round [ns per sample], because all other rounds show the load of others."""
    times = []
    for _ in range(ROUNDS):
        reset()
        start = process_time()
        run()
        times.append(process_time() - start)
    return min(times) / samples * 1e9


def fleet_times(estimator: Any, u: np.ndarray, counts: np.ndarray) -> dict[str, float]:
    """Return the time [ns per sample] of a fleet from its start, then later, and after a jump of all counters."""
    starts = np.random.default_rng(1).integers(0, SAMPLES - 2 * AXIS_SAMPLES, AXES)

    def rows(first: int, jump: int) -> list[np.ndarray]:
        signals = (u.astype("f4"), counts.astype("i4") + jump)
        return [np.stack([x[k + first : k + first + AXIS_SAMPLES] for k in starts]) for x in signals]

    begin, later, moved = rows(0, 0), rows(AXIS_SAMPLES, 0), rows(AXIS_SAMPLES, JUMP)
    estimator.reset()
    fleet = pmfid.Fleet(estimator, AXES, workers=1)

    def restart() -> None:
        fleet.reset()
        fleet.run(*begin)

    return {
        "start": measure_best(lambda: fleet.run(*begin), begin[0].size, fleet.reset),
        "later": measure_best(lambda: fleet.run(*later), later[0].size, restart),
        "jump": measure_best(lambda: fleet.run(*moved), moved[0].size, restart),
    }


def measure_all() -> dict[str, float]:
    u, counts = simulate_cart(SAMPLES)
    found: dict[str, float] = {}
    for name, method in METHODS.items():
        for precision in ("float64", "float32"):
            drive, encoder = pmfid.Drive(2.0), pmfid.Encoder(RESOLUTION)
            estimator = method(drive, encoder, DT, 50.0, forgetting=0.995, precision=precision)
            label = f"{name} {precision}"
            found[f"run {label}"] = measure_best(lambda e=estimator: e.run(u, counts), SAMPLES, estimator.reset)
            pairs = list(zip(u[:STEPS].tolist(), counts[:STEPS].tolist(), strict=True))
            loop = lambda e=estimator, pairs=pairs: [e.step(voltage, count).theta for voltage, count in pairs]  # noqa: E731
            found[f"step {label}"] = measure_best(loop, STEPS, estimator.reset)
            for part, time in fleet_times(estimator, u, counts).items():
                found[f"fleet {part} {label}"] = time
    return found


if __name__ == "__main__":
    print(json.dumps(measure_all()))

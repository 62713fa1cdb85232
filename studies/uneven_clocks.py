"""Compare every method on uneven clocks with true stamps to an even clock of the same mean rate: errors, coverage.

`python -m studies.uneven_clocks --seeds 3 [--held-back] [--judged]`
"""

from __future__ import annotations

import argparse
import math
from collections import defaultdict
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from pmfid import BCRLS, IV, OE, RIV, RLS, Drive, Encoder
from pmfid.diagnostics.verdict import verdict
from pmfid.errors import PmfidError
from pmfid.estimators.base import Estimator
from pmfid.estimators.motion import simulate_motion
from pmfid.estimators.output_error import IntervalML
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.simulation import prbs, stop_and_go
from pmfid.types import Counts, Floats
from studies.machines import AXES, Axis

METHODS: Mapping[str, type[Estimator]] = {
    "iv": IV, "interval": IntervalML, "output-error": OE, "riv": RIV, "bcrls": BCRLS, "rls": RLS
}  # fmt: skip
INCREMENTS, MOTIONS, SAMPLES = (1024, 128), ("prbs", "stop-and-go"), 3000
TOLERANCE = 0.01  # relative error of a parameter, as [estimator] tolerance
#: The bench of each machine, and the additional gravity of a pendulum [N m].
MACHINES = {"cart": ("cart", 0.0), "rotary": ("rotary", 0.0), "40 kg": ("gantry", 0.0), "pendulum": ("rotary", 0.15)}
#: Machines on which nothing was tuned.
HELD_BACK = {"spindle": ("spindle", 0.0), "stage": ("stage", 0.0), "500 kg": ("heavy", 0.0)}


def jitter(part: float) -> Callable[[np.random.Generator], Floats]:
    """Return a clock whose instants deviate from an even grid by up to this fraction of a period."""
    return lambda rng: np.diff(np.arange(SAMPLES + 1) + part * rng.uniform(-1, 1, SAMPLES + 1))


#: Clock -> steps (n,) after each sample [periods].
CLOCKS: Mapping[str, Callable[[np.random.Generator], Floats]] = {
    "even": lambda rng: np.ones(SAMPLES),
    "jitter 5 %": jitter(0.05),
    "jitter 20 %": jitter(0.2),
    "jitter 50 %": jitter(0.5),
    "10/12 ms": lambda rng: np.tile([10 / 11, 12 / 11], SAMPLES // 2),
    "bursts": lambda rng: np.tile([0.02, 0.02, 0.02, 3.94], SAMPLES // 4),
}


class Plant(NamedTuple):
    """A machine on its bench, its model and its parameters."""

    axis: Axis
    model: Drive
    truth: Floats


def make_plant(bench: str, gravity: float) -> Plant:
    axis = AXES[bench]
    model = Drive(axis.drive.input_gain, axis="rotary" if gravity else "linear", gravity=bool(gravity))
    body = [axis.drive.mass, axis.drive.viscous_friction, axis.drive.coulomb_friction]
    return Plant(axis, model, np.array([*body, *([gravity, 0.0] if gravity else [])]))


def move(plant: Plant, motion: str, resolution: float, steps: Floats, seed: int) -> tuple[Floats, Counts]:
    """Return input and counts (n,) at samples with steps (n,) [s]. The motion between samples is exact."""
    axis, rng = plant.axis, np.random.default_rng([seed, 11])
    phase, (kp, kd, most) = rng.random(), (axis.control[name] for name in ("kp", "kd", "u_max"))
    u = prbs(SAMPLES, clock=axis.clock, amplitude=axis.volt, rng=rng)
    stroke = axis.stroke * (1 + 0.02 * rng.uniform(-1, 1))
    times = np.append(0.0, np.cumsum(steps)[:-1])
    even = np.arange(0.0, times[-1] + axis.dt, axis.dt)
    reference = np.interp(times, even, stop_and_go(even.size, axis.dt, stroke, axis.move, axis.dwell))
    x, v, before, counts = 0.0, 0.0, 0, np.empty(SAMPLES, np.int64)
    for k, step in enumerate(steps.tolist()):
        counts[k] = math.floor(x / resolution + phase)
        if motion == "stop-and-go":
            last = max(
                axis.dt if k == 0 else steps[k - 1], 0.5 * axis.dt
            )  # the controller of an engineer who knows of bursts
            speed = (counts[k] - before) * resolution / last
            u[k] = np.clip(kp * (reference[k] - counts[k] * resolution) - kd * speed, -most, most)
        mean, v = simulate_motion(plant.model.equation, plant.truth, np.array([step]), u[k : k + 1], v, x, 16)
        x, before = x + float(mean[0]) * step, int(counts[k])
    return u, counts


def estimate(
    method: str, plant: Plant, resolution: float, record: tuple[Floats, Counts], before: Floats | None, judged: bool
) -> Floats:
    """(2, 3): errors of the body's parameters over the parameters, and over their standard deviations; before (n,): the
    step before each sample, None: an even clock; judged: the deviations have the model spread, as of `identify`."""
    axis, cls = plant.axis, METHODS[method]
    estimator = cls(plant.model, Encoder(resolution, guard=False), axis.dt, 0.2 / axis.dt, steps=before)
    if isinstance(estimator, RecursiveEstimator):
        track = estimator.run(*record, before)
        theta, std = track.theta[-1], track.theta_std[-1]
    else:
        fit = estimator.fit(*record)  # type: ignore[attr-defined]
        theta, std = fit.theta, fit.theta_std
    if judged:
        std = np.hypot(std, verdict(estimator, *record, theta, std, TOLERANCE).spread)
    error = theta[:3] - plant.truth[:3]
    return np.array([error / plant.truth[:3], error / np.asarray(std)[:3]])


def measure(machines: Mapping[str, tuple[str, float]], seeds: range, judged: bool) -> None:
    """Prints, by method and clock, the ratio of errors to those of an even clock, coverage, and refusals."""
    found, refused = defaultdict[tuple[str, ...], list[Floats]](list), defaultdict[tuple[str, str], int](int)
    cells = [(name, motion, inc) for name in machines for motion in MOTIONS for inc in INCREMENTS]
    for name, motion, increments in cells:
        plant = make_plant(*machines[name])
        resolution = plant.axis.resolution * 4096 / increments
        for seed in seeds:
            for clock, make in CLOCKS.items():
                after = make(np.random.default_rng([seed, 5])) * plant.axis.dt
                record = move(plant, motion, resolution, after, seed)
                before = None if clock == "even" else np.append(plant.axis.dt, after[:-1])
                for method in METHODS:
                    try:
                        one = estimate(method, plant, resolution, record, before, judged)
                        found[method, clock, name, motion, str(increments)].append(one)
                    except PmfidError:
                        refused[method, clock] += 1
    print("| method | clock | error over even | cells up to 1.2 | median rms error [%] | within 2 sd [%] | refused |")
    print("|---|---|---|---|---|---|---|")
    for method in METHODS:
        for clock in CLOCKS:
            report({key[1:]: values for key, values in found.items() if key[0] == method}, method, clock, refused)


def report(
    found: Mapping[tuple[str, ...], list[Floats]], method: str, clock: str, refused: Mapping[tuple[str, str], int]
) -> None:
    """Print one line: the geometric mean of the cells' ratios, each over all parameters."""
    size = {key: np.sqrt(np.mean(np.square(np.array(one)[:, 0]), axis=0)) for key, one in found.items()}
    keys = [key for key in size if key[0] == clock and ("even", *key[1:]) in size]
    if not keys:
        return
    ratio = np.array([size[key] / size["even", *key[1:]] for key in keys])
    within = np.mean(np.concatenate([np.abs(np.array(found[key])[:, 1]) < 2 for key in keys]))
    print(
        f"| {method} | {clock} | {np.exp(np.mean(np.log(ratio))):.2f} | {100 * np.mean(ratio <= 1.2):.0f} % | "
        f"{100 * np.median([size[key] for key in keys]):.3f} | {100 * within:.0f} | {refused[method, clock]} |",
        flush=True,
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--held-back", action="store_true")
    parser.add_argument("--judged", action="store_true", help="standard deviations with the model spread")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.seeds)
    measure(HELD_BACK if options.held_back else MACHINES, seeds, options.judged)

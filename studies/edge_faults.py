"""Edge times that are wrong, and machines that are not the model: what `REdge` reports without a status.

Each row is a fault of the encoder or of the model, over all machines, motions and encoders. `flagged` are runs with a
status at the end. `beyond 3 sd` are runs without a status in which a parameter is off by more than three standard errors.
`worse` are cells of machine, motion and encoder in which the mass of the runs without a status is more than 1.2 times as
far off as that of `riv` on the same counts (root mean square over the seeds), and by more than 3 standard errors in a run.

`python -m studies.edge_faults --seeds 5 [--held-back] [--off-line] [--only FAULT] [--cells]`. With `--off-line` the
methods are `EdgeFit` and `interval`.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Callable, Mapping
from itertools import product
from typing import NamedTuple

import numpy as np

from pmfid import RIV, Drive, EdgeFit, Encoder, IntervalML, REdge
from pmfid.edge_times import Lattice, Trajectory, read_edge_times
from pmfid.errors import NotIdentifiableError
from pmfid.simulation import (
    DriveParameters,
    Machine,
    control_machine,
    drive_machine,
    position_control,
    prbs,
    simulate_drive,
    stop_and_go,
)
from pmfid.status import status_names
from pmfid.types import Counts, Floats
from studies.machines import AXES, OTHERWISE, WRONG, Axis, truth

INCREMENTS, FINE, TICK, OFF = (512, 64, 16), 20, 1e-6, 0.01
SMALL = Axis(
    DriveParameters(2e-5, 4e-5, 1.2e-3, 0.02),
    0.001, 8000, 0.4, 20, {"kp": 0.3, "kd": 0.004, "u_max": 2.0}, 12.0, 0.2, 0.1, 2 * np.pi / 4096, 2.0,
)  # fmt: skip
LARGE = Axis(
    DriveParameters(300.0, 900.0, 150.0, 60.0),
    0.01, 3000, 20.0, 25, {"kp": 260.0, "kd": 50.0, "u_max": 60.0}, 0.6, 1.5, 0.5, 30e-6, 0.03,
)  # fmt: skip
MACHINES: Mapping[str, Axis] = {name: AXES[name] for name in ("cart", "rotary", "gantry")}
HELD_BACK: Mapping[str, Axis] = {"2e-5 kg m2": SMALL, "300 kg": LARGE} | {
    name: AXES[name] for name in ("spindle", "stage", "heavy")
}


class Record(NamedTuple):
    """Input, counts and ages (n,) of a run."""

    u: Floats
    counts: Counts
    ages: Floats


def saturate(record: Record, axis: Axis) -> Record:
    """Return the record of a timer that ends at 0.4 samples."""
    return record._replace(ages=np.minimum(record.ages, 0.4 * axis.dt))


def delay(late: float) -> Callable[[Record, np.random.Generator], Record]:
    """Return a fault: instants of an interrupt that come late [s] by exponential times."""

    def fault(record: Record, rng: np.random.Generator) -> Record:
        ages = record.ages - late * rng.exponential(size=record.ages.size)
        return record._replace(ages=np.where(np.isfinite(ages), np.maximum(ages, 0.0), np.nan))

    return fault


def miscount(record: Record, rng: np.random.Generator) -> Record:
    """Return the record with one missed and one doubled edge per 10 000, at least one of each."""
    change, counts = np.diff(record.counts), record.counts.copy()
    moved = np.flatnonzero(change) + 1
    times = max(1, round(np.sum(np.abs(change)) / 1e4))
    for k, sign in product(rng.choice(moved, times), (-1, 1)):
        at = int(k) if sign < 0 else int(rng.choice(moved))
        counts[at:] += sign * int(np.sign(change[at - 1]))
    return record._replace(counts=counts)


#: Fault of the encoder: largest distance of a line from its place [steps], noise of the place at rest [steps].
LINES: Mapping[str, tuple[float, float]] = {"lines off by 10 %": (0.1, 0.0), "chatter": (OFF, 0.03)}
LATE = {"10 us late": 1e-5, "50 us late": 5e-5}
FAULTS = ("nothing", *LATE, *LINES, "missed and doubled", "saturated")
MODELS = (*(name for name in WRONG if name != "nothing"), "wandering load")


def move_axis(axis: Axis, machine: Machine, motion: str, resolution: float, rng: np.random.Generator) -> Floats:
    """Return the input (n,)."""
    if motion == "prbs":
        return prbs(axis.samples, clock=axis.clock, amplitude=axis.volt, rng=rng)
    stroke = axis.stroke * (1 + OTHERWISE * rng.uniform(-1, 1))
    reference = stop_and_go(axis.samples, axis.dt, stroke, axis.move, axis.dwell)
    own = dict(axis.control) | {"resolution": resolution, "phase": resolution * rng.random()}
    if machine == Machine(machine.drive):
        return position_control(machine.drive, reference, axis.dt, **own)[0].u
    return control_machine(machine, reference, axis.dt, **own).u


def make_record(axis: Axis, fault: str, motion: str, increments: int, seed: int) -> tuple[float, Record]:
    """Return the travel per count and the record of one run."""
    rng = np.random.default_rng([seed, 71])
    resolution = axis.resolution * 4096 / increments
    machine = WRONG[fault](axis) if fault in WRONG else Machine(axis.drive)
    u = move_axis(axis, machine, motion, resolution, rng)
    acting = np.repeat(u, FINE)
    if fault == "wandering load":
        walk = np.cumsum(rng.standard_normal(acting.size)) / np.sqrt(acting.size)
        acting = acting + 0.3 * axis.drive.coulomb_friction / axis.drive.input_gain * walk
    fine = axis.dt / FINE
    moved = simulate_drive(axis.drive, acting, fine) if machine == Machine(axis.drive) else None
    run = moved or drive_machine(machine, acting, fine, resolution, steps=2)
    off, noise = LINES.get(fault, (OFF, 0.0))
    slow = np.abs(run.v) * axis.dt < 0.02 * resolution
    x = run.x + noise * resolution * slow * rng.standard_normal(run.x.size)
    lines = Lattice(resolution, resolution * rng.random(), off * resolution * rng.uniform(-1, 1, increments))
    path = Trajectory(fine * np.arange(x.size), x, run.v)
    record = Record(u, *read_edge_times(path, lines, FINE, TICK))
    if fault in LATE:
        record = delay(LATE[fault])(record, rng)
    elif fault == "saturated":
        record = saturate(record, axis)
    elif fault == "missed and doubled":
        record = miscount(record, rng)
    return resolution, record


def estimate(axis: Axis, resolution: float, increments: int, record: Record, off_line: bool) -> tuple[Floats, int]:
    """Return errors (3, 3), and the status at the end: errors of edges in standard errors, those of edges and counts
    relative to the parameters."""
    model, encoder, cutoff = Drive(axis.drive.input_gain), Encoder(resolution), 0.2 / axis.dt
    found, exact = np.full((3, 3), np.nan), truth(axis)
    if off_line:
        try:
            fit = EdgeFit(model, encoder, axis.dt, cutoff, lines=increments, tick=TICK).fit(*record)
            theta, std, status = fit.theta, fit.theta_std, int(fit.status)
        except NotIdentifiableError:
            return found, -1
    else:
        method = REdge(model, encoder, axis.dt, lines=increments, tick=TICK)
        method.run(*record)
        theta, std, status = method.theta, method.theta_std, method.status
    found[:2] = (theta - exact) / std, theta / exact - 1
    try:
        if off_line:
            found[2] = IntervalML(model, encoder, axis.dt, cutoff).fit(*record[:2]).theta / exact - 1
        else:
            found[2] = RIV(model, Encoder(resolution, guard=False), axis.dt, cutoff).run(*record[:2]).theta[-1] / exact - 1
    except NotIdentifiableError:
        pass
    return found, status


def measure(machines: Mapping[str, Axis], faults: tuple[str, ...], seeds: range, off_line: bool, cells: bool) -> None:
    """Print a row for each fault, and with `cells` a line for each run without a status that is wrong."""
    print("| fault | runs | flagged | words | beyond 3 sd | beyond 5 sd | worse than counts | mass error over counts |")
    print("|---" * 8 + "|")
    for fault in faults:
        flagged, beyond, worse, words, ratios, total = 0, np.zeros(2, int), [], defaultdict[str, int](int), [], 0
        for (name, axis), motion, increments in product(machines.items(), ("prbs", "stop-and-go"), INCREMENTS):
            silent, counts = [], []
            for seed in seeds:
                resolution, record = make_record(axis, fault, motion, increments, seed)
                found, status = estimate(axis, resolution, increments, record, off_line)
                total += 1
                counts.append(found[2, 0])
                for word in status_names(max(status, 0)):
                    words[word] += 1
                if status:
                    flagged += 1
                    continue
                silent.append(found)
                size = np.max(np.abs(found[0]))
                beyond += np.array([size > 3, size > 5])
                if cells and size > 3:
                    error = " ".join(f"{100 * value:.3g}" for value in found[1])
                    bars = " ".join(f"{value:.1f}" for value in found[0])
                    print(f"  {fault}, {name}, {motion}, {increments}, seed {seed}: {error} % are {bars} sd", flush=True)
            if silent:
                mass = np.array(silent)[:, :2, 0]
                ratio = np.sqrt(np.mean(mass[:, 1] ** 2) / np.nanmean(np.square(counts)))
                ratios.append(ratio)
                if ratio > 1.2 and np.any(np.abs(mass[:, 0]) > 3):
                    worse.append(f"{name} {motion} {increments}")
        told = ", ".join(f"{word} {times}" for word, times in sorted(words.items()))
        middle = f"{np.median(ratios):.2g}, at most {max(ratios):.2g}" if ratios else "-"
        print(f"| {fault} | {total} | {flagged} | {told} | {beyond[0]} | {beyond[1]} | {len(worse)} | {middle} |", flush=True)
        if cells and worse:
            print(f"  worse: {'; '.join(worse)}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--held-back", action="store_true")
    parser.add_argument("--off-line", action="store_true", help="EdgeFit and interval")
    parser.add_argument("--only", action="append", choices=(*FAULTS, *MODELS))
    parser.add_argument("--cells", action="store_true", help="the runs that are wrong without a status")
    options = parser.parse_args()
    measure(
        HELD_BACK if options.held_back else MACHINES,
        tuple(options.only or (*FAULTS, *MODELS)),
        range(options.first, options.first + options.seeds),
        options.off_line,
        options.cells,
    )

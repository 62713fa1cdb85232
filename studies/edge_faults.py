"""Edge times that are wrong, and machines that are not the model: what `REdge` reports without a status.

Each row is a fault of the encoder or of the model, over all machines, motions and encoders. `flagged` are runs with a
status at the end. Beyond 3 and 5 sd are runs without a status in which a parameter is off by more standard errors.
Worse than counts are cells of machine, motion and encoder: the mass of the runs without a status is more than 1.2 times
as far off as the one of `riv` on the same counts (root mean square over the seeds).

`python -m studies.edge_faults --seeds 5 [--held-back] [--off-line] [--only FAULT]`. With `--off-line` the methods are
`EdgeFit` and `interval`.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from pmfid import RIV, Drive, EdgeFit, Encoder, MotionFit, REdge
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
from pmfid.simulation.encoder import sample_times
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


WEIGHT = 6.0  # of a hanging axis, over Coulomb friction
#: Fault of the encoder: largest distance of a line from its place [steps], noise of the place at rest [steps].
LINES: Mapping[str, tuple[float, float]] = {"lines off by 10 %": (0.1, 0.0), "chatter": (OFF, 0.03)}
LATE = {"10 us late": 1e-5, "50 us late": 5e-5}
FAULTS = ("nothing", "weight", *LATE, *LINES, "missed and doubled", "saturated")
MODELS = (*(name for name in WRONG if name != "nothing"), "wandering load")


def hang(axis: Axis) -> Axis:
    """Return the axis with a weight. The input holds the weight in addition to its motion."""
    return replace(axis, drive=replace(axis.drive, offset=WEIGHT * axis.drive.coulomb_friction))


def move_axis(axis: Axis, machine: Machine, motion: str, resolution: float, rng: np.random.Generator) -> Floats:
    """Return the input (n,)."""
    if motion == "prbs":
        return prbs(axis.samples, clock=axis.clock, amplitude=axis.volt, rng=rng)
    stroke = axis.stroke * (1 + OTHERWISE * rng.uniform(-1, 1))
    reference = stop_and_go(axis.samples, axis.dt, stroke, axis.move, axis.dwell)
    (kp, kd, u_max), phase = (axis.control[name] for name in ("kp", "kd", "u_max")), resolution * rng.random()
    if machine == Machine(machine.drive):
        return position_control(
            machine.drive, reference, axis.dt, kp=kp, kd=kd, u_max=u_max, resolution=resolution, phase=phase
        )[0].u
    return control_machine(machine, reference, axis.dt, resolution, kp=kp, kd=kd, u_max=u_max, phase=phase).u


def make_record(axis: Axis, fault: str, motion: str, increments: int, seed: int) -> tuple[float, Record]:
    """Return the travel per count and the record of one run."""
    rng = np.random.default_rng([seed, 71])
    resolution = axis.resolution * 4096 / increments
    level = replace(axis, drive=replace(axis.drive, offset=0.0))
    machine = WRONG[fault](level) if fault in WRONG else Machine(level.drive)
    u = move_axis(level, machine, motion, resolution, rng) + axis.drive.offset / axis.drive.input_gain
    acting = np.repeat(u, FINE)
    if fault == "wandering load":
        walk = np.cumsum(rng.standard_normal(acting.size)) / np.sqrt(acting.size)
        acting = acting + 0.3 * axis.drive.coulomb_friction / axis.drive.input_gain * walk
    fine = axis.dt / FINE
    moved = simulate_drive(axis.drive, acting, fine) if machine == Machine(level.drive) else None
    run = moved or drive_machine(machine, acting, fine, resolution, steps=2)
    off, noise = LINES.get(fault, (OFF, 0.0))
    slow = np.abs(run.v) * axis.dt < 0.02 * resolution
    x = run.x + noise * resolution * slow * rng.standard_normal(run.x.size)
    lines = Lattice(resolution, resolution * rng.random(), off * resolution * rng.uniform(-1, 1, increments))
    path = Trajectory(sample_times(x.size, fine), x, run.v)
    record = Record(u, *read_edge_times(path, lines, FINE, TICK))
    if fault in LATE:
        record = delay(LATE[fault])(record, rng)
    elif fault == "saturated":
        record = saturate(record, axis)
    elif fault == "missed and doubled":
        record = miscount(record, rng)
    return resolution, record


def estimate(axis: Axis, resolution: float, increments: int, record: Record, off_line: bool) -> tuple[Floats, int]:
    """Return errors (3, p), and the status at the end, or -1 without an estimate.

    The rows are errors of the edges in standard errors and relative to the parameters, and those of the counts.
    """
    weight, status = axis.drive.offset, -1
    exact = np.append(truth(axis), [weight] if weight else [])
    found = np.full((3, exact.size), np.nan)
    arguments = Drive(axis.drive.input_gain, offset=bool(weight)), Encoder(resolution, guard=False), axis.dt
    cutoff = 0.2 / axis.dt
    with suppress(NotIdentifiableError):
        if off_line:
            fit = EdgeFit(*arguments, cutoff, lines=increments, tick=TICK).fit(*record)
            theta, std, status = fit.theta, fit.theta_std, int(fit.status)
        else:
            method = REdge(arguments[0], Encoder(resolution), axis.dt, lines=increments, tick=TICK)
            method.run(*record)
            theta, std, status = method.theta, method.theta_std, method.status
        found[:2] = (theta - exact) / std, theta / exact - 1
    with suppress(NotIdentifiableError):
        if off_line:
            found[2] = MotionFit(*arguments, cutoff).fit(*record[:2]).theta / exact - 1
        else:
            found[2] = RIV(*arguments, cutoff).run(*record[:2]).theta[-1] / exact - 1
    return found, status


class Tally:
    """Counts of one fault: runs, runs with a status, runs beyond 3 and 5 standard errors without one, and cells that
    are worse than counts."""

    def __init__(self) -> None:
        self.runs = self.flagged = 0
        self.beyond = np.zeros(2, int)
        self.words: Counter[str] = Counter()
        self.worse: list[str] = []

    def add_cell(self, name: str, runs: list[tuple[Floats, int]]) -> None:
        """Add the runs of one machine, motion and encoder: errors (3, p) and status of each."""
        silent = np.array([found for found, status in runs if not status]).reshape(-1, *runs[0][0].shape)
        size = np.max(np.abs(silent[:, 0]), axis=1)
        self.runs += len(runs)
        self.flagged += len(runs) - len(silent)
        self.beyond += [np.sum(size > 3), np.sum(size > 5)]
        self.words.update(word for _, status in runs for word in status_names(max(status, 0)))
        mass, counts = silent[:, :2, 0], np.array([found[2, 0] for found, _ in runs])
        if mass.size and np.mean(mass[:, 1] ** 2) > 1.2**2 * np.nanmean(counts**2):
            self.worse.append(name)

    @property
    def row(self) -> tuple[object, ...]:
        words = ", ".join(f"{word} {times}" for word, times in sorted(self.words.items()))
        return self.runs, self.flagged, words, *self.beyond, f"{len(self.worse)} {'; '.join(self.worse)}"


def measure(machines: Mapping[str, Axis], faults: tuple[str, ...], seeds: range, off_line: bool) -> None:
    """Print a row for each fault."""
    print("| fault | runs | flagged | words | beyond 3 sd | beyond 5 sd | worse than counts |")
    print("|---" * 7 + "|")
    for fault in faults:
        tally = Tally()
        for (name, axis), motion, increments in product(machines.items(), ("prbs", "stop-and-go"), INCREMENTS):
            axis = hang(axis) if fault == "weight" else axis
            records = [make_record(axis, fault, motion, increments, seed) for seed in seeds]
            runs = [estimate(axis, resolution, increments, record, off_line) for resolution, record in records]
            tally.add_cell(f"{name} {motion} {increments}", runs)
        print(f"| {fault} | {' | '.join(map(str, tally.row))} |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--held-back", action="store_true")
    parser.add_argument("--off-line", action="store_true", help="EdgeFit and interval")
    parser.add_argument("--only", action="append", choices=(*FAULTS, *MODELS))
    options = parser.parse_args()
    measure(
        HELD_BACK if options.held_back else MACHINES,
        tuple(options.only or (*FAULTS, *MODELS)),
        range(options.first, options.first + options.seeds),
        options.off_line,
    )

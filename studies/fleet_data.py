"""Simulate a fleet of axes, some of which change at a known time, and write it as Parquet:
`python -m studies.fleet_data FOLDER --axes 1000 --hours 1 --changed 30`.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import polars as pl

from pmfid.simulation import DriveParameters, Schedule, prbs, quantize, simulate_drive
from pmfid.types import Floats

DT, RESOLUTION = 0.01, 22.75e-6
#: Nominal machine, and the scatter of all machines around it (standard deviation of the logarithm).
NOMINAL, SPREAD = DriveParameters(1.07, 10.0, 2.5, 2.0), 0.05
#: Amplitudes of the input over the largest one, and samples for which each is held.
SIZES, HELD = (0.8, 1.0), 300
#: Axes in a file.
IN_A_FILE = 25
CAUSES = ("mass", "friction", "input_gain")
AXIS_TOML = f"""[record]
input = "u"
output = "counts"
output_kind = "counts"
time = "t"

[encoder]
resolution = {RESOLUTION}

[model]
input_gain = {NOMINAL.input_gain}
"""


@dataclass(frozen=True)
class Change:
    """A change of a parameter by a factor at a time [s]."""

    cause: str
    factor: float
    time: float


@dataclass(frozen=True)
class Machine:
    """An axis of the fleet."""

    name: str
    number: int
    drive: DriveParameters
    change: Change | None


def machines(axes: int, changed: int, seconds: float, seed: int) -> list[Machine]:
    """Return the axes of a fleet; `changed` of them change, and the causes alternate."""
    rng = np.random.default_rng([seed, 1])
    which = {int(k): i for i, k in enumerate(rng.choice(axes, changed, replace=False))}
    found = []
    for k in range(axes):
        mass, viscous, coulomb = np.exp(SPREAD * rng.standard_normal(3))
        drive = replace(
            NOMINAL,
            mass=NOMINAL.mass * mass,
            viscous_friction=NOMINAL.viscous_friction * viscous,
            coulomb_friction=NOMINAL.coulomb_friction * coulomb,
        )
        size, time = float(rng.uniform(0.08, 0.3)), float(rng.uniform(0.15, 0.85)) * seconds
        factor = 1 / (1 + size) if rng.random() < 0.5 else 1 + size
        change = Change(CAUSES[which[k] % len(CAUSES)], factor, time) if k in which else None
        found.append(Machine(f"axis-{k:04d}", k, drive, change))
    return found


def changed_drive(drive: DriveParameters, change: Change) -> DriveParameters:
    """Return the drive after the change."""
    if change.cause == "friction":
        viscous, coulomb = (change.factor * part for part in (drive.viscous_friction, drive.coulomb_friction))
        return replace(drive, viscous_friction=viscous, coulomb_friction=coulomb)
    return replace(drive, **{change.cause: change.factor * getattr(drive, change.cause)})


def rows(machine: Machine, samples: int, seed: int) -> pl.DataFrame:
    """Return the log of an axis under a random binary input with its own clock, whose amplitude changes every few
    seconds.
    """
    rng = np.random.default_rng([seed, 2, machine.number])
    binary: Floats = prbs(samples, clock=int(rng.integers(15, 41)), amplitude=rng.uniform(5, 9), rng=rng)
    u = np.round(binary * np.repeat(rng.uniform(*SIZES, samples // HELD + 1), HELD)[:samples], 3)
    parts = [(0.0, machine.drive)]
    if machine.change is not None:
        parts.append((machine.change.time, changed_drive(machine.drive, machine.change)))
    x = simulate_drive(Schedule(tuple(parts)), u, DT).x
    counts = quantize(x, RESOLUTION, RESOLUTION * rng.random()).astype(np.int32)
    name = pl.repeat(machine.name, samples, eager=True)
    return pl.DataFrame({"machine": name, "t": np.arange(samples) * DT, "u": u, "counts": counts})


def _write(folder: Path, samples: int, seed: int, group: tuple[int, tuple[Machine, ...]]) -> None:
    number, members = group
    frame = pl.concat([rows(machine, samples, seed) for machine in members])
    frame.write_parquet(folder / f"part-{number:04d}.parquet", row_group_size=samples)


def groups(fleet: list[Machine]) -> Iterator[tuple[int, tuple[Machine, ...]]]:
    """Yield the number and the axes of each file."""
    for number, start in enumerate(range(0, len(fleet), IN_A_FILE)):
        yield number, tuple(fleet[start : start + IN_A_FILE])


def write_fleet(folder: Path, axes: int, changed: int, hours: float, seed: int = 0, workers: int = 1) -> list[Machine]:
    """Write the data set into folder/data, folder/axis.toml, and the truth into folder/truth.json."""
    seconds = 3600 * hours
    fleet = machines(axes, changed, seconds, seed)
    (folder / "data").mkdir(parents=True, exist_ok=True)
    (folder / "axis.toml").write_text(AXIS_TOML, encoding="utf-8")
    truth = {one.name: asdict(one.change) for one in fleet if one.change is not None}
    (folder / "truth.json").write_text(json.dumps(truth, indent=1), encoding="utf-8")
    work = partial(_write, folder / "data", round(seconds / DT), seed)
    if workers == 1:
        for group in groups(fleet):
            work(group)
    else:
        with ProcessPoolExecutor(workers) as pool:
            list(pool.map(work, groups(fleet)))
    return fleet


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--axes", type=int, default=1000)
    parser.add_argument("--changed", type=int, default=30)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1)
    arguments = parser.parse_args()
    write_fleet(**vars(arguments))


if __name__ == "__main__":
    main()

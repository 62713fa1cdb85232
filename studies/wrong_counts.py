"""Study the repair of wrong counts in whole records, as a page:
`python -m studies.wrong_counts --out results/wrong_counts.md`.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from pmfid.encoder import Encoder, quantize
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.models.drive import Drive
from pmfid.records.outliers import repair_record
from pmfid.records.record import Record
from pmfid.simulation import prbs, simulate_drive
from pmfid.types import Counts, Floats
from studies.glitch_sizes import CLUSTER, CUTOFF, FAR, KINDS, MEMORY, METHODS, RATES, WITHIN, wrong_sizes
from studies.machines import AXES, MOTIONS, machine_record
from studies.paper.truth import table
from studies.sections import write_page

#: Largest size [counts].
LARGEST = (3, 10, 100, 5000, 1_000_000)
INCREMENTS = (16384, 4096, 1024, 256)
#: Time for which the input keeps its sign [samples].
HOLDS = (2, 3, 5, 25, 50, 100, 200)
SAMPLES = 2500
#: A method with a larger error of the mass without wrong counts is not judged on that record.
CLEAN = 0.05


@dataclass(frozen=True)
class Case:
    """A clean record of an axis, and the mass (n,) by a recursion from its counts."""

    axis: str
    u: Floats
    counts: Counts
    estimator: RecursiveEstimator
    mass: Floats

    def deviation(self, places: NDArray[np.intp], sizes: Counts) -> tuple[float, bool]:
        """Return the largest relative deviation of the mass by wrong counts of sizes (k,) at places (k,), after
        repair, and whether the repair reports nothing.
        """
        counts = self.counts.copy()
        counts[places] += sizes
        repaired = repair_record(logged(self.u, counts))
        mass = self.estimator.start().run(self.u, repaired.record.counts).theta[:, 0]
        apart = float(np.max(np.abs(mass - self.mass)[SAMPLES // 3 :])) / AXES[self.axis].drive.mass
        return apart, not repaired.findings


def logged(u: Floats, counts: Counts) -> Record:
    return Record(u, counts, 0.01, 1.0, (), "log")


def clean_records(axis: str, seed: int) -> Iterator[tuple[str, int, Floats, Counts, float]]:
    """Yield motion, increments, input (n,), counts (n,) and resolution."""
    machine, rng = AXES[axis], np.random.default_rng([seed, 3])
    for increments in INCREMENTS:
        for motion in MOTIONS:
            record = machine_record(machine, "nothing", motion, increments, seed)
            yield motion, increments, record.u, record.counts, record.resolution
        resolution = machine.resolution * 4096 / increments
        for hold in HOLDS:
            square = machine.volt * np.where(np.arange(SAMPLES) // hold % 2, -1.0, 1.0)
            random = prbs(SAMPLES, clock=hold, amplitude=machine.volt, rng=rng)
            for motion, u in ((f"square, {hold}", square), (f"prbs, {hold}", random)):
                y = simulate_drive(machine.drive, u, machine.dt).x
                yield motion, increments, u, quantize(y + resolution * rng.random(), resolution), resolution


def cases(axis: str, seed: int, motions: tuple[str, ...], increments: tuple[int, ...]) -> Iterator[Case]:
    """Yield the cases of an axis in which the mass is within `CLEAN` without wrong counts."""
    machine = AXES[axis]
    for motion, lines, u, counts, resolution in clean_records(axis, seed):
        if motion not in motions or lines not in increments:
            continue
        u, counts = u[:SAMPLES], counts[:SAMPLES]
        for cls in METHODS.values():
            encoder = Encoder(resolution, guard=False)
            estimator = cls(
                Drive(machine.drive.input_gain), encoder, machine.dt, CUTOFF / machine.dt, forgetting=1 - 1 / MEMORY
            )
            mass = estimator.start().run(u, counts).theta[:, 0]
            if np.max(np.abs(mass[SAMPLES // 3 :] / machine.drive.mass - 1)) < CLEAN:
                yield Case(axis, u, counts, estimator, mass)


def wrong_places(kind: str, rate: float, rng: np.random.Generator) -> NDArray[np.intp]:
    """Return places (k,) from the first sample on."""
    faults = max(1, round(rate * SAMPLES))
    if kind != "clustered":
        return np.sort(rng.choice(SAMPLES, faults, replace=False))
    starts = rng.choice(SAMPLES - WITHIN, max(1, round(faults / CLUSTER)), replace=False)
    return np.unique([start + rng.choice(WITHIN, CLUSTER, replace=False) for start in starts])


def flag_rows(seeds: int) -> list[list[str]]:
    """Return a row for each axis: flagged samples of clean records."""
    rows = []
    for axis in AXES:
        flags = [
            (repair_record(logged(u, counts)).record.counts != counts).sum() / counts.size
            for seed in range(seeds)
            for _, _, u, counts, _ in clean_records(axis, seed)
        ]
        rows.append([axis, str(len(flags)), f"{100 * np.mean(flags):.2g}", f"{100 * max(flags):.2g}"])
    return rows


def size_rows(seeds: int) -> list[list[str]]:
    """Return a row for each kind and rate, with the part of the records beyond `FAR` for each largest size."""
    rng = np.random.default_rng(7)
    chosen = [
        case
        for axis, seed in product(AXES, range(seeds))
        for case in cases(axis, seed, ("prbs", "stop-and-go", "multisine", "square, 25"), (1024, 256))
    ]
    rows = []
    for kind, rate in product(KINDS, RATES):
        numbers, silent = [], 0
        for largest in LARGEST:
            effects = []
            for case in chosen:
                places = wrong_places(kind, rate, rng)
                effects.append(case.deviation(places, wrong_sizes(kind, largest, places.size, rng)))
            apart = np.array([apart for apart, _ in effects])
            silent += sum(apart > FAR and nothing for apart, nothing in effects)
            numbers.append(f"{100 * np.mean(apart > FAR):.2g} ({100 * np.quantile(apart, 0.99):.2g})")
        rows.append([kind, f"{100 * rate:g}", str(len(chosen)), *numbers, str(silent)])
        print(" | ".join(rows[-1]), flush=True)
    return rows


def climb(case: Case, seconds: float, rng: np.random.Generator) -> tuple[float, float, int]:
    """Return the first and the worst deviation that a search finds with 1 % wrong counts of 3 to 1e6 counts, and the
    number of trials.
    """
    places = wrong_places("uniform", 0.01, rng)
    sizes = wrong_sizes("log-uniform", 1000, places.size, rng)
    began = worst = case.deviation(places, sizes)[0]
    tried, end = 1, time.monotonic() + seconds
    while time.monotonic() < end:
        places_now, sizes_now = places.copy(), sizes.astype(np.float64)
        some = rng.random(places.size) < rng.choice([1.5 / places.size, 0.2])
        sizes_now[some] *= np.exp(rng.normal(0.0, 0.7, some.sum())) * rng.choice([1, 1, -1], some.sum())
        moved = rng.random(places.size) < 1.0 / places.size
        places_now[moved] = np.minimum(rng.choice(places, moved.sum()) + rng.integers(1, 5, moved.sum()), SAMPLES - 1)
        places_now, first = np.unique(places_now, return_index=True)
        sizes_now = np.clip(sizes_now[first], -1e6, 1e6)
        sizes_next = np.rint(np.where(np.abs(sizes_now) < 3, np.copysign(3.0, sizes_now), sizes_now)).astype(np.int64)
        found, tried = case.deviation(places_now, sizes_next)[0], tried + 1
        if found >= worst:
            worst, places, sizes = found, places_now, sizes_next
    return began, worst, tried


def climb_rows(seconds: float) -> list[list[str]]:
    """Return a row for each axis and method, with equal shares of the time."""
    rng, rows = np.random.default_rng(29), []
    chosen = [case for axis in AXES for case in cases(axis, 0, ("prbs",), (1024,))]
    for case in chosen:
        began, worst, tried = climb(case, seconds / len(chosen), rng)
        rows.append([case.axis, case.estimator.method, str(tried), f"{100 * began:.2g}", f"{100 * worst:.2g}"])
        print(" | ".join(rows[-1]), flush=True)
    return rows


def page(seeds: int = 1, seconds: float = 600.0) -> str:
    """Return the page, from `seeds` records of each axis, motion and encoder, and `seconds` of search."""
    sizes = [f"up to {largest:g} counts" for largest in LARGEST]
    return "\n".join(
        [
            "# Wrong counts in a record",
            "",
            f"Written by `python -m studies.wrong_counts`. `{'`, `'.join(METHODS)}` without a guard, with a memory of "
            f"{MEMORY} samples, run on repaired records of {SAMPLES} samples. Deviation: of the mass from the run on "
            "the clean record, at any time after the first third.",
            "",
            f"Records beyond {100 * FAR:g} % in percent, with the 99 % quantile of the deviation in percent. The last "
            "column counts the records of all sizes beyond this limit in which the repair reports nothing.",
            "",
            *table(["sizes", "rate [%]", "records", *sizes, "not reported"], size_rows(seeds)),
            "",
            "Changed samples of clean records, with inputs that keep their sign for "
            f"{', '.join(str(hold) for hold in HOLDS)} samples among them:",
            "",
            *table(["axis", "records", "mean [%]", "largest [%]"], flag_rows(seeds)),
            "",
            f"An adversary with {seconds:g} s chooses places and sizes of 1 % wrong counts:",
            "",
            *table(["axis", "method", "trials", "first [%]", "worst [%]"], climb_rows(seconds)),
            "",
        ]
    )


if __name__ == "__main__":
    write_page(page, __doc__)

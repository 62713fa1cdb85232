"""Study wrong counts in recursive estimators, as a page: `python -m studies.glitches --out results/glitches.md`."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from pmfid.encoder import Encoder, quantize
from pmfid.estimators import PRECISIONS, Precision
from pmfid.estimators.iv import RIV
from pmfid.estimators.recursive import BCRLS, RLS, RecursiveEstimator
from pmfid.models.drive import Drive
from pmfid.simulation import DriveParameters, multisine, prbs, simulate_drive
from pmfid.status import Status
from pmfid.types import Counts, Floats
from studies.machines import AXES, Axis, machine_record
from studies.paper.truth import table
from studies.sections import write_page

METHODS: Mapping[str, type[RecursiveEstimator]] = MappingProxyType({"rls": RLS, "bcrls": BCRLS, "riv": RIV})
#: Memory of the estimators [samples], and the pole of their filters times the sample period.
MEMORY, CUTOFF = 200, 0.5
SAMPLES = 2500
INCREMENTS = (16384, 4096, 1024, 256)
#: Time for which the input keeps its sign [samples].
HOLDS = (2, 3, 5, 25, 50, 100, 200)
KINDS = ("uniform", "log-uniform", "constant", "constant, one sign", "clustered", "bit flips")
RATES = (0.001, 0.01, 0.03)
#: Largest size [counts].
LARGEST = (3, 10, 100, 5000, 1_000_000)
#: Number of wrong counts in a cluster, and the samples that it spans.
CLUSTER, WITHIN = 5, 20
#: Largest deviation of the mass without a flag, and two memories after the last wrong count. A method with a larger
#: error without wrong counts is not judged on that record.
FAR, FORGOTTEN = 0.05, 0.01
#: Status bits that flag an estimate. All other bits do not say that the mass is wrong.
FLAGS = ~(Status.STANDSTILL | Status.FEEDBACK | Status.FALLBACK)
#: Axes that no choice of the guard's rule has seen.
HELD_BACK = ("spindle", "stage", "shuttle", "feeder")


def _scaled(axis: Axis, mass: float, viscous: float, coulomb: float) -> Axis:
    """Return an axis with another body, moved by the same bench."""
    drive = axis.drive
    body = DriveParameters(
        mass * drive.mass, viscous * drive.viscous_friction, coulomb * drive.coulomb_friction, drive.input_gain
    )
    return Axis(**{**axis.__dict__, "drive": body})


MACHINES: Mapping[str, Axis] = MappingProxyType(
    {**AXES, "shuttle": _scaled(AXES["gantry"], 0.3, 0.5, 1.5), "feeder": _scaled(AXES["rotary"], 3.0, 0.3, 0.6)}
)


@dataclass(frozen=True)
class Case:
    """An estimator on a clean record of an axis, and the mass (n,) at each of its samples."""

    axis: str
    motion: str
    increments: int
    u: Floats
    counts: Counts
    estimator: RecursiveEstimator
    mass: Floats

    @property
    def method(self) -> str:
        return self.estimator.method


@dataclass(frozen=True)
class Harm:
    """Largest deviation of the mass without a flag, and two memories after the last wrong count, relative to the mass.
    `late` is true if a flag remains then. `flags` is the fraction of samples with a count that was called wrong.
    """

    silent: float
    after: float
    late: bool
    flags: float


def clean_records(axis: str, seed: int) -> Iterator[tuple[str, int, Floats, Counts, float]]:
    """Yield motion, increments, input (n,), counts (n,) and resolution."""
    machine, rng = MACHINES[axis], np.random.default_rng([seed, 3])
    for increments in INCREMENTS:
        for motion in ("prbs", "stop-and-go", "multisine"):
            record = machine_record(machine, "nothing", motion, increments, seed)
            yield motion, increments, record.u[:SAMPLES], record.counts[:SAMPLES], record.resolution
        resolution = machine.resolution * 4096 / increments
        squares = {
            f"square, {hold}": machine.volt * np.where(np.arange(SAMPLES) // hold % 2, -1.0, 1.0) for hold in HOLDS
        }
        random = {f"prbs, {hold}": prbs(SAMPLES, clock=hold, amplitude=machine.volt, rng=rng) for hold in HOLDS}
        tones = {"sines": multisine(SAMPLES, machine.dt, np.array([0.3, 1.1, 2.9]), machine.volt, rng)}
        for motion, u in (squares | random | tones).items():
            y = simulate_drive(machine.drive, u, machine.dt).x
            yield motion, increments, u, quantize(y + resolution * rng.random(), resolution), resolution


def make(method: str, axis: str, resolution: float, precision: Precision = "float64") -> RecursiveEstimator:
    """Return a recursive estimator of an axis."""
    machine, forgetting = MACHINES[axis], 1 - 1 / MEMORY
    model, encoder = Drive(machine.drive.input_gain), Encoder(resolution)
    return METHODS[method](model, encoder, machine.dt, CUTOFF / machine.dt, forgetting=forgetting, precision=precision)


def run(case: Case, counts: Counts) -> tuple[Floats, NDArray[np.bool_], NDArray[np.bool_]]:
    """Return mass, flags and wrong counts (n,), in time with the samples. The last samples repeat the last row."""
    track, delay = case.estimator.start().run(case.u, counts), case.estimator.delay
    rows = np.minimum(np.arange(counts.size) + delay, counts.size - 1)
    return track.theta[rows, 0], track.has_status(FLAGS)[rows], track.has_status(Status.COUNT_JUMP)[rows]


def cases(axis: str, seed: int, motions: tuple[str, ...], increments: tuple[int, ...]) -> Iterator[Case]:
    """Yield the cases of an axis in which the mass is within `FAR` of the truth without wrong counts."""
    for motion, lines, u, counts, resolution in clean_records(axis, seed):
        if motion in motions and lines in increments:
            for method, precision in product(METHODS, PRECISIONS):
                estimator = make(method, axis, resolution, precision)
                case = Case(axis, motion, lines, u, counts, estimator, np.empty(0))
                mass = run(case, counts)[0]
                if np.max(np.abs(mass[SAMPLES // 3 :] / MACHINES[axis].drive.mass - 1)) < FAR:
                    yield Case(axis, motion, lines, u, counts, estimator, mass)


def wrong_sizes(kind: str, largest: int, faults: int, rng: np.random.Generator) -> Counts:
    """Return signed sizes (faults,) [counts]."""
    signs = rng.choice([-1, 1], faults)
    if kind == "constant":
        return largest * signs
    if kind == "constant, one sign":
        return np.full(faults, largest * signs[0])
    if kind == "log-uniform":
        return signs * np.rint(3.0 * (largest / 3) ** rng.random(faults)).astype(np.int64)
    if kind == "bit flips":
        return signs * 2 ** rng.integers(1, max(2, int(largest).bit_length()), faults)
    return rng.integers(-largest, largest + 1, faults)


def wrong_places(kind: str, rate: float, rng: np.random.Generator) -> NDArray[np.intp]:
    """Return places (k,) from the first sample to two memories before the last."""
    end = SAMPLES - 2 * MEMORY - WITHIN
    faults = max(1, round(rate * end))
    if kind != "clustered":
        return np.sort(rng.choice(end, faults, replace=False))
    starts = rng.choice(end - WITHIN, max(1, round(faults / CLUSTER)), replace=False)
    return np.unique([start + rng.choice(WITHIN, CLUSTER, replace=False) for start in starts])


def harm(case: Case, places: NDArray[np.intp], sizes: Counts) -> Harm:
    """Return the effect of wrong counts of sizes (k,) at places (k,), after the first third of the record."""
    counts = case.counts.copy()
    counts[places] += sizes
    mass, flagged, wrong = run(case, counts)
    apart, later = np.abs(mass - case.mass) / MACHINES[case.axis].drive.mass, int(places[-1]) + 2 * MEMORY
    silent = apart[SAMPLES // 3 :][~flagged[SAMPLES // 3 :]]
    return Harm(float(np.max(silent, initial=0.0)), float(apart[later]), bool(flagged[later]), float(wrong.mean()))


def clean_rows(seeds: int) -> list[list[str]]:
    """Return a row for each axis: samples of clean records whose counts are called wrong."""
    rows = []
    for axis in MACHINES:
        found = []
        for seed in range(seeds):
            for motion, increments, u, counts, resolution in clean_records(axis, seed):
                case = Case(axis, motion, increments, u, counts, make("rls", axis, resolution), np.empty(0))
                found.append(run(case, counts)[2].mean())
        beyond = sum(part > 0.001 for part in found)
        rows.append([axis, str(len(found)), f"{100 * np.mean(found):.2g}", f"{100 * max(found):.2g}", str(beyond)])
    return rows


def chosen_cases(seeds: int) -> list[Case]:
    """Return cases of all axes with some motions and encoders."""
    motions = ("prbs", "stop-and-go", "multisine", "square, 5", "square, 25", "square, 100", "prbs, 3")
    return [case for axis, seed in product(MACHINES, range(seeds)) for case in cases(axis, seed, motions, (4096, 256))]


def size_rows(chosen: list[Case]) -> list[list[str]]:
    """Return a row for each kind and rate: runs that are silently far, or not forgotten after two memories."""
    rng, rows = np.random.default_rng(7), []
    for kind, rate in product(KINDS, RATES):
        found = []
        for case, largest in product(chosen, LARGEST):
            places = wrong_places(kind, rate, rng)
            found.append(harm(case, places, wrong_sizes(kind, largest, places.size, rng)))
        rows.append([kind, f"{100 * rate:g}", *_numbers(found)])
        print(" | ".join(rows[-1]), flush=True)
    return rows


def single_rows(chosen: list[Case], step: int = 1) -> list[list[str]]:
    """Return a row for each size of a single wrong count at each `step`-th of the first 1000 samples."""
    rows = []
    for size in (3, 20, 60, 300, 1_000_000):
        sizes = np.array([size])
        found = [
            harm(case, np.array([place]), sizes if place % 2 else -sizes)
            for case in chosen
            for place in range(0, 1000, step)
        ]
        rows.append([f"{size:g}", *_numbers(found)])
        print(" | ".join(rows[-1]), flush=True)
    return rows


def _numbers(found: list[Harm]) -> list[str]:
    silent, after = (100 * np.array([getattr(one, part) for one in found]) for part in ("silent", "after"))
    return [
        str(len(found)),
        f"{100 * np.mean(silent > 100 * FAR):.2g}",
        *(f"{value:.2g}" for value in (np.median(silent), np.quantile(silent, 0.99))),
        f"{100 * np.mean(after > 100 * FORGOTTEN):.2g}",
        f"{np.quantile(after, 0.99):.2g}",
        f"{100 * np.mean([one.late for one in found]):.2g}",
    ]


def climb(case: Case, seconds: float, rng: np.random.Generator) -> tuple[float, float, int]:
    """Return the first and the worst silent deviation that a search finds with 1 % wrong counts of 3 to 1e6 counts, and
    the number of trials.
    """
    places = wrong_places("uniform", 0.01, rng)
    sizes = wrong_sizes("log-uniform", 1000, places.size, rng)
    began = worst = harm(case, places, sizes).silent
    tried, end = 1, time.monotonic() + seconds
    while time.monotonic() < end:
        moved = rng.random(places.size) < 1.0 / places.size
        others = np.where(
            moved, np.minimum(rng.choice(places, places.size) + rng.integers(1, 5), SAMPLES - 421), places
        )
        others, first = np.unique(others, return_index=True)
        grown = sizes[first] * np.exp(rng.normal(0.0, 0.7, others.size) * (rng.random(others.size) < 0.2))
        grown = np.rint(np.copysign(np.clip(np.abs(grown), 3, 1e6), grown)).astype(np.int64)
        silent, tried = harm(case, others, grown).silent, tried + 1
        if silent >= worst:
            worst, places, sizes = silent, others, grown
    return began, worst, tried


def climb_rows(seconds: float) -> list[list[str]]:
    """Return a row for each axis and method, with equal shares of the time."""
    rng, rows = np.random.default_rng(29), []
    chosen = [
        case for axis in MACHINES for case in cases(axis, 0, ("prbs",), (1024,)) if "64" in case.estimator.precision
    ]
    for case in chosen:
        began, worst, tried = climb(case, seconds / len(chosen), rng)
        rows.append([case.axis, case.method, str(tried), f"{100 * began:.2g}", f"{100 * worst:.2g}"])
        print(" | ".join(rows[-1]), flush=True)
    return rows


#: Columns of `_numbers`.
NUMBERS = (
    "runs",
    f"silent beyond {100 * FAR:g} % [%]",
    "silent, median [%]",
    "99 % [%]",
    f"later beyond {100 * FORGOTTEN:g} % [%]",
    "99 % [%]",
    "flagged then [%]",
)


def page(seeds: int = 1, seconds: float = 600.0, step: int = 7) -> str:
    """Return the page, from `seeds` records of each axis, motion and encoder, single wrong counts at each `step`-th
    sample, and `seconds` of search.
    """
    chosen = chosen_cases(seeds)
    return "\n".join(
        [
            "# Wrong counts",
            "",
            f"Written by `python -m studies.glitches`. `{'`, `'.join(METHODS)}` with a memory of {MEMORY} samples, in "
            f"both precisions, on {len(MACHINES)} axes, of which {', '.join(HELD_BACK)} were held back. Deviation: of "
            "the mass from the run on the clean record, relative to the mass. Silent: after the first third of the "
            "record, without a flag. Later: two memories after the last wrong count.",
            "",
            f"Sizes up to {', '.join(f'{size:g}' for size in LARGEST)} counts, from the first sample on:",
            "",
            *table(["sizes", "rate [%]", *NUMBERS], size_rows(chosen)),
            "",
            "A single wrong count in the first 1000 samples:",
            "",
            *table(["size", *NUMBERS], single_rows([case for case in chosen if case.increments == 4096], step)),
            "",
            "Samples of clean records that are called wrong:",
            "",
            *table(["axis", "records", "mean [%]", "largest [%]", "records beyond 0.1 %"], clean_rows(seeds)),
            "",
            f"An adversary with {seconds:g} s chooses places and sizes of 1 % wrong counts:",
            "",
            *table(["axis", "method", "trials", "first [%]", "worst [%]"], climb_rows(seconds)),
            "",
        ]
    )


if __name__ == "__main__":
    write_page(page, __doc__)

"""The effect of wrong counts on the mass, for all sizes and for an adversary's choice; part of `studies.glitches`."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from pmfid.encoder import Encoder
from pmfid.estimators import PRECISIONS, Precision
from pmfid.estimators.iv import RIV
from pmfid.estimators.recursive import BCRLS, RLS, RecursiveEstimator
from pmfid.estimators.results import Track
from pmfid.models.drive import Drive
from pmfid.status import Status
from pmfid.types import Counts
from studies.machines import AXES, MOTIONS, machine_record
from studies.paper.truth import CartRecord

KINDS = ("uniform", "log-uniform", "constant", "constant, one sign", "clustered")
RATES = (0.001, 0.01, 0.03)
#: Largest size [counts].
LARGEST = (3, 5, 10, 30, 100, 300, 1000, 5000, 100_000, 1_000_000)
METHODS: Mapping[str, type[RecursiveEstimator]] = MappingProxyType({"rls": RLS, "bcrls": BCRLS, "riv": RIV})
INCREMENTS = (16384, 4096, 1024, 256)
#: Number of wrong counts in a cluster, and the samples that it spans.
CLUSTER, WITHIN = 5, 20
#: Memory of the estimators [samples], and the pole of their filters times the sample period.
MEMORY, CUTOFF = 200, 0.5
#: Axes held back; the guard was tuned on the others.
HELD_BACK = ("spindle", "stage", "gantry")
#: A method with a larger error of the mass without wrong counts is not judged on that record.
CLEAN = 0.02
FAR, FORGOTTEN = 0.05, 0.01
#: Status bits that count as a flag. All other bits do not say that the mass is wrong.
FLAGS = ~(Status.STANDSTILL | Status.FEEDBACK | Status.FALLBACK)


@dataclass(frozen=True)
class Case:
    """An estimator on the record of an axis, with its track without wrong counts. The first and last place of a wrong
    count and the first judged sample are included."""

    axis: str
    method: str
    estimator: RecursiveEstimator
    record: CartRecord
    clean: Track
    first: int
    last: int
    judged: int


@dataclass(frozen=True)
class Harm:
    """Deviation of the mass from the track without wrong counts, relative to the mass.

    `silent` is the largest deviation without a flag, `largest` the largest at all, and `after` the one two memories
    after the last wrong count. `flagged` is the fraction of flagged samples.
    """

    silent: float
    largest: float
    after: float
    flagged: float


def case_of(axis: str, method: str, seed: int, precision: Precision = "float64", start: bool = False) -> Case | None:
    """Return a case; the seed chooses motion and encoder. None means that the method is not within `CLEAN` without
    wrong counts. With `start`, counts are wrong from the start instead of from a third on."""
    machine = AXES[axis]
    motion, increments = MOTIONS[seed % 3], INCREMENTS[seed // 3 % len(INCREMENTS)]
    record = machine_record(machine, "nothing", motion, increments, 700 + seed)
    estimator = METHODS[method](
        Drive(machine.drive.input_gain),
        Encoder(record.resolution),
        machine.dt,
        CUTOFF / machine.dt,
        forgetting=1 - 1 / MEMORY,
        precision=precision,
    )
    clean, n = estimator.run(record.u, record.counts), record.u.size
    if not np.max(np.abs(clean.theta[n // 3 :, 0] / machine.drive.mass - 1)) < CLEAN:
        return None
    return Case(axis, method, estimator, record, clean, 0 if start else n // 3, n - 2 * MEMORY - 60, n // 3)


def wrong_sizes(kind: str, largest: int, faults: int, rng: np.random.Generator) -> Counts:
    """Return signed sizes (faults,) [counts]."""
    signs = rng.choice([-1, 1], faults)
    if kind == "constant":
        return largest * signs
    if kind == "constant, one sign":
        return np.full(faults, largest * signs[0])
    if kind == "log-uniform":
        return signs * np.rint(3.0 * (largest / 3) ** rng.random(faults)).astype(np.int64)
    return rng.integers(-largest, largest + 1, faults)


def wrong_places(kind: str, rate: float, case: Case, rng: np.random.Generator) -> NDArray[np.intp]:
    """Return places (k,), at least one."""
    samples = case.last - case.first
    faults = max(1, round(rate * samples))
    if kind != "clustered":
        return np.sort(case.first + rng.choice(samples, faults, replace=False))
    starts = case.first + rng.choice(samples - WITHIN, max(1, round(faults / CLUSTER)), replace=False)
    return np.unique([start + rng.choice(WITHIN, CLUSTER, replace=False) for start in starts])


def harm(case: Case, places: NDArray[np.intp], sizes: Counts) -> Harm:
    """Return the effect of wrong counts of sizes (k,) at places (k,)."""
    counts = case.record.counts.copy()
    counts[places] += sizes
    case.estimator.reset()
    track = case.estimator.run(case.record.u, counts)
    apart = np.abs(track.theta[:, 0] - case.clean.theta[:, 0])[case.judged :] / AXES[case.axis].drive.mass
    flagged = track.has_status(FLAGS)[case.judged :]
    after = apart[places[-1] + 2 * MEMORY + 1 - case.judged]
    return Harm(float(np.max(apart[~flagged], initial=0.0)), float(apart.max()), float(after), float(flagged.mean()))


def harm_of(case: Case, kind: str, rate: float, largest: int, seed: int) -> Harm:
    """Return the effect of wrong counts at this rate, of this kind, up to a largest size."""
    rng = np.random.default_rng([seed, largest, round(1e4 * rate), KINDS.index(kind)])
    places = wrong_places(kind, rate, case, rng)
    return harm(case, places, wrong_sizes(kind, largest, places.size, rng))


def harms(axis: str, method: str, seeds: int, start: bool) -> Iterator[Harm]:
    """Yield the effect of every kind, rate and size, in both precisions."""
    for seed in range(seeds):
        for precision in PRECISIONS:
            case = case_of(axis, method, seed, precision, start)
            if case is not None:
                for kind, rate, largest in product(KINDS, RATES, LARGEST):
                    yield harm_of(case, kind, rate, largest, seed)


def mutated(
    case: Case, places: NDArray[np.intp], sizes: Counts, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return some sizes with another factor or sign, and some places moved, often next to another place."""
    places, sizes = places.copy(), sizes.astype(np.float64)
    some = rng.random(places.size) < rng.choice([1.5 / places.size, 0.2])
    sizes[some] *= np.exp(rng.normal(0.0, rng.choice([0.1, 1.0]), some.sum())) * rng.choice([1, 1, 1, -1], some.sum())
    sizes = np.clip(np.where(np.abs(sizes) < 3, np.copysign(3.0, sizes), sizes), -1e6, 1e6)
    moved = rng.random(places.size) < rng.choice([0.0, 1.0 / places.size])
    near = rng.choice(places, moved.sum()) + rng.integers(1, 4, moved.sum())
    places[moved] = np.where(rng.random(moved.sum()) < 0.7, near, rng.integers(case.first, case.last, moved.sum()))
    places, first = np.unique(np.minimum(places, case.last), return_index=True)
    return places, np.rint(sizes[first]).astype(np.int64)


def climb(case: Case, rate: float, seconds: float, rng: np.random.Generator) -> tuple[float, Harm, int]:
    """Find sizes and places with the largest unflagged deviation, by hill climbing. Returns the first deviation, the
    worst one, and the number of trials."""
    places = wrong_places("uniform", rate, case, rng)
    sizes = wrong_sizes("log-uniform", 1000, places.size, rng)
    worst = harm(case, places, sizes)
    began, tried, end = worst.silent, 1, time.monotonic() + seconds
    while time.monotonic() < end:
        other = mutated(case, places, sizes, rng)
        found, tried = harm(case, *other), tried + 1
        if found.silent >= worst.silent:
            worst, (places, sizes) = found, other
    return began, worst, tried


def size_rows(seeds: int, start: bool = False) -> list[list[str]]:
    """Return a row for each axis and method; `start` is that of `case_of`."""
    rows = []
    for axis in AXES:
        for method in METHODS:
            found = list(harms(axis, method, seeds, start))
            if found:
                silent, after = (100 * np.array([getattr(one, part) for one in found]) for part in ("silent", "after"))
                held = " (held back)" if axis in HELD_BACK else ""
                numbers = [np.quantile(silent, 0.99), silent.max(), after.max()]
                beyond = [str(int(np.sum(x > 100 * most))) for x, most in ((silent, FAR), (after, FORGOTTEN))]
                flagged = f"{100 * np.mean([one.flagged for one in found]):.0f}"
                usual, largest, late = (f"{x:.2g}" for x in numbers)
                row = [axis + held, method, str(len(found)), beyond[0], usual, largest, beyond[1], late, flagged]
                rows.append(row)
                print(" | ".join(rows[-1]), flush=True)
    return rows


def adversary_rows(seconds: float, rate: float = 0.01) -> list[list[str]]:
    """Return a row for each axis and method, with equal shares of the time."""
    rows, rng = [], np.random.default_rng(29)
    for axis in AXES:
        for method in METHODS:
            case = next(one for one in (case_of(axis, method, seed) for seed in (4, 1, 7, 0)) if one is not None)
            began, worst, tried = climb(case, rate, seconds / (len(AXES) * len(METHODS)), rng)
            numbers = [f"{100 * x:.2g}" for x in (began, worst.silent, worst.largest, worst.after)]
            rows.append([axis, method, str(tried), *numbers])
            print(" | ".join(rows[-1]), flush=True)
    return rows

"""Study the effect of counter jumps, wrong readings and spikes on the estimators, as a page:
`python -m studies.glitches --out results/glitches.md`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from pmfid.encoder import Encoder
from pmfid.estimators import ForgettingScheme, Precision
from pmfid.estimators.iv import RIV
from pmfid.estimators.recursive import BCRLS, RLS, RecursiveEstimator
from pmfid.estimators.results import Track
from pmfid.models.drive import Drive
from pmfid.status import Status
from pmfid.types import Counts, Floats
from studies import glitch_sizes
from studies.machines import AXES, Axis, machine_record
from studies.paper.truth import CartRecord, table
from studies.sections import write_page

KINDS = ("jump", "jump at rest", "glitch", "1 % glitches", "spike")
#: Smallest and largest size, as powers of ten [counts, times the largest input].
SIZES: Mapping[str, tuple[float, float]] = MappingProxyType(
    {"jump": (2.0, 9.0), "glitch": (2.0, 9.0), "1 % glitches": (2.0, 9.0), "spike": (1.5, 30.0)}
)
REST_JUMP = 10
#: Samples without a count that mean rest.
REST = 20
MOTIONS = ("prbs", "stop-and-go")
INCREMENTS = (4096, 1024, 256)
METHODS: Mapping[str, type[RecursiveEstimator]] = MappingProxyType(
    {"riv": RIV, "bcrls": BCRLS, "rls": RLS, "rls, directional": RLS}
)
#: Memory of the estimators [samples], and the pole of their filters times the sample period.
MEMORY, CUTOFF = 500, 0.5
#: Axes held back; the guard was tuned on the others.
HELD_BACK = ("spindle", "gantry")
#: A deviation is relative to the parameter, or to this number of standard deviations if the latter are larger.
STDS = 50.0
SUSPICIOUS = Status.COUNT_JUMP | Status.INVALID_INPUT


@dataclass(frozen=True)
class Spoiled:
    """A record with faults at places (k,), beyond the first third."""

    u: Floats
    counts: Counts
    places: NDArray[np.intp]


@dataclass(frozen=True)
class Effect:
    """The effect of faults.

    `missed` counts the faults without a flag at their sample. `largest` and `after` are the largest deviation of a
    parameter from the track without the faults: from the first fault on, and two memories after it. A deviation of 0.02
    is 2 % of the parameter, or one standard deviation of either track if that is larger.
    """

    missed: int
    faults: int
    largest: float
    after: float


def spoil(kind: str, u: Floats, counts: Counts, rng: np.random.Generator) -> Spoiled | None:
    """Return a record of (n,) samples with a fault of this kind at a random place; None if the axis never rests."""
    n = u.size
    places = np.array([rng.integers(n // 3, n - 2 * MEMORY - 50)])
    if kind == "1 % glitches":
        places = n // 3 + np.flatnonzero(rng.random(n - n // 3) < 0.01)
    if kind == "jump at rest":
        resting = np.flatnonzero(np.convolve(np.diff(counts, prepend=counts[0]) != 0, np.ones(REST))[:n] == 0)
        resting = resting[(resting > n // 3) & (resting < n - 2 * MEMORY - 50)]
        if resting.size == 0:
            return None
        places = rng.choice(resting, 1)
    return spoil_at(kind, u, counts, places, sizes_of(kind, places.size, rng))


def sizes_of(kind: str, faults: int, rng: np.random.Generator) -> Floats:
    """Return signed sizes (faults,) of faults of this kind [counts, or times the largest input]."""
    signs = rng.choice([-1.0, 1.0], faults)
    return np.asarray(signs * 10 ** rng.uniform(*SIZES.get(kind, (1.0, 1.0)), faults))


def spoil_at(kind: str, u: Floats, counts: Counts, places: NDArray[np.intp], size: Floats) -> Spoiled:
    """Return a record of (n,) samples with faults of sizes (k,) at places (k,)."""
    u, counts = u.copy(), counts.copy()
    if kind == "spike":
        u[places] = size * np.max(np.abs(u))
    elif kind.startswith("jump"):
        counts[places[0] :] += round(float(size[0]))
    else:
        counts[places] += size.astype(np.int64)
    return Spoiled(u, counts, places)


def effect(estimator: RecursiveEstimator, clean: Track, record: Spoiled) -> Effect:
    """Return the effect of the faults on an estimator with a known track without them."""
    estimator.reset()
    track = estimator.run(record.u, record.counts)
    first = int(record.places[0])
    std = np.maximum(clean.theta_std[first:], track.theta_std[first:])
    scale = np.maximum(np.abs(clean.theta[first:]), STDS * std)
    apart = np.max(np.abs(track.theta[first:] - clean.theta[first:]) / scale, axis=1)
    missed = int(np.sum(~track.has_status(SUSPICIOUS)[record.places]))
    return Effect(missed, record.places.size, float(apart.max()), float(apart[2 * MEMORY]))


def make(method: str, axis: Axis, resolution: float, *, precision: Precision = "float64") -> RecursiveEstimator:
    """Return a recursive estimator of an axis."""
    scheme: ForgettingScheme = "directional" if method.endswith("directional") else "exponential"
    return METHODS[method](
        Drive(axis.drive.input_gain),
        Encoder(resolution),
        axis.dt,
        CUTOFF / axis.dt,
        forgetting=1 - 1 / MEMORY,
        forgetting_scheme=scheme,
        precision=precision,
    )


def effects(name: str, kind: str, places: int, seed: int = 0) -> Iterator[tuple[str, Effect]]:
    """Yield method and effect of `places` faults in each motion of an axis, through each encoder."""
    for motion in MOTIONS:
        for increments in INCREMENTS:
            record: CartRecord = machine_record(AXES[name], "nothing", motion, increments, 50 + seed)
            for method in METHODS:
                estimator = make(method, AXES[name], record.resolution)
                clean, rng = estimator.run(record.u, record.counts), np.random.default_rng([seed, increments])
                for _ in range(places):
                    spoiled = spoil(kind, record.u, record.counts, rng)
                    if spoiled is not None:
                        yield method, effect(estimator, clean, spoiled)


def healthy(name: str) -> tuple[int, int]:
    """Return the number of flagged samples of an axis without faults, and the number of samples."""
    flagged, samples = 0, 0
    for motion in (*MOTIONS, "multisine"):
        for wrong in ("nothing", "Stribeck 30 %"):
            for increments in (*INCREMENTS, 32):
                record = machine_record(AXES[name], wrong, motion, increments, 90)
                track = make("rls", AXES[name], record.resolution).run(record.u, record.counts)
                flagged, samples = flagged + int(track.has_status(SUSPICIOUS).sum()), samples + record.u.size
    return flagged, samples


def sizes_part(seeds: int, seconds: float) -> list[str]:
    """Return the tables of wrong counts of every size and of an adversary, for `seeds` records and `seconds` of
    search.
    """
    study = glitch_sizes
    columns = [
        "axis",
        "method",
        "runs",
        f"silent beyond {100 * study.FAR:g} %",
        "silent, 99 % [%]",
        "largest [%]",
        f"after beyond {100 * study.FORGOTTEN:g} %",
        "largest [%]",
        "flagged samples [%]",
    ]
    rates = ", ".join(f"{100 * rate:g}" for rate in study.RATES)
    return [
        "## Wrong counts of every size",
        "",
        f"From a third of a record on {rates} % of the counts are wrong; sizes {', '.join(study.KINDS)} "
        f"({study.CLUSTER} within {study.WITHIN} samples), up to "
        f"{', '.join(f'{size:,}' for size in study.LARGEST)} counts; {seeds} records per axis of "
        f"{', '.join(MOTIONS)} and multisine, encoders of {', '.join(map(str, study.INCREMENTS))} increments, float64 "
        f"and float32, a memory of {study.MEMORY} samples; only where the mass is within {100 * study.CLEAN:g} % "
        "without wrong counts. Deviation of the mass from the track without them, in percent of the mass, where the "
        "status flags nothing (`standstill`, `feedback` and `fallback` are no flags), and two memories after the last "
        "one.",
        "",
        *table(columns, study.size_rows(seeds)),
        "",
        "The same where counts are wrong from the first sample on, while the guard learns what a motion may do; the "
        f"first third of the record is not judged; {max(1, seeds // 5)} records:",
        "",
        *table(columns, study.size_rows(max(1, seeds // 5), start=True)),
        "",
        f"An adversary changes sizes and places of 1 % of the counts for {seconds:g} s in all, and keeps what makes "
        "the silent deviation larger:",
        "",
        *table(
            ["axis", "method", "tried", "silent at first [%]", "silent [%]", "largest [%]", "after [%]"],
            study.adversary_rows(seconds),
        ),
        "",
    ]


def page(places: int = 50, seeds: int = 20, adversary: float = 3600.0) -> str:
    """Return the page with `places` places of each kind on every record; `seeds` and `adversary` [s] go to
    `sizes_part`.
    """
    rows = []
    for name in AXES:
        for kind in KINDS:
            found = list(effects(name, kind, places))
            if found:
                values = [one for _, one in found]
                largest, after = (
                    100 * np.array([getattr(one, part) for one in values]) for part in ("largest", "after")
                )
                missed, faults = sum(one.missed for one in values), sum(one.faults for one in values)
                numbers = [
                    f"{x:.2g}"
                    for x in (*np.quantile(largest, (0.5, 0.99)), largest.max(), np.quantile(after, 0.99), after.max())
                ]
                held = " (held back)" if name in HELD_BACK else ""
                rows.append([name + held, kind, str(len(values)), f"{missed} of {faults}", *numbers])
                print(" | ".join(rows[-1]), flush=True)
    flags = [[name, *(str(part) for part in healthy(name))] for name in AXES]
    return "\n".join(
        [
            "# Samples that no motion explains",
            "",
            f"Written by `python -m studies.glitches`. `{'`, `'.join(METHODS)}` with a memory of {MEMORY} "
            f"samples, filter time constant {1 / CUTOFF:g} T, {' and '.join(MOTIONS)}, encoders of {INCREMENTS} "
            "increments, "
            f"{places} places each, sizes of 100 to 1e9 counts ({REST_JUMP} at rest) and 30 to 1e30 times the largest "
            "input, drawn evenly in their logarithm. Deviation: of the worst parameter from the track without the "
            f"fault, in percent of the parameter, or of {STDS:g} of its standard deviations, with the fault or "
            "without, where they are more, at any time from the fault on (median, 99 % quantile, largest), and two "
            "memories after it (99 %, largest).",
            "",
            *table(
                [
                    "axis",
                    "fault",
                    "runs",
                    "not flagged",
                    "median [%]",
                    "99 % [%]",
                    "largest [%]",
                    "after, 99 % [%]",
                    "largest [%]",
                ],
                rows,
            ),
            "",
            "Without faults, with the right friction and with Stribeck's, 4096 to 32 increments:",
            "",
            *table(["axis", "flagged samples", "of"], flags),
            "",
            *sizes_part(seeds, adversary),
        ]
    )


if __name__ == "__main__":
    write_page(page, __doc__)

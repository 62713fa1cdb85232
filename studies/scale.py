"""Study the memory of an estimate after a change of the input's amplitude, as a page:
`python -m studies.scale --out results/scale.md`.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from pmfid.encoder import Encoder
from pmfid.estimators import PRECISIONS, Precision
from pmfid.estimators.iv import RIV
from pmfid.estimators.recursive import BCRLS, RLS, RecursiveEstimator
from pmfid.models.drive import Drive
from pmfid.simulation import Schedule, prbs, quantize, simulate_drive
from studies.machines import AXES, Axis
from studies.paper.truth import CartRecord, table

#: Ratio of the new amplitude to the old amplitude.
FACTORS = (1 / 100, 1 / 30, 1 / 10, 1 / 3, 1.0, 3.0, 10.0, 30.0, 100.0)
#: Numbers of memories at the old amplitude, at the new amplitude, and at the new amplitude with another mass.
STRETCHES = (10, 2, 3)
#: Memory of the estimators: at least this many samples, and at least this many time constants of the axis.
MEMORY, TIME_CONSTANTS = 500, 5
#: The pole of the filters times the sample period.
CUTOFF = 1 / 3
#: The force of the smaller input over the Coulomb friction.
LEAST_FORCE = 4.0
#: Ratios of the new mass to the old mass, for even and for odd seeds.
LOADS = (1.3, 0.7)
CLASSES: Mapping[str, type[RecursiveEstimator]] = MappingProxyType({"riv": RIV, "bcrls": BCRLS, "rls": RLS})
#: Axes on which nothing was chosen.
HELD_BACK = ("spindle", "gantry")
LIMIT = 0.05


@dataclass(frozen=True)
class Setting:
    """The measured object: estimator and precision."""

    method: str
    precision: Precision


@dataclass(frozen=True)
class Outcome:
    """The outcome of a run.

    `factor` is the factor of the amplitude, and `error` the relative error of the mass at the end. Least squares is
    compared to an estimator that sees only the last stretch. `flagged` means a status at the end.
    """

    setting: Setting
    factor: float
    error: float
    flagged: bool


def settings() -> list[Setting]:
    """Return all combinations."""
    return [Setting(method, precision) for method in CLASSES for precision in PRECISIONS]


def memory(axis: Axis) -> int:
    """Return the memory of the axis's estimators [samples]."""
    drive = axis.drive
    return max(MEMORY, math.ceil(TIME_CONSTANTS * drive.mass / drive.viscous_friction / axis.dt))


def make(setting: Setting, axis: Axis) -> RecursiveEstimator:
    """Return the estimator of an axis."""
    return CLASSES[setting.method](
        Drive(axis.drive.input_gain),
        Encoder(axis.resolution),
        axis.dt,
        CUTOFF / axis.dt,
        forgetting=1 - 1 / memory(axis),
        precision=setting.precision,
    )


def amplitude_step(axis: Axis, factor: float, seed: int) -> CartRecord:
    """Return a random binary input that changes its amplitude by `factor`, with another mass two memories later."""
    rng = np.random.default_rng([seed, 13])
    ends = np.cumsum(STRETCHES) * memory(axis)
    least = LEAST_FORCE * axis.drive.coulomb_friction / axis.drive.input_gain
    u = prbs(int(ends[-1]), clock=axis.clock, amplitude=least, rng=rng)
    u[: ends[0]] *= max(1.0, 1 / factor)
    u[ends[0] :] *= max(1.0, factor)
    loaded = replace(axis.drive, mass=LOADS[seed % 2] * axis.drive.mass)
    x = simulate_drive(Schedule(((0.0, axis.drive), (float(ends[1]) * axis.dt, loaded))), u, axis.dt).x
    return CartRecord(u, quantize(x, axis.resolution, axis.resolution * rng.random()), axis.resolution)


def outcomes(name: str, factor: float, seeds: int) -> Iterator[Outcome]:
    """Yield the outcomes of every setting on `seeds` records of an axis."""
    axis = AXES[name]
    estimators = {setting: make(setting, axis) for setting in settings()}
    last = STRETCHES[-1] * memory(axis)
    for seed in range(seeds):
        record = amplitude_step(axis, factor, seed)
        for setting, estimator in estimators.items():
            estimator.reset()
            track = estimator.run(record.u, record.counts)
            target = LOADS[seed % 2] * axis.drive.mass
            if setting.method == "rls":
                estimator.reset()
                target = float(estimator.run(record.u[-last:], record.counts[-last:])["mass"][-1])
            yield Outcome(setting, factor, abs(track["mass"][-1] / target - 1), bool(track.status[-1]))


def row(found: Sequence[Outcome]) -> list[str]:
    """Return the cells: median, 99 % quantile and largest error [%], and the factor of the largest. Further cells count
    the errors beyond the limit, and the unflagged errors beyond the limit."""
    errors = 100 * np.array([one.error for one in found])
    beyond = [one for one in found if not one.error <= LIMIT]
    silent = sum(not one.flagged for one in beyond)
    worst = found[int(np.argmax(errors))].factor
    numbers = [f"{x:.2g}" for x in (np.median(errors), np.quantile(errors, 0.99), errors.max())]
    return [*numbers, f"{worst:.2g}", f"{len(beyond)} of {len(found)}", str(silent)]


def rows(name: str, seeds: int, factors: Sequence[float]) -> list[list[str]]:
    """Return the table's rows of one axis."""
    found = [one for factor in factors for one in outcomes(name, factor, seeds)]
    held = " (held back)" if name in HELD_BACK else ""
    return [
        [name + held, one.method, one.precision, *row([part for part in found if part.setting == one])]
        for one in settings()
    ]


def page(axes: Sequence[str], seeds: int, factors: Sequence[float]) -> str:
    """Return the page with `seeds` records of each axis and factor."""
    lines = []
    for name in axes:
        for line in rows(name, seeds, factors):
            lines.append(line)
            print(" | ".join(line), flush=True)
    head = ["axis", "method", "precision", "median [%]", "99 % [%]", "largest [%]", "at factor"]
    before, between, after = STRETCHES
    return "\n".join(
        [
            "# After a change of the input's amplitude",
            "",
            f"Written by `python -m studies.scale`: {seeds} records for each factor "
            f"({', '.join(f'{factor:.2g}' for factor in factors)}). A random binary input for {before} memories of "
            f"at least {MEMORY} samples and {TIME_CONSTANTS} time constants of the axis, with another amplitude for "
            f"{between + after}, of which the last {after} with a mass of "
            f"{' or '.join(f'{load:g}' for load in LOADS)} times the first. The smaller amplitude has "
            f"{LEAST_FORCE:g} times the Coulomb friction; encoders of 4096 increments, filter time constant "
            f"{1 / CUTOFF:g} T. Error of the mass at the end. "
            "Least squares has a bias of its own where the motion is small for the encoder, with or without a "
            "history; its error is against the same estimator that saw the last stretch alone, that of the others "
            "against the truth.",
            "",
            *table([*head, f"beyond {100 * LIMIT:g} %", "without a flag"], lines),
            "",
        ]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="the page")
    parser.add_argument("--seeds", type=int, default=20, help="records of each axis and factor (default: %(default)s)")
    parser.add_argument("--axes", nargs="+", choices=list(AXES), default=list(AXES), help="(default: all)")
    parser.add_argument("--factors", nargs="+", type=float, default=list(FACTORS), help="(default: all)")
    options = parser.parse_args()
    text = page(options.axes, options.seeds, options.factors)
    if options.out is not None:
        options.out.write_text(text, "utf-8")


if __name__ == "__main__":
    main()

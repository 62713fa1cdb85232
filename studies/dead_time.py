"""A dead time of the input, estimated and left out, as a page:
`python -m studies.dead_time --out docs/dead_time.md`."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from pmfid.encoder import Encoder
from pmfid.errors import NotIdentifiableError
from pmfid.estimators.adequacy import examine
from pmfid.estimators.base import Estimator
from pmfid.estimators.batch import BatchEstimator
from pmfid.estimators.configuration import like
from pmfid.estimators.interval import IntervalML
from pmfid.estimators.iv import IV, RIV
from pmfid.estimators.output_error import OE
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.judge.late import late
from pmfid.models.drive import Drive
from pmfid.paper.truth import CartRecord, table
from pmfid.simulation import Machine, control_machine, drive_machine, prbs, stop_and_go
from pmfid.types import Floats
from studies.machines import AXES, OTHERWISE, Axis, truth

#: In samples.
DEAD_TIMES = (0.0, 0.1, 0.5, 1.0, 1.7, 3.0)
INCREMENTS = (4096, 1024, 256, 128)
MOTIONS = ("prbs", "stop-and-go")
#: The pole of the filters times the sample period, and the time [samples] at which `riv` is looked at on the way.
CUTOFF, ON_THE_WAY = 0.2, 1000
#: Of the simulation in each sample: of a lag it takes the mean over each.
STEPS = 40
METHODS: Mapping[str, type[Estimator]] = MappingProxyType(
    {"iv": IV, "output-error": OE, "interval": IntervalML, "riv": RIV}
)


@dataclass(frozen=True)
class Estimated:
    """late: dead time found less the true one [samples]; errors (3,): of mass, viscous and Coulomb friction, relative;
    bars (3,): standard deviations over those of the method that knows the dead time; inside: the share of the four
    numbers within 3 of their standard deviations."""

    late: float
    errors: Floats
    bars: Floats
    inside: float


def late_record(
    axis: Axis, samples: float, motion: str, increments: int, seed: int, kind: str = "dead_time"
) -> CartRecord:
    """One run of an axis with a dead time, or a lag, of so many samples."""
    rng = np.random.default_rng([seed, 15])
    resolution = axis.resolution * 4096 / increments
    phase, machine = resolution * rng.random(), Machine(axis.drive, **{kind: samples * axis.dt})
    if motion == "prbs":
        u = prbs(axis.samples, clock=axis.clock, amplitude=axis.volt, rng=rng)
        return CartRecord(
            u, drive_machine(machine, u, axis.dt, resolution, phase=phase, steps=STEPS).counts, resolution
        )
    stroke = axis.stroke * (1 + OTHERWISE * rng.uniform(-1, 1))
    reference = stop_and_go(axis.samples, axis.dt, stroke, axis.move, axis.dwell)
    kp, kd, u_max = (axis.control[name] for name in ("kp", "kd", "u_max"))
    run = control_machine(machine, reference, axis.dt, resolution, kp=kp, kd=kd, u_max=u_max, phase=phase, steps=STEPS)
    return CartRecord(run.u, run.counts, resolution)


def estimator_of(axis: Axis, record: CartRecord, method: str) -> Estimator:
    model = Drive(axis.drive.input_gain, dead_time="estimate")
    return METHODS[method](model, Encoder(record.resolution), axis.dt, CUTOFF / axis.dt)


def estimate(estimator: Estimator, record: CartRecord, end: int | None = None) -> tuple[Floats, Floats]:
    """theta and standard deviations (p,) at the end of a record."""
    if isinstance(estimator, BatchEstimator):
        fit = estimator.fit(record.u, record.counts)
        return fit.theta, fit.theta_std
    if not isinstance(estimator, RecursiveEstimator):
        raise TypeError(f"{estimator.method} is neither of the kinds")
    track = estimator.run(record.u[:end], record.counts[:end])
    return track.theta[-1], track.theta_std[-1]


def judged(axis: Axis, samples: float, record: CartRecord, method: str, end: int | None = None) -> Estimated | None:
    """None: refused."""
    estimator, true = estimator_of(axis, record, method), truth(axis)
    known = like(type(estimator), estimator, model=estimator.model.at_dead_time(samples * axis.dt))
    try:
        theta, std = estimate(estimator, record, end)
        bars = estimate(known, record, end)[1]
    except NotIdentifiableError:
        return None
    error = theta - np.r_[true, samples * axis.dt]
    inside = float(np.mean(np.abs(error) < 3 * std))
    return Estimated(float(error[3] / axis.dt), error[:3] / true, std[:3] / bars, inside)


def rows(axis: Axis, motions: Sequence[str], increments: Sequence[int], seeds: int) -> Iterator[list[str]]:
    for motion in motions:
        for fine in increments:
            records = [
                (samples, late_record(axis, samples, motion, fine, seed))
                for seed in range(1, seeds + 1)
                for samples in DEAD_TIMES
            ]
            for method in METHODS:
                end = ON_THE_WAY if method == "riv" else None
                found = [judged(axis, samples, record, method, end) for samples, record in records]
                yield [motion, f"{fine}", f"`{method}`", *_cells([one for one in found if one], len(found))]


def _cells(found: list[Estimated], runs: int) -> list[str]:
    if not found:
        return [f"{runs} of {runs}", *["–"] * 6]
    late = max(abs(one.late) for one in found)
    errors = 100 * np.max([np.abs(one.errors) for one in found], axis=0)
    bars = float(np.max(np.median([one.bars for one in found], axis=0)))
    inside = 100 * float(np.mean([one.inside for one in found]))
    return [
        f"{runs - len(found)} of {runs}",
        f"{late:.3f}",
        *(f"{e:.2f}" for e in errors),
        f"{bars:.2f}",
        f"{inside:.0f}",
    ]


def told(axis: Axis, motions: Sequence[str], increments: Sequence[int], seeds: int) -> Iterator[list[str]]:
    """How often a model without one is told of it, for each dead time."""
    for motion in motions:
        for fine in increments:
            shares = []
            for samples in DEAD_TIMES:
                runs = [late_record(axis, samples, motion, fine, seed) for seed in range(1, seeds + 1)]
                shares.append(f"{sum(is_told(axis, run) for run in runs)} of {len(runs)}")
            yield [motion, f"{fine}", *shares]


def is_told(axis: Axis, record: CartRecord) -> bool:
    estimator = estimator_of(axis, record, "iv")
    plain = replace(estimator, model=estimator.model.at_dead_time(0.0))
    try:
        found = examine(plain, record.u, record.counts)
    except NotIdentifiableError:
        return False
    return not found.adequate and any(late(found))


HEADER = [
    "motion", "increments", "method", "refused", "dead time off by [samples]", "mass [%]", "viscous [%]", "Coulomb [%]",
    "bar over known", "within 3 bars [%]",
]  # fmt: skip


def page(names: Sequence[str], motions: Sequence[str], increments: Sequence[int], seeds: int) -> str:
    taken = ", ".join(f"{samples:g}" for samples in DEAD_TIMES)
    lines = [
        "# A dead time of the input",
        "",
        "Written by",
        "",
        f"    python -m studies.dead_time --out docs/dead_time.md --seeds {seeds} --axes {' '.join(names)}",
        "",
        f'True dead times {taken} samples, {seeds} seeds each; the model has dead_time = "estimate". The largest',
        f"error of all runs; `riv` after {ON_THE_WAY} samples, from a dead time of 0 on. Bar over known: the standard",
        "deviation of the worst parameter over that of the same method which knows the dead time, median of the runs.",
        "A dead time is the same whether the input acts late or the counts are read late.",
        "",
    ]
    head = ["motion", "increments", *(f"{samples:g}" for samples in DEAD_TIMES)]
    for name in names:
        axis = AXES[name]
        lines += [f"## {name}: {axis.drive.mass:g}, T = {1e3 * axis.dt:g} ms", ""]
        lines += table(HEADER, list(rows(axis, motions, increments, seeds)))
        lines += ["Told of, where the model has none, by its true size [samples]:", ""]
        lines += table(head, list(told(axis, motions, increments, seeds)))
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--axes", nargs="+", default=list(AXES))
    parser.add_argument("--motions", nargs="+", default=list(MOTIONS))
    parser.add_argument("--increments", nargs="+", type=int, default=list(INCREMENTS))
    options = parser.parse_args()
    options.out.write_text(page(options.axes, options.motions, options.increments, options.seeds), encoding="utf-8")


if __name__ == "__main__":
    main()

"""Study a dead time, or a lag, of the input that is estimated or left out:
`python -m studies.dead_time --out results/dead_time.md`.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from pmfid.diagnostics.drives import late
from pmfid.encoder import Encoder
from pmfid.errors import NotIdentifiableError
from pmfid.estimators.adequacy import examine
from pmfid.estimators.base import Estimator
from pmfid.estimators.batch import BatchEstimator
from pmfid.estimators.iv import IV, RIV
from pmfid.estimators.output_error import OE, IntervalML
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.models.drive import Drive, Late
from pmfid.models.equation import ESTIMATE
from pmfid.simulation import Machine, control_machine, drive_machine, prbs, stop_and_go
from pmfid.status import Status
from pmfid.types import Floats
from studies.machines import AXES, OTHERWISE, Axis, truth
from studies.paper.truth import CartRecord, table

MOTIONS = ("prbs", "stop-and-go")
#: The pole of the filters times the sample period, and the time [samples] of the early look at `riv`.
CUTOFF, ON_THE_WAY = 0.2, 1000
#: Steps of the simulation in each sample; for a lag, each step has the mean input.
STEPS = 40
METHODS: Mapping[str, type[Estimator]] = MappingProxyType(
    {"iv": IV, "output-error": OE, "interval": IntervalML, "riv": RIV}
)
OFFLINE, SHORT, RECURSIVE = ("iv", "output-error", "interval"), ("iv", "interval"), ("riv",)
#: Number of seeds whose bars are compared to those for a known dead time, and number of seeds for the reports.
COMPARED, ASKED = 2, 5
#: Status bits that mark an estimate as invalid.
SAID = Status.FALLBACK | Status.DEAD_TIME | Status.STARTING
#: Dead time [samples] of the bound.
BOUND_AT = 0.5
#: Steps of the difference quotients for the bound, as a fraction of a parameter and, for the dead time, in samples.
STEP = 1e-3


@dataclass(frozen=True)
class Piece:
    """Runs of one axis; the delay is `kind`, an option of the model, and `times` are its sizes [samples]."""

    axis: str
    kind: str
    motions: tuple[str, ...]
    increments: tuple[int, ...]
    times: tuple[float, ...]
    seeds: int
    methods: tuple[str, ...]

    @property
    def title(self) -> str:
        axis, times = AXES[self.axis], ", ".join(f"{time:g}" for time in self.times)
        what = f"{self.axis}, {axis.drive.mass:g}, T = {1e3 * axis.dt:g} ms"
        which = ", `riv`" if self.methods == RECURSIVE else ""
        return f"{what}{which}: {self.kind.replace('_', ' ')} of {times} samples, {self.seeds} seeds each"


FINE, SOME, BETWEEN = (4096, 1024, 256, 128), (0.0, 0.5, 1.7), (0.1, 1.0, 3.0)
EVERY = tuple(sorted(SOME + BETWEEN))
PIECES = (
    Piece("cart", "dead_time", MOTIONS, FINE, EVERY, 20, RECURSIVE),
    Piece("rotary", "dead_time", MOTIONS, FINE, EVERY, 5, RECURSIVE),
    Piece("stage", "dead_time", MOTIONS, FINE, EVERY, 5, RECURSIVE),
    Piece("cart", "dead_time", ("prbs",), (1024, 128), SOME, 20, OFFLINE),
    Piece("cart", "dead_time", ("stop-and-go",), (1024, 256, 128), SOME, 20, OFFLINE),
    Piece("cart", "dead_time", MOTIONS, FINE, BETWEEN, 1, SHORT),
    Piece("cart", "dead_time", MOTIONS, (4096,), SOME, 1, SHORT),
    Piece("rotary", "dead_time", MOTIONS, (1024, 256), SOME, 2, OFFLINE),
    Piece("stage", "dead_time", MOTIONS, (1024, 256), SOME, 2, OFFLINE),
    Piece("cart", "lag", MOTIONS, (1024,), (0.5, 1.7), 1, SHORT),
    Piece("rotary", "lag", MOTIONS, (1024,), (0.5, 1.7), 1, SHORT),
)


@dataclass(frozen=True)
class Estimated:
    """The outcome of an estimate.

    `late` is the estimated dead time minus the true one [samples]. `errors` (3,) are the relative errors of mass,
    viscous and Coulomb friction. `bars` (3,) are the standard deviations, divided by those of the method that knows the
    dead time. `inside` is the fraction of the four numbers within 3 of their standard deviations.
    """

    late: float
    errors: Floats
    bars: Floats
    inside: float


def late_record(
    axis: Axis, samples: float, motion: str, increments: int, seed: int, kind: str = "dead_time"
) -> CartRecord:
    """Simulate one run of an axis with a dead time, or a lag, of `samples` samples."""
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


def estimator_of(
    axis: Axis, record: CartRecord, method: str, late_by: Late = "estimate", kind: str = "dead_time"
) -> Estimator:
    plain = Drive(axis.drive.input_gain)
    model = plain.replace_dead_time(late_by) if kind == "dead_time" else plain.replace_lag(late_by)
    return METHODS[method](model, Encoder(record.resolution), axis.dt, CUTOFF / axis.dt)


def estimate(estimator: Estimator, record: CartRecord, end: int | None = None) -> tuple[Floats, Floats]:
    """Return theta and standard deviations (p,) at the end of a record."""
    if isinstance(estimator, BatchEstimator):
        fit = estimator.fit(record.u, record.counts)
        return fit.theta, fit.theta_std
    if not isinstance(estimator, RecursiveEstimator):
        raise TypeError(f"{estimator.method} is neither of the kinds")
    track = estimator.run(record.u[:end], record.counts[:end])
    if estimator.equation.dead_time == ESTIMATE and Status(int(track.status[-1])) & SAID:
        raise NotIdentifiableError("the status says so")
    return track.theta[-1], track.theta_std[-1]


def judged(axis: Axis, kind: str, samples: float, record: CartRecord, method: str, compared: bool) -> Estimated | None:
    """Return the outcome, or None if the method refuses the record or its status marks the estimate as invalid. With
    `compared`, the bars are divided by the bars of the method that knows the dead time."""
    estimator, true = estimator_of(axis, record, method, kind=kind), truth(axis)
    known = estimator_of(axis, record, method, samples * axis.dt, kind)
    end = ON_THE_WAY if method == "riv" else None
    try:
        theta, std = estimate(estimator, record, end)
        bars = estimate(known, record, end)[1] if compared else np.full(4, np.nan)
    except NotIdentifiableError:
        return None
    error = theta - np.r_[true, samples * axis.dt]
    inside = float(np.mean(np.abs(error) < 3 * std))
    return Estimated(float(error[3] / axis.dt), error[:3] / true, std[:3] / bars[:3], inside)


def rows(piece: Piece) -> Iterator[list[str]]:
    axis = AXES[piece.axis]
    for motion in piece.motions:
        for fine in piece.increments:
            records = [
                (seed, time, late_record(axis, time, motion, fine, seed, piece.kind))
                for seed in range(1, piece.seeds + 1)
                for time in piece.times
            ]
            for method in piece.methods:
                found = [
                    judged(axis, piece.kind, time, record, method, seed <= COMPARED) for seed, time, record in records
                ]
                yield [motion, f"{fine}", f"`{method}`", *_cells([one for one in found if one], len(found))]


def _cells(found: list[Estimated], runs: int) -> list[str]:
    if not found:
        return [f"{runs} of {runs}", *["–"] * 7]
    off = np.array([one.late for one in found])
    errors = 100 * np.max([np.abs(one.errors) for one in found], axis=0)
    bars = float(np.max(np.nanmedian([one.bars for one in found], axis=0)))
    inside = 100 * float(np.mean([one.inside for one in found]))
    return [
        f"{runs - len(found)} of {runs}",
        f"{np.mean(off):.3f}",
        f"{np.max(np.abs(off)):.3f}",
        *(f"{e:.2f}" for e in errors),
        f"{bars:.2f}",
        f"{inside:.0f}",
    ]


def bound(axis: Axis, samples: float, motion: str) -> Floats:
    """Return the growth (3,) of the least standard deviations of mass, viscous and Coulomb friction by an unknown dead
    time.

    This is the Cramer-Rao bound for a white error of the whole simulated position with an unknown start. Central
    differences at the true parameters give the bound. The encoder's step cancels, except in its effect on the input.
    """
    record = late_record(axis, samples, motion, 1024, 1)
    true, late = truth(axis), samples * axis.dt

    def position(theta: Floats) -> Floats:
        drive = replace(axis.drive, mass=theta[0], viscous_friction=theta[1], coulomb_friction=theta[2])
        machine = Machine(drive, dead_time=theta[3])
        return drive_machine(machine, record.u, axis.dt, record.resolution, steps=STEPS).x

    columns = []
    for i, step in enumerate(STEP * np.r_[true, axis.dt]):
        there, size = np.r_[true, late], step * np.eye(4)[i]
        low = np.maximum(there - size, 0.0)
        columns.append((position(there + size) - position(low)) * (step / (there + size - low)[i]))
    sensitivity = np.column_stack([*columns, np.full(record.u.size, np.max(np.abs(columns)))])
    known = np.linalg.inv(np.delete(np.delete(sensitivity.T @ sensitivity, 3, 0), 3, 1))
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(sensitivity.T @ sensitivity))[:3] / np.diag(known)[:3]))


def bounds() -> Iterator[list[str]]:
    """Yield the least cost of an unknown dead time for each axis."""
    for name, axis in AXES.items():
        for motion in MOTIONS:
            yield [name, motion, *(f"{ratio:.1f}" for ratio in bound(axis, BOUND_AT, motion))]


def reported(piece: Piece) -> Iterator[list[str]]:
    """Yield the rate of reported dead times for each size, by a model without a dead time."""
    axis = AXES[piece.axis]
    for motion in piece.motions:
        for fine in piece.increments:
            shares = []
            for time in piece.times:
                seeds = range(1, min(piece.seeds, ASKED) + 1)
                runs = [late_record(axis, time, motion, fine, seed, piece.kind) for seed in seeds]
                shares.append(f"{sum(is_reported(axis, run) for run in runs)} of {len(runs)}")
            yield [motion, f"{fine}", *shares]


def is_reported(axis: Axis, record: CartRecord) -> bool:
    estimator = estimator_of(axis, record, "iv")
    plain = replace(estimator, model=estimator.model.replace_dead_time(0.0))
    try:
        found = examine(plain, record.u, record.counts)
    except NotIdentifiableError:
        return False
    return not found.adequate and any(late(found))


HEADER = [
    "motion", "increments", "method", "refused or said", "off by, mean [samples]", "at most", "mass [%]", "viscous [%]",
    "Coulomb [%]", "bar over known", "within 3 bars [%]",
]  # fmt: skip


READING = (
    "A dead time delays the input as it is; a lag, as that of a current loop, rounds it. To first order they are the",
    "same: where a model has neither, both are fitted, and the sentence names the one that the counts make more",
    'likely, and how the other one does. `riv` takes a known lag, or dead_time = "estimate", which takes up the mean',
    "of both.",
    "",
    "Under control through a coarse encoder the input follows the encoder's error, and so does the instrument of a",
    "dead time, the change of the input. `iv` then takes it from the motion that explains every count, where there is",
    "one, and `riv` from a motion of its own that each count cuts off at its nearest edge, sample by sample. Until the",
    "edges bear that motion out, `riv` says `dead_time` or `fallback`: then its dead time is one that was believed",
    "before, or a guess within what it can delay, and its error bars say as much. Steps in open loop show a dead time",
    "ten times as well. `interval` is the likelihood of the counts itself: what it leaves is what the record does not",
    "say. `iv` keeps to its own instruments in all but the dead time, and knows mass and friction less well for it.",
    "",
)


def page(pieces: Sequence[Piece]) -> str:
    lines = [
        "# A dead time, or a lag, of the input",
        "",
        "Written by",
        "",
        "    python -m studies.dead_time --out results/dead_time.md",
        "",
        'The model has dead_time = "estimate", or lag = "estimate". The errors of the parameters are the largest of',
        f"all runs; `riv` after {ON_THE_WAY} samples, from a dead time of 0 on, where its status does not say that it",
        "does not know (counted as said). Bar over known: the standard",
        "deviation of the worst parameter over that of the same method which knows how late the input acts, median",
        "of some runs. A dead time is the same whether the input acts late or the counts are read late.",
        "",
        *READING,
        "What an unknown dead time costs at least: ratio of the Cramer-Rao bounds of the standard deviations with it",
        f"unknown and known, at {BOUND_AT} samples, for a white error of the whole position. In slow motions against",
        "viscous friction a dead time and a mass do nearly the same.",
        "",
        *table(["axis", "motion", "mass", "viscous", "Coulomb"], list(bounds())),
    ]
    for piece in pieces:
        lines += [f"## {piece.title}", "", *table(HEADER, list(rows(piece)))]
        if piece.methods == RECURSIVE:
            continue
        lines += ["Reported, where the model has none, by its true size [samples]:", ""]
        lines += table(["motion", "increments", *(f"{time:g}" for time in piece.times)], list(reported(piece)))
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--pieces", nargs="+", type=int, default=list(range(len(PIECES))), help="by their number")
    parser.add_argument("--seeds", type=int, help="in place of those of each piece")
    options = parser.parse_args()
    pieces = [PIECES[number] for number in options.pieces]
    if options.seeds:
        pieces = [replace(piece, seeds=options.seeds) for piece in pieces]
    options.out.write_text(page(pieces), encoding="utf-8")


if __name__ == "__main__":
    main()

"""Compare three records of a minute of one axis to one of three minutes: a part of `studies.gaps`."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pmfid.encoder import Encoder
from pmfid.estimators.base import Estimator
from pmfid.estimators.batch import BatchEstimator
from pmfid.estimators.iv import IV
from pmfid.estimators.registry import ESTIMATORS
from pmfid.models.drive import Drive
from pmfid.records.joining import join_records
from pmfid.records.record import Record
from pmfid.simulation import prbs, quantize, simulate_drive
from pmfid.types import Floats
from studies.gap_information import sensitivities
from studies.machines import AXES, truth
from studies.paper.truth import CartRecord, table

DT, SAMPLES, CLOCK, CUTOFF, RECORDS = 0.01, 18_000, 10, 20.0, 3
#: Axis, method and factor of the requested runs.
COMPARED = (("cart", "iv", 6), ("stage", "iv", 4), ("cart", "output-error", 2), ("cart", "interval", 1))


def compared_page(seeds: int) -> Iterator[str]:
    """Yield a row for each axis and method."""
    rows = []
    for axis, method, times in COMPARED:
        pairs = [_pair(axis, method, seed) for seed in range(seeds * times)]
        errors, bars, bounds = (np.array([pair[k] for pair in pairs]) for k in range(3))  # (runs, 2, 3)
        ratio = np.log(bars[:, 1] / bars[:, 0])
        error = np.sqrt(np.mean(errors[:, 1] ** 2, axis=0) / np.mean(errors[:, 0] ** 2, axis=0))
        spread = np.std(ratio, axis=0, ddof=1) / np.sqrt(len(pairs))
        pulls = np.sqrt(np.mean((errors[:, 1] / bars[:, 1]) ** 2, axis=0))
        bound = np.exp(np.mean(np.log(bounds[:, 1] / bounds[:, 0]), axis=0))
        rows.append(
            [
                f"{axis}, {method}",
                str(len(pairs)),
                ", ".join(
                    f"{value:.3f} ± {width:.3f}"
                    for value, width in zip(np.exp(np.mean(ratio, axis=0)), spread, strict=True)
                ),
                *(", ".join(f"{value:.2f}" for value in cell) for cell in (error, bound, pulls)),
            ]
        )
    yield from table(
        ["axis", "runs", "bars, three over one", "errors", "Cramer-Rao bounds", "errors of three over bars"], rows
    )
    yield "Bars are geometric means with their standard errors; the ratio of the root mean square errors of n runs"
    yield "is known to about 1/sqrt(n). The bounds are those of the counts. Where a method weighs the position itself,"
    yield "friction is known from where the axis drifted to within minutes, which three records do not tell."


def _pair(name: str, method: str, seed: int) -> tuple[Floats, Floats, Floats]:
    """Return relative errors, error bars and bounds, (2, 3) each, of the one record and of the three."""
    axis, true = AXES[name], truth(AXES[name])
    rng, resolution = np.random.default_rng([seed, 7]), AXES[name].resolution
    whole = prbs(SAMPLES, clock=CLOCK, amplitude=axis.volt, rng=rng)

    def run(u: Floats) -> CartRecord:
        place = simulate_drive(axis.drive, u, DT).x
        return CartRecord(u, quantize(place, resolution, resolution * rng.random()), resolution)

    one, three = run(whole), [run(u) for u in np.split(whole, RECORDS)]
    parts = [Record(part.u, part.counts, DT, resolution, (), str(k)) for k, part in enumerate(three)]
    joined = join_records(parts, place_matters=False)
    settings = Drive(axis.drive.input_gain), Encoder(resolution), DT, CUTOFF
    estimator: Estimator = ESTIMATORS[method](*settings)
    if not isinstance(estimator, BatchEstimator):
        raise TypeError(method)
    fits = [estimator.fit(record.u, record.counts) for record in (one, joined)]
    known = [sum(_information(IV(*settings), true, part.u) for part in runs) for runs in ([one], three)]
    bounds = [np.sqrt(np.diagonal(np.linalg.inv(information))) for information in known]
    return (
        np.array([fit.theta / true - 1 for fit in fits]),
        np.array([fit.theta_std / true for fit in fits]),
        np.array(bounds),
    )


def _information(method: IV, true: Floats, u: Floats) -> Floats:
    """Return the information (p, p) of the counts of one record with an unknown start."""
    effects, time = sensitivities(method, true, u), np.arange(u.size) * method.dt
    start = np.linalg.qr(np.column_stack([np.ones(u.size), -np.expm1(-true[1] / true[0] * time)]))[0]
    own = effects - (effects @ start) @ start.T
    return np.asarray(12 * own @ own.T)

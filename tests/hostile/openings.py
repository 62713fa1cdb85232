"""Openings of the memory at random places, of one parameter or all, once or twice, and faults that may follow."""

from __future__ import annotations

import numpy as np

from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.status import Status
from tests.hostile.draw import Rng
from tests.test_many import fleet_record, process_record

#: Samples before the first opening, samples in which openings may come, and samples after them.
BEFORE, WITHIN, AFTER = 300, 200, 60
#: An estimate is astray if it exceeds the largest earlier one by the first factor and its error bars by the second.
ASTRAY, CONVINCED = 1e3, 10.0


def faults_of(estimator: RecursiveEstimator, rng: Rng, openings: int) -> list[str]:
    """Return the faults after each opening; the list is empty if none is found."""
    u, counts = (table[0] for table in (process_record() if estimator.equation.process else fleet_record()))
    estimator.reset()
    estimator.run(u[:BEFORE], counts[:BEFORE])
    start = estimator.get_state()
    faults = []
    for _ in range(openings):
        estimator.set_state(start)
        at = BEFORE + int(rng.integers(0, WITHIN))
        estimator.run(u[BEFORE:at], counts[BEFORE:at])
        opened = [_open(estimator, rng) for _ in range(rng.integers(1, 3))]
        fault = _fault(estimator, u[at : at + AFTER], counts[at : at + AFTER])
        faults += [f"{opened} at {at}: {fault}"] if fault else []
    return faults


def _open(estimator: RecursiveEstimator, rng: Rng) -> tuple[str | None, float]:
    keep = float(10.0 ** -rng.uniform(0, 8 if rng.random() < 0.9 else 300))
    parameter = None if rng.random() < 0.2 else estimator.names[rng.integers(len(estimator.names))]
    estimator.open_memory(keep, parameter)
    return parameter, keep


def _fault(estimator: RecursiveEstimator, u: np.ndarray, counts: np.ndarray) -> str:
    largest = float(np.max(np.abs(estimator.estimate.theta)))
    track = estimator.run(u, counts)
    known = track.innovation_variance > 0
    if not (np.all(np.isfinite(track.variance_factor)) and np.all(track.variance_factor >= 0)):
        return "a variance that is negative or not finite"
    if not np.all(np.isfinite(track.theta_std[known])):
        return "an error bar that is not finite"
    if track.has_status(Status.RESET).any():
        return "a reset"
    size, bar = np.abs(track.theta), track.theta_std
    astray = (size > ASTRAY * largest) & (size > CONVINCED * bar) & (track.status == 0)[:, None]
    return "an estimate astray, and nothing says so" if np.any(astray) else ""

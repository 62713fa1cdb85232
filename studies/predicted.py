"""Common parts of the studies of prediction: one record for the estimate, another for the prediction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmfid.diagnostics.free_run import FreeRun, drive_run
from pmfid.encoder import Encoder
from pmfid.errors import PmfidError
from pmfid.estimators.batch import BatchEstimator
from pmfid.estimators.configuration import construct_estimator
from pmfid.estimators.iv import IV
from pmfid.estimators.ls import LS
from pmfid.estimators.output_error import OE
from pmfid.models.drive import Drive
from pmfid.types import Floats

#: Method of the tables -> class and options.
METHODS: dict[str, tuple[type[BatchEstimator], dict[str, object]]] = {
    "ls": (LS, {}),
    "iv": (IV, {}),
    "output-error": (OE, {}),
    "position": (OE, {"drift_cutoff": 0.0}),
    "windows": (OE, {"window": "auto"}),
}
EXPLAINED = (
    "`output-error` is that of the command, after a high-pass where friction drifts; `position` is the same without "
    '(`drift_cutoff` = 0), least squares of the whole simulated position; `windows` is `window = "auto"`.'
)


@dataclass(frozen=True, eq=False)
class Motion:
    """Input (n,), counts (n,), unit of the position per count, sample period [s]."""

    u: Floats
    counts: NDArray[np.int64]
    resolution: float
    dt: float

    def part(self, first: int, last: int) -> Motion:
        return Motion(self.u[first:last], self.counts[first:last], self.resolution, self.dt)


@dataclass(frozen=True, eq=False)
class Predicted:
    """A free run over the other record, its parameters (p,), the method's notes, and the terms that the search
    found.
    """

    run: FreeRun
    theta: Floats
    notes: tuple[str, ...] = ()
    searched: str = ""


def predicted(model: Drive, method: str, cutoff: float, train: Motion, test: Motion) -> Predicted | None:
    """Estimate from one motion by a method of METHODS and predict the other one; return None if the method fails."""
    cls, options = METHODS[method]
    own = {"model": model, "encoder": Encoder(train.resolution), "dt": train.dt, "cutoff": cutoff}
    estimator = construct_estimator(cls, own | options)
    try:
        fit = estimator.fit(train.u, train.counts)
        return Predicted(free_run(model, fit.theta, cutoff, test), fit.theta, fit.notes)
    except PmfidError:
        return None


def free_run(model: Drive, theta: Floats, cutoff: float, test: Motion) -> FreeRun:
    """Return the free run of parameters (p,) on a motion."""
    return drive_run(OE(model, Encoder(test.resolution), test.dt, cutoff), theta, test.u, test.counts, "test")

"""One estimate of one simulated run by name, in the form that the figures need."""

from __future__ import annotations

import math

import numpy as np

from pmfid.errors import NotIdentifiableError
from pmfid.estimators.auto import AUTO, choose, first_choice
from pmfid.estimators.batch import BatchEstimator
from pmfid.estimators.plants import default_zeros
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.results import Track
from pmfid.simulation import CART_DT, Scenario
from pmfid.status import Status
from pmfid.types import Floats
from studies.paper.merit import NO_ANSWER, Score, score
from studies.paper.truth import CartRecord, make_estimator

#: RLS of the extended model, from which BCRLS starts: its bias is not compensated (paper eq. 19 to 21).
EXTENDED = "extended rls"
ON_LINE = ("rls", EXTENDED, "bcrls", "riv")
OFF_LINE = ("iv", AUTO)
TITLES = {
    "rls": "RLS",
    EXTENDED: "extended RLS, the start of BCRLS",
    "bcrls": "BCRLS",
    "riv": "instrumental variables, recursive",
    "iv": "instrumental variables, off-line over each run",
    AUTO: "auto",
}


def record_of(scenario: Scenario) -> CartRecord:
    """Return the part of a run that an estimator may see."""
    return CartRecord(scenario.motion.u, scenario.counts, scenario.resolution)


def track_of(method: str, record: CartRecord, time_constant: float, forgetting: float) -> Track:
    """Return the estimates of a recursive method; `time_constant` of the filters is in samples."""
    if method == EXTENDED:
        zeros = default_zeros(1 / (time_constant * CART_DT))
        estimator = make_estimator("rls", record, time_constant, forgetting=forgetting, prefilter_zeros=zeros)
    elif method == AUTO:
        plain = make_estimator("ls", record, time_constant)
        estimator = choose(plain, record.u, record.counts, forgetting)[0]
    else:
        estimator = make_estimator(method, record, time_constant, forgetting=forgetting)
    if not isinstance(estimator, RecursiveEstimator):
        raise TypeError(f"{method} is not recursive")
    return estimator.run(record.u, record.counts)


def mass_of(method: str, record: CartRecord, time_constant: float) -> tuple[float, float]:
    """Return the mass and its standard deviation by an off-line method over a record; nan if the method fails."""
    estimator = make_estimator("ls" if method == AUTO else method, record, time_constant)
    try:
        if method == AUTO:
            fit = first_choice(estimator, record.u, record.counts).fit
        elif isinstance(estimator, BatchEstimator):
            fit = estimator.fit(record.u, record.counts)
        else:
            raise TypeError(f"{method} is not off-line")
    except NotIdentifiableError:
        return math.nan, math.nan
    return float(fit.theta[0]), float(fit.theta_std[0])


def known_mass(track: Track) -> Floats:
    """Return the mass over time, nan before the first estimate."""
    return np.where(track.has_status(Status.STARTING), np.nan, track["mass"])


def track_score(track: Track, window: slice, truth: float, settled: float = math.nan) -> Score:
    """Return the score of the samples in the window."""
    if track.has_status(Status.STARTING)[window].any():
        return NO_ANSWER
    return score(track["mass"][window], track.theta_std[window, 0], truth, settled)


def mass_score(found: tuple[float, float], truth: float) -> Score:
    """Return the score of an off-line estimate and its standard deviation."""
    mass, std = found
    return NO_ANSWER if math.isnan(mass) else score(np.array([mass]), np.array([std]), truth)

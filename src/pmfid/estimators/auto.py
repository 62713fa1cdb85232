"""The method for those who choose none."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pmfid.errors import NotIdentifiableError
from pmfid.estimators.adequacy import examine
from pmfid.estimators.base import Estimator, like
from pmfid.estimators.batch import BCLS, LS, BatchEstimator, Fit
from pmfid.estimators.bcrls import BCRLS
from pmfid.estimators.interval import IntervalML
from pmfid.estimators.iv import IV, RIV
from pmfid.estimators.output_error import OE
from pmfid.estimators.zeros import choose_prefilter_zeros
from pmfid.status import Status

AUTO = "auto"


def choose(configured: Estimator, u: ArrayLike, counts: ArrayLike, forgetting: float) -> tuple[Estimator, str]:
    """The best method that a record carries, and a line that says why; u, counts: (n,).

    With a memory: recursive instrumental variables, which fall back on BCRLS by themselves. Without: that of
    `first_fit`, which says what it raises.
    """
    if forgetting < 1 and configured.equation.without_simulation:
        return like(
            BCRLS, configured, forgetting=forgetting
        ), "bcrls: parameters may change, and nothing can simulate this"
    if forgetting < 1:
        return like(RIV, configured, prefilter_zeros=None, forgetting=forgetting), "riv: parameters may change"
    return first_fit(configured, u, counts)[:2]


def first_fit(configured: Estimator, u: ArrayLike, counts: ArrayLike) -> tuple[Estimator, str, Fit]:
    """The best off-line method that a record carries, a line that says why, and its fit; u, counts: (n,).

    The interval likelihood where the model explains every count, and what it may lack without showing stays within
    the error bars; else instrumental variables, which ask less of the model, or where they do not settle output
    error, bias-compensated, or plain least squares.
    Raises NotIdentifiableError where none of them can identify every parameter.
    """
    refused: list[str] = []
    without, why = configured.equation.without_simulation, ""
    for cls, reason in _CANDIDATES:
        if cls.simulates and without:
            continue
        candidate = _candidate(cls, configured, u, counts)
        try:
            fit = candidate.fit(u, counts)
        except NotIdentifiableError as error:
            refused.append(f"{cls.method}: {error}")
            continue
        if isinstance(candidate, IntervalML):
            why = _against_interval(candidate, fit, u, counts)
            if why:
                continue
        if fit.theta[candidate.equation.leading] > 0:
            return candidate, f"{cls.method}: {reason}{why}", fit
    raise NotIdentifiableError(refused[0].partition(": ")[2])


def _candidate(cls: type[BatchEstimator], configured: Estimator, u: ArrayLike, counts: ArrayLike) -> BatchEstimator:
    if cls in (BCLS, LS):
        zeros = choose_prefilter_zeros(configured, u, counts) if cls is BCLS else None
        return like(cls, configured, model=configured.model.symmetric, prefilter_zeros=zeros)
    return like(cls, configured, prefilter_zeros=None)


def _against_interval(interval: IntervalML, fit: Fit, u: ArrayLike, counts: ArrayLike) -> str:
    """Why the most accurate method is not the one to believe here; empty: it is."""
    found = examine(interval, u, counts)
    if fit.status & Status.FALLBACK or not found.follows:
        return ", and the model does not explain every count"
    if not found.adequate:
        return f", and {found.says}"
    if np.any(found.spread() > fit.theta_std):
        return "; interval would be sharper than what the model may lack unseen"
    return ""


_CANDIDATES: tuple[tuple[type[BatchEstimator], str], ...] = (
    (IntervalML, "the model explains every count"),
    (IV, "it asks least of the model"),
    (OE, "instrumental variables do not settle on this record"),
    (BCLS, "no simulated motion follows this record; the input carries enough to take out the encoder's bias"),
    (LS, "nothing but least squares settles on this record; mind the encoder's bias"),
)

"""The method for those who choose none."""

from __future__ import annotations

from typing import Any

from numpy.typing import ArrayLike

from pmfid.errors import NotIdentifiableError
from pmfid.estimators.base import Estimator, like
from pmfid.estimators.batch import BCLS, LS, Fit
from pmfid.estimators.bcrls import BCRLS
from pmfid.estimators.interval import IntervalML
from pmfid.estimators.iv import IV, RIV
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

    The interval likelihood where the model explains the counts to half of one, else instrumental variables where the
    simulated motion follows the measured one, else bias-compensated, else plain least squares.
    Raises NotIdentifiableError where none of them can identify every parameter.
    """
    refused: list[str] = []
    without = configured.equation.without_simulation
    for cls, reason in _CANDIDATES:
        if cls.simulates and without:
            continue
        candidate: Any = like(cls, configured, **({"model": configured.model.symmetric} if cls in (BCLS, LS) else {}))
        try:
            fit: Fit = candidate.fit(u, counts)
        except NotIdentifiableError as error:
            refused.append(f"{cls.method}: {error}")
            continue
        if fit.theta[candidate.equation.leading] > 0 and not fit.status & Status.FALLBACK:
            return candidate, f"{cls.method}: {reason}", fit
    if not refused:
        raise NotIdentifiableError("the mass comes out negative: check sign and scale of the input and the encoder")
    raise NotIdentifiableError(refused[0].partition(": ")[2])


_CANDIDATES: tuple[tuple[type[Estimator], str], ...] = (
    (IntervalML, "the model explains every count"),
    (IV, "the simulated motion follows the measured one"),
    (BCLS, "the input carries enough to take out the encoder's bias"),
    (LS, "nothing but least squares settles on this record; mind the encoder's bias"),
)

"""Choice of the method for users who name none."""

from __future__ import annotations

from contextlib import suppress

from numpy.typing import ArrayLike

from pmfid.errors import NotIdentifiableError
from pmfid.estimators.base import Estimator
from pmfid.estimators.configuration import like
from pmfid.estimators.cutoff import choose_prefilter_zeros
from pmfid.estimators.iv import RIV
from pmfid.estimators.ls import BCLS, LS
from pmfid.estimators.recursive import BCRLS

AUTO = "auto"


def choose(configured: Estimator, u: ArrayLike, counts: ArrayLike, forgetting: float) -> tuple[Estimator, str]:
    """Return the best method that a record allows where the fit is none, and a line with the reason; u, counts: (n,).

    With a memory, the method is recursive instrumental variables, which fall back on BCRLS by themselves. An equation
    without a simulated motion has the compensated or plain least squares.
    Raises NotIdentifiableError if no method can identify every parameter of such an equation.
    """
    if forgetting < 1 and not configured.equation.without_simulation:
        return like(RIV, configured, prefilter_zeros=None, forgetting=forgetting), "riv: the parameters may change"
    if forgetting < 1:
        reason = "bcrls: the parameters may change, and the equation allows no simulated motion"
        return like(BCRLS, configured, forgetting=forgetting), reason
    zeros = choose_prefilter_zeros(configured, u, counts)
    compensated = like(BCLS, configured, model=configured.model.simple, prefilter_zeros=zeros)
    with suppress(NotIdentifiableError):
        compensated.fit(u, counts)
        return compensated, "bcls: the equation allows no simulated motion, and the input suffices for compensation"
    plain = like(LS, configured, model=configured.model.simple, prefilter_zeros=None)
    plain.fit(u, counts)
    return plain, "ls: only least squares gives a result on this record; the rounding of the encoder biases it"

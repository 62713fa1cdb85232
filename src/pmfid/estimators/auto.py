"""Choice of the method for users who name none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import NotIdentifiableError
from pmfid.estimators.adequacy import Adequacy, is_contradicted, weigh
from pmfid.estimators.base import Estimator, Simulating
from pmfid.estimators.batch import BatchEstimator
from pmfid.estimators.configuration import check_arrays, like
from pmfid.estimators.cutoff import choose_prefilter_zeros
from pmfid.estimators.iv import IV, RIV
from pmfid.estimators.likelihood import Best
from pmfid.estimators.ls import BCLS, LS
from pmfid.estimators.output_error import OE, IntervalML
from pmfid.estimators.recursive import BCRLS
from pmfid.estimators.results import Columns, Fit
from pmfid.models.equation import ESTIMATE, Equation
from pmfid.status import Status
from pmfid.types import Floats

AUTO = "auto"


def choose(configured: Estimator, u: ArrayLike, counts: ArrayLike, forgetting: float) -> tuple[Estimator, str]:
    """Return the best method that a record allows, and a line with the reason; u, counts: (n,).

    With a memory, the method is recursive instrumental variables, which fall back on BCRLS by themselves. Without a
    memory, `first_choice` chooses the method and raises its errors.
    """
    if forgetting < 1 and configured.equation.without_simulation:
        return like(
            BCRLS, configured, forgetting=forgetting
        ), "bcrls: the parameters may change, and the equation allows no simulated motion"
    if forgetting < 1:
        return like(RIV, configured, prefilter_zeros=None, forgetting=forgetting), "riv: the parameters may change"
    found = first_choice(configured, u, counts)
    return found.estimator, found.reason


@dataclass(frozen=True)
class MethodChoice:
    """A method, the reason for its choice, its fit, and the adequacy of the model if it was tested."""

    estimator: BatchEstimator
    reason: str
    fit: Fit
    adequacy: Adequacy | None


def first_choice(configured: Estimator, u: ArrayLike, counts: ArrayLike, best: Best | None = None) -> MethodChoice:
    """Return the best off-line method that a record allows; u, counts: (n,). `best` is the motion that fits, if it is
    known.

    The interval likelihood is the first choice if the model explains every count. Hidden unmodelled effects must stay
    within its error bars, or within the error bars of instrumental variables. Instrumental variables demand less of the
    model and are the second choice. If their iteration does not settle, output error, bias-compensated or plain least
    squares follow. Raises NotIdentifiableError if no method can identify every parameter.
    """
    refused: list[str] = []
    simulates = not configured.equation.without_simulation
    u, counts = check_arrays(u, counts)
    settled = _settle_iteration(configured, u, counts) if best is None else None
    best = best or (_find_best(configured, u, counts, settled, refused) if simulates else None)
    sharp = _sharp(configured, best, refused) if best and simulates else None
    groundwork = _Groundwork(settled, best, sharp, refused)
    if sharp is not None and not sharp.doubt:
        return sharp.make_choice("the model explains every count")
    adequacy = sharp.adequacy if sharp else None
    doubt = sharp.doubt if sharp else ""
    for cls, reason in _CANDIDATES:
        if issubclass(cls, Simulating) and not simulates:
            continue
        if not issubclass(cls, Simulating) and _needs_motion(configured.equation):
            continue  # the method has no such parameter, so that the missing effect would distort the estimate
        if cls is IV and configured.equation.searched:  # iv is linear in the parameters
            continue
        candidate = _candidate(cls, configured, u, counts)
        try:
            fit = groundwork.fit_candidate(candidate, u, counts)
        except NotIdentifiableError as error:
            refused.append(f"{cls.method}: {error}")
            continue
        if sharp and sharp.adequate and (better := sharp.better_than(fit, cls)):
            return sharp.make_choice(f"the model explains every count, and {better}")
        if fit.theta[candidate.equation.leading] > 0:
            return MethodChoice(candidate, f"{cls.method}: {reason}{doubt}", fit, adequacy)
    if not refused:
        raise NotIdentifiableError(
            "the mass comes out negative: check the sign and the scale of the input and of the encoder"
        )
    raise NotIdentifiableError(refused[0].partition(": ")[2])


@dataclass(frozen=True)
class _Sharp:
    """The interval likelihood of a record, the adequacy of its model, and the doubt about its estimate."""

    method: IntervalML
    fit: Fit
    adequacy: Adequacy
    doubt: str

    @property
    def adequate(self) -> bool:
        return self.adequacy.adequate and not self.fit.status & Status.FALLBACK

    def better_than(self, other: Fit, cls: type[BatchEstimator]) -> str:
        """Return the reason to prefer this estimate to the estimate of `cls`; empty if no reason exists.

        The reason is a contradiction between the two estimates, or a smaller uncertainty in the geometric mean of the
        parameters. The uncertainty includes hidden unmodelled effects.
        """
        spread = self.adequacy.spread()
        if cls is not IV or is_contradicted(other, self.fit, spread):
            return f"{cls.method} contradicts it"
        total = np.hypot(self.fit.theta_std, spread)
        less = np.sum(np.log(total)) < np.sum(np.log(other.theta_std))
        return f"the error bars of {cls.method} are larger" if less else ""

    def make_choice(self, reason: str) -> MethodChoice:
        return MethodChoice(self.method, f"{self.method.method}: {reason}", self.fit, self.adequacy)


def _needs_motion(equation: Equation) -> bool:
    """Return whether a parameter needs a simulated motion: a dead time, a lag, or the speed of Stribeck friction."""
    return ESTIMATE in (equation.dead_time, equation.lag) or bool(equation.searched)


#: Columns and theta (p,) of an iteration of instrumental variables that has settled.
Settled = tuple[Columns, Floats]


@dataclass(frozen=True)
class _Groundwork:
    """Results on a record before the fits of the candidates, or None without a result. `refused` holds the reasons so
    far."""

    settled: Settled | None
    best: Best | None
    sharp: _Sharp | None
    refused: Sequence[str]

    def fit_candidate(self, candidate: BatchEstimator, u: Floats, counts: NDArray[np.int64]) -> Fit:
        """Return the fit of a candidate. Output error takes the known motion. Without a known motion, output error is
        refused for the reason of the interval likelihood."""
        if isinstance(candidate, IV) and self.settled is not None:
            return candidate.fit_settled(*self.settled, u, counts)
        if not isinstance(candidate, OE) or candidate.window is not None:
            return candidate.fit(u, counts)
        if self.best is None:
            raise NotIdentifiableError(self.refused[0].partition(": ")[2])
        if self.sharp is not None and self.best.noise is None:
            return replace(self.sharp.fit, status=self.best.status)
        return candidate.make_least_squares_fit(self.best)


def _settle_iteration(configured: Estimator, u: Floats, counts: NDArray[np.int64]) -> Settled | None:
    """Return the converged iteration of `IV`, or None without convergence. The search for the best motion starts from
    it.
    """
    if configured.equation.without_simulation or configured.equation.searched:
        return None
    try:
        return like(IV, configured, prefilter_zeros=None).settle_iteration(u, counts)
    except NotIdentifiableError:
        return None


def _find_best(
    configured: Estimator, u: Floats, counts: NDArray[np.int64], settled: Settled | None, refused: list[str]
) -> Best | None:
    method = like(IntervalML, configured, prefilter_zeros=None)
    try:
        if settled is None:
            return method.best(u, counts)
        return replace(method.best(u, counts, settled[1]), status=settled[0].status)
    except NotIdentifiableError as error:
        refused.append(f"{IntervalML.method}: {error}")
        return None


def _sharp(configured: Estimator, best: Best, refused: list[str]) -> _Sharp | None:
    method = like(IntervalML, configured, prefilter_zeros=None)
    try:
        fit, found = method.fit_of(best), weigh(best)
    except NotIdentifiableError as error:
        refused.append(f"{method.method}: {error}")
        return None
    spread, doubt = found.spread(), ""
    if fit.status & Status.FALLBACK or not found.follows or not found.adequate:
        doubt = ", and the counts show effects outside the model"
    elif np.any(spread > fit.theta_std):
        doubt = "; the error bars of interval leave out unmodelled effects that this record does not show"
    return _Sharp(method, fit, found, doubt)


def _candidate(cls: type[BatchEstimator], configured: Estimator, u: ArrayLike, counts: ArrayLike) -> BatchEstimator:
    if cls in (BCLS, LS):
        zeros = choose_prefilter_zeros(configured, u, counts) if cls is BCLS else None
        return like(cls, configured, model=configured.model.simple, prefilter_zeros=zeros)
    return like(cls, configured, prefilter_zeros=None)


_CANDIDATES: tuple[tuple[type[BatchEstimator], str], ...] = (
    (IV, "it depends least on the model"),
    (OE, "instrumental variables do not converge on this record"),
    (BCLS, "no simulated motion follows this record, and the input suffices to compensate the encoder's bias"),
    (LS, "only least squares gives a result on this record; the rounding of the encoder biases it"),
)

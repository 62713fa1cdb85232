"""Instrumental variables with an auxiliary model that contains friction, off-line and recursive."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import NotIdentifiableError
from pmfid.estimators.auxiliary import make_auxiliary_kernel
from pmfid.estimators.base import Simulating
from pmfid.estimators.configuration import like
from pmfid.estimators.instruments import Instruments, initial_vector
from pmfid.estimators.motion_fit import MotionFit
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.results import Columns, Fit
from pmfid.estimators.tuning import TUNING
from pmfid.fit.likelihood import Intervals
from pmfid.models.equation import DEAD_TIME, ESTIMATE, LAG, Equation
from pmfid.types import Floats

if TYPE_CHECKING:
    from pmfid._kernel64 import Kernel


@dataclass(frozen=True)
class IV(Instruments):
    """Iterated instrumental variables, off-line.

    The plant is simulated from the input alone with the present estimate, stiction included. The simulated motion gives
    the instruments. The motion also gives the direction and the moving fractions of every interval.

    Parameters
    ----------
    model : Drive, EquationModel or TransferFunction
        Model of the plant.
    encoder : Encoder
        Data sheet of the encoder.
    dt : float
        Sample period [s].
    cutoff : float
        Pole of the filters [rad/s].
    initial : mapping, optional
        Start values by parameter name. By default, bias-compensated least squares gives the start values.

    Notes
    -----
    The method repeats theta = (sum zeta phi^T)^-1 sum zeta z until theta no longer changes (Young and Jakeman 1979).
    The
    friction in the auxiliary model is an addition of pmfid.

    A transfer function is simulated with unknown initial conditions, and its filter has the pole `cutoff`. `SRIVC`
    adapts the filter to the estimate.

    The instrument of a dead time is the change of the input, which under control follows the encoder's error. The dead
    time therefore comes from the motion that fits best (`MotionFit`), on two conditions. The best motion must explain
    every count, and give a shorter error bar of the dead time.

    The standard errors follow from the scatter of the scores over the memory of the filters. They are up to eight times
    too long if the encoder's error cancels from move to move, and half as long as the errors if it repeats in every
    move. `MotionFit` has the exact intervals.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import IV, Drive, Encoder, quantize
    >>> from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, simulate_drive
    >>> u = prbs(1500, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
    >>> counts = quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION)
    >>> fit = IV(Drive(CART.input_gain), Encoder(CART_RESOLUTION), CART_DT, 20.0).fit(u, counts)
    >>> fit.theta.round(2)
    array([ 1.07, 12.8 ,  0.8 ])
    """

    method: ClassVar[str] = "iv"

    def fit_settled(self, columns: Columns, theta: Floats, u: Floats, counts: NDArray[np.int64]) -> Fit:
        fit = super().fit_settled(columns, theta, u, counts)
        late = [i for i, name in enumerate(self.names) if name in (DEAD_TIME, LAG)]
        if not late or np.all(fit.theta_std[late] < TUNING.iv_sharp * self.dt):
            return fit
        sharp = self._sharp(u, counts)
        if sharp is None or not np.all(sharp.theta_std[late] < fit.theta_std[late]):
            return fit
        try:
            return self._fit_at_lateness(sharp.theta[late], sharp.theta_cov[np.ix_(late, late)], late, fit, u, counts)
        except NotIdentifiableError:  # the iteration does not converge at this dead time or lag
            return fit

    def _sharp(self, u: Floats, counts: NDArray[np.int64]) -> Fit | None:
        """Return the fit of the motion, or None if the motion does not explain every count."""
        method = like(MotionFit, self, prefilter_zeros=None, precision="float64")
        try:
            fitted = method.examine(u, counts)
        except NotIdentifiableError:
            return None
        return method.summarise(fitted) if isinstance(fitted.likelihood, Intervals) else None

    def _fit_at_lateness(
        self, late: Floats, late_cov: Floats, places: list[int], fit: Fit, u: Floats, counts: NDArray[np.int64]
    ) -> Fit:
        """Return the fit at dead time and lag (l,) [s] with the covariance (l, l). `places` are their indices in
        theta.
        """
        others = [i for i in range(fit.theta.size) if i not in places]
        known = self._fix_lateness(late, fit.theta[others])
        columns, theta = known.settle_iteration(u, counts)
        moves = np.empty((theta.size, late.size))
        for j, bar in enumerate(np.sqrt(np.diagonal(late_cov))):
            sides = [np.maximum(late + side * bar * np.eye(late.size)[j], 0.0) for side in (1.0, -1.0)]
            ends = [self._fix_lateness(side, theta).settle_iteration(u, counts)[1] for side in sides]
            moves[:, j] = (ends[0] - ends[1]) / (sides[0][j] - sides[1][j])
        own = known.estimate_covariance(columns, theta, u, counts)
        whole, cov = np.empty(fit.theta.size), np.empty_like(fit.theta_cov)
        whole[others], whole[places] = theta, late
        cov[np.ix_(others, others)] = own + moves @ late_cov @ moves.T
        cov[np.ix_(places, places)] = late_cov
        cov[np.ix_(others, places)] = moves @ late_cov
        cov[np.ix_(places, others)] = cov[np.ix_(others, places)].T
        return self._result(self.columns_at(whole, u, counts), whole, cov)

    def _fix_lateness(self, late: Floats, start: Floats) -> Instruments:
        """Return the estimator with a known lateness (l,) [s], starting from theta (p,)."""
        times = iter(late.tolist())
        model, equation = self.model, self.equation
        model = model.replace_dead_time(next(times)) if equation.dead_time == ESTIMATE else model
        model = model.replace_lag(next(times)) if equation.lag == ESTIMATE else model
        twin = like(Instruments, self, model=model)
        return replace(twin, initial=dict(zip(twin.names, start.tolist(), strict=True)))


@dataclass(frozen=True)
class RIV(Simulating, RecursiveEstimator):
    """Recursive instrumental variables with a friction-aware auxiliary model (theory: Young 2011, RIV).

    Parameters
    ----------
    model : Drive or EquationModel
    encoder : Encoder
    dt : float
        Sample period [s].
    cutoff : float
        Pole of the filters [rad/s].
    forgetting : float
        Factor of exponential forgetting for each sample, 0 to 1.
    initial : mapping, optional
        Start values by parameter name. By default the first estimate of `BCRLS` gives the start values.

    Notes
    -----
    The input alone drives a model with a slow copy of the estimate. If the model does not follow the measured velocity,
    the estimate is that of `BCRLS`, with `Status.FALLBACK`. The model then restarts from the estimate of `BCRLS`.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import RIV, Drive, Encoder, quantize
    >>> from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, simulate_drive
    >>> u = prbs(1500, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
    >>> counts = quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION)
    >>> riv = RIV(Drive(CART.input_gain), Encoder(CART_RESOLUTION), CART_DT, 20.0)
    >>> track = riv.run(u, counts)
    >>> track.theta[-1].round(2)
    array([ 1.07, 12.8 ,  0.8 ])
    """

    method: ClassVar[str] = "riv"
    instrumental: ClassVar[bool] = True

    initial: Mapping[str, float] | None = field(default=None, kw_only=True)

    @classmethod
    def refuses(cls, equation: Equation) -> str:
        refused = super().refuses(equation)
        if not refused and ESTIMATE in (equation.lag, equation.dead_time):
            return "riv needs numbers for dead_time and lag: estimate them with iv or fit, and give them in s"
        if refused or not equation.further:
            return refused
        names = ", ".join(dict(equation.further))
        return (
            f"riv estimates parameters that act linearly, and {names} does not; estimate it with fit, and give its "
            "value"
        )

    def make_kernel(self, forgetting: float = 1.0) -> Kernel:
        initial = None if self.initial is None else list(initial_vector(self.initial, self.names))
        return make_auxiliary_kernel(self, forgetting, initial, adapt=True)[0]

    @property
    def _zeros_needed(self) -> int:
        """Number of zeros of the direct estimate, which does not distinguish the directions."""
        return len(self.model.symmetric.equation.noisy)

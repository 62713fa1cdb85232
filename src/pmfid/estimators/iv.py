"""Instrumental variables with an auxiliary model that contains friction, off-line and recursive."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.auxiliary import auxiliary_columns, make_auxiliary_kernel
from pmfid.estimators.base import Simulating
from pmfid.estimators.batch import BEYOND, BatchEstimator, check_identifiable, filter_parts
from pmfid.estimators.configuration import check_arrays, check_size, like
from pmfid.estimators.least_squares import inverse_of, solve_bounded, solve_with_instruments
from pmfid.estimators.ls import BCLS
from pmfid.estimators.recursive import RecursiveEstimator, impulse_products
from pmfid.estimators.results import Columns, Fit
from pmfid.models.equation import (
    COULOMB_BACKWARD,
    COULOMB_FORWARD,
    MASS,
    OFFSET,
    ROLES,
    STIFFNESS,
    Equation,
)
from pmfid.status import Status

if TYPE_CHECKING:
    from pmfid._kernel64 import Kernel

INSTRUMENTS_MAX_ITERATIONS = 40
INSTRUMENTS_TOLERANCE = 1e-7
#: Pass from which on steps are halved. A stop of the model that comes and goes with theta keeps the iteration in a
#: small cycle.
DAMPED_FROM = 15
#: Relative size up to which such a cycle counts as converged.
INSTRUMENTS_ACCEPTED = 2e-3
#: A parameter may be zero if its term is less than this part of the target. The change of such a parameter is
#: measured against this part.
INSTRUMENTS_SMALL = 1e-2
#: Length of a record's first part, in which the model's velocity forgets its unknown start.
START_PART = 0.05
#: Samples with equal counts at the start of a record that may begin at rest.
REST_SAMPLES = 5
#: Relative step of the difference quotients for the covariance.
JACOBIAN_STEP = 1e-3


@dataclass(frozen=True)
class IV(BatchEstimator, Simulating):
    """Iterated instrumental variables, off-line.

    The plant is simulated from the input alone with the present estimate, stiction included. The simulated motion gives
    the instruments. The motion also gives the direction and the moving fractions of every interval.

    Parameters
    ----------
    model : Drive or EquationModel
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
    The friction in the auxiliary model is an addition of pmfid.

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

    initial: Mapping[str, float] | None = field(default=None, kw_only=True)

    @classmethod
    def refuses(cls, equation: Equation) -> str:
        return super().refuses(equation) or refuse_nonlinear(cls.method, equation)

    def _fit(self, u: ArrayLike, counts: ArrayLike) -> Fit:
        """Estimate the parameters. Raises NotIdentifiableError also if the iteration does not converge."""
        u, counts = check_arrays(u, counts)
        columns, theta = self.settle_iteration(u, counts)
        return self._result(columns, theta, self._covariance(columns, theta, self._gain(columns, theta, u, counts)))

    def settle_iteration(self, u: ArrayLike, counts: ArrayLike) -> tuple[Columns, NDArray[np.float64]]:
        """Return the columns of the last iteration and theta (p,), as `fit` without the covariance. Raises the errors
        of `fit`."""
        theta = self.start(u, counts)
        for turn in range(INSTRUMENTS_MAX_ITERATIONS):
            columns = self.columns_at(theta, u, counts)
            check_identifiable(columns, self.names, simulated=True)
            before, theta = theta, self._plausible(theta, self._solve(columns)[0])
            if turn >= DAMPED_FROM:
                theta = (theta + before) / 2
            change = _measure_change(columns, before, theta)
            if change <= INSTRUMENTS_TOLERANCE or (
                turn == INSTRUMENTS_MAX_ITERATIONS - 1 and change <= INSTRUMENTS_ACCEPTED
            ):
                return columns, theta
        raise NotIdentifiableError(
            "the iteration does not converge (last "
            f"{dict(zip(self.names, theta.round(4).tolist(), strict=True))}): the simulated motion does "
            "not follow the measured motion; check input_gain and the model, or in Python give `initial`"
        )

    def _gain(
        self, columns: Columns, theta: NDArray[np.float64], u: ArrayLike, counts: ArrayLike
    ) -> NDArray[np.float64]:
        """Return the gain (p, p) by which a change of sum zeta z moves theta, with moving reversals of the model.

        The matrix sum zeta phi^T alone takes the direction as known, so that the error bar of the mass is a fifth too
        short.
        """
        rests = self._rests(*check_arrays(u, counts), theta)
        jacobian = np.empty((theta.size, theta.size))
        size = np.maximum(np.abs(theta), 1e-3 * np.max(np.abs(theta)))
        for i, step in enumerate(JACOBIAN_STEP * size):
            moved = [theta + side * np.eye(theta.size)[i] for side in (step, -step)]
            sides = [self.columns_at(at, u, counts, rests) for at in moved]
            # two motions use different samples if one of them moves while the other rests
            used = columns.used & sides[0].used & sides[1].used
            error = [(side.z - side.phi @ at)[used[side.used]] for side, at in zip(sides, moved, strict=True)]
            with np.errstate(over="ignore"):  # the error comes from a resolution that no encoder has
                jacobian[:, i] = columns.zeta[used[columns.used]].T @ (error[1] - error[0]) / (2 * step)
        return inverse_of(jacobian)

    def start(self, u: ArrayLike, counts: ArrayLike) -> NDArray[np.float64]:
        """Return the given start values (p,), or start values from the counts alone."""
        if self.initial is not None:
            return initial_vector(self.initial, self.names)
        batch = like(BCLS, self, model=self.model.simple)
        found = batch.solve(u, counts)
        if found is None or not found[batch.equation.leading] > 0:
            positive = np.array(batch.equation.positive)
            if (stiffness := batch.equation.roles[STIFFNESS]) is not None:
                positive[stiffness] = True
            found = solve_bounded(batch.columns(u, counts), positive)
        theta = spread(batch.equation.role_values(found), self.equation)
        for term in batch.equation.shaped:
            theta[self.names.index(str(term.name))] = found[batch.names.index(str(term.name))]
        return theta

    def columns_at(
        self, theta: NDArray[np.float64], u: ArrayLike, counts: ArrayLike, rests: bool | None = None
    ) -> Columns:
        """Return regressors, target and instruments with the auxiliary model at theta (p,).

        If a record begins at rest and the model agrees, the axis has been at rest before, and its first motion counts.
        `rests` says whether the record begins at rest. None decides from the counts and theta.
        """
        columns, used, status = self._filter_record(theta, *check_arrays(u, counts), rests)
        first, p = auxiliary_columns(self)[2], len(self.names)
        columns = columns[used, first:]
        occurred = int(np.bitwise_or.reduce(status)) & int(Status.SAMPLE_REJECTED)
        zeta = self.weigh_rows(columns[:, p + 1 : 2 * p + 1], used)
        return Columns(columns[:, :p], columns[:, p], zeta, used, occurred)

    def _filter_record(
        self,
        theta: NDArray[np.float64],
        u_array: NDArray[np.float64],
        counts_array: NDArray[np.int64],
        rests: bool | None,
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.uint32]]:
        """Return all columns (n, c), the rows that count (n,), and the status (n,)."""
        check_size(u_array)
        kernel, _ = make_auxiliary_kernel(self, 1.0, list(theta), adapt=False)
        rests = self._rests(u_array, counts_array, theta) if rests is None else rests
        before = 2 * self.settle_samples + 1 if rests else 0
        rest = np.full(before, counts_array[:1])
        steps = self.steps_before(u_array.size)
        steps = None if steps is None else np.r_[np.full(before, self.dt), steps]
        columns, status = filter_parts(kernel, np.r_[np.zeros(before), u_array], np.r_[rest, counts_array], steps)
        columns, status = columns[before:], status[before:]
        used = (status & Status.SETTLING) == 0
        used[: 0 if before else int(START_PART * used.size)] = False
        return columns, used, status

    def _rests(self, u: NDArray[np.float64], counts: NDArray[np.int64], theta: NDArray[np.float64]) -> bool:
        """Return whether the axis rests at first, according to the counts and the friction of theta (p,)."""
        begin = slice(0, REST_SAMPLES)
        if counts.size <= REST_SAMPLES or np.any(counts[begin] != counts[0]):
            return False
        friction = min(
            (theta[i] for i in (self.equation.roles[r] for r in (COULOMB_FORWARD, COULOMB_BACKWARD)) if i is not None),
            default=0.0,
        )
        index = self.equation.roles[OFFSET]
        force = self.equation.input_gain * u[begin] - (0.0 if index is None else theta[index])
        return bool(np.all(np.abs(force) <= friction)) and not self.equation.place_matters

    def noise(self) -> NDArray[np.float64]:
        """Return the covariance (p, p) of one sample's regressors by a white error with the variance of the encoder's
        step.
        """
        network, columns, first, _ = auxiliary_columns(self)
        responses = impulse_products(self, network, columns[first : first + len(self.names)])
        return np.asarray(self.encoder.rounding_variance * responses)

    def _solve(self, columns: Columns) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return solve_with_instruments(columns)

    def _plausible(self, theta: NDArray[np.float64], found: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return `found` with lower limits: a mass or friction falls at most half-way from theta to zero."""
        low = np.where(self.equation.positive, 0.5 * theta, -np.inf)
        return np.maximum(found, low)


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
        return super().refuses(equation) or refuse_nonlinear(cls.method, equation)

    def make_kernel(self, forgetting: float = 1.0) -> Kernel:
        initial = None if self.initial is None else list(initial_vector(self.initial, self.names))
        return make_auxiliary_kernel(self, forgetting, initial, adapt=True)[0]

    @property
    def _zeros_needed(self) -> int:
        """Number of zeros of the direct estimate, which does not distinguish the directions."""
        return len(self.model.symmetric.equation.noisy)


def _measure_change(columns: Columns, before: NDArray[np.float64], theta: NDArray[np.float64]) -> float:
    """Return the largest relative change of a parameter from `before` to `theta` (p,)."""
    small = INSTRUMENTS_SMALL * np.linalg.norm(columns.z) / np.maximum(np.linalg.norm(columns.phi, axis=0), 1 / BEYOND)
    size = np.maximum(np.maximum(np.abs(theta), np.abs(before)), small)
    return float(np.max(np.abs(theta - before) / size))


def initial_vector(initial: Mapping[str, float], names: tuple[str, ...]) -> NDArray[np.float64]:
    """Return the parameters of `initial` in the order of theta. Raises UsageError for a missing or unknown name."""
    if set(initial) != set(names):
        raise UsageError(f"initial must name {list(names)}, got {list(initial)}")
    return np.array([float(initial[name]) for name in names])


def spread(known: Sequence[float], equation: Equation) -> NDArray[np.float64]:
    """Return theta (p,) from the values of the roles in the symmetric equation. In an equation without an offset, a
    constant load becomes Coulomb friction that differs between the directions. Negative frictions start at zero."""
    values = list(known)
    if equation.roles[OFFSET] is None:
        values[COULOMB_FORWARD] += values[OFFSET]
        values[COULOMB_BACKWARD] -= values[OFFSET]
    theta = np.zeros(len(equation.names))
    for value, index in zip(values[: len(ROLES)], equation.roles[: len(ROLES)], strict=True):
        if index is not None:
            theta[index] = value
    if not values[MASS] > 0:
        raise NotIdentifiableError(
            f"the iteration has no start values: the counts alone give a mass of {values[MASS]:.3g}; "
            "check the signs of input and output, use a lower cutoff, record a more varied motion, or in "
            "Python give `initial`"
        )
    return np.where(equation.positive, np.maximum(theta, 0.0), theta)


def refuse_nonlinear(method: str, equation: Equation) -> str:
    """Return why a method with instruments refuses the equation; empty if the parameters act linearly."""
    names = ", ".join(dict(equation.further))
    if not names:
        return ""
    return f"{method} estimates parameters that act linearly, and {names} does not; use fit off-line, or give its value"

"""Off-line least squares, plain and with compensation of the encoder's bias."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.base import EXACT, Estimator
from pmfid.estimators.batch import BatchEstimator, check_identifiable
from pmfid.estimators.configuration import check_arrays, like
from pmfid.estimators.least_squares import inverse_of, solve_with_instruments
from pmfid.estimators.results import Columns, Fit
from pmfid.estimators.tuning import TUNING
from pmfid.filters.columns import tustin_image
from pmfid.linear.responses import ExactTerm, Filter, respond_exactly
from pmfid.models.equation import Equation
from pmfid.types import Floats

OUTPUTS = ("output", "process_output")
#: Sources of the motion and of the terms on the right-hand side, in the order of the exact rows.
SOURCES = ("input", "process_input", "direction", "moving", "constant")


@dataclass(frozen=True)
class Pass:
    """Columns of the equation at one theta.

    `phi` (N, p) are the regressors and `zeta` (N, p) the instruments. `error` (N,) is the error of the filtered
    equation, and `slope` (N, p) is the decrease of the error with theta. `known` (N,) is the known side of the filtered
    equation.
    """

    phi: Floats
    zeta: Floats
    slope: Floats
    error: Floats
    known: Floats


@dataclass(frozen=True)
class Exact:
    """The exact columns of an equation on one record, from the position y (N,) and named signals (N,)."""

    equation: Equation
    filter: Filter
    zeros: tuple[float, ...]
    y: Floats
    signals: dict[str, Floats]

    def compute_pass(self, theta: Floats) -> Pass:
        """Compute the columns with the equation's own denominator at theta (p,)."""
        A, held = self._denominator(theta), self._list_held_terms(theta)
        found = respond_exactly(A, held, np.array([self.signals[name] for name in SOURCES]), self.filter.dt)
        F, p = self.filter, len(self.equation.unknown)
        inputs = [F.equation(response, A) for response in found.responses]
        phi, slope, known = np.zeros((p, self.y.size)), np.zeros((p, self.y.size)), np.zeros(self.y.size)
        gap = self.y - found.simulated
        for column, term in enumerate(self.equation.unknown):
            if term.signal in OUTPUTS:
                k = term.derivative
                phi[column] = term.coefficient * F.output(self.y, k)
                slope[column] = term.coefficient * (F.output(gap, k) + F.equation(found.slopes[k], A))
        for part, signal in zip(held, inputs, strict=True):
            if part.column is None:
                known += part.coefficient * signal
            else:
                phi[part.column] = slope[part.column] = self.equation.unknown[part.column].coefficient * signal
        error = -F.equation(gap, A)
        zeta = phi.copy()
        if self.zeros:
            self._instruments(zeta, inputs[self._main(held)])
        return Pass(phi.T, zeta.T, slope.T, error, known)

    def _denominator(self, theta: Floats) -> Floats:
        """Return the coefficients (n+1,) of A(s), with all output terms on the left."""
        A = np.zeros(self.equation.order + 1)
        for term, value in zip(self.equation.unknown, theta, strict=True):
            if term.signal in OUTPUTS:
                A[term.derivative] += term.coefficient * value
        for term in self.equation.known:
            if term.signal in OUTPUTS:
                A[term.derivative] -= term.coefficient
        return A

    def _list_held_terms(self, theta: Floats) -> list[ExactTerm]:
        """Return all terms without the output, moved to the right-hand side."""
        terms = [
            ExactTerm(SOURCES.index(term.signal), term.derivative, -term.coefficient * value, column)
            for column, (term, value) in enumerate(zip(self.equation.unknown, theta, strict=True))
            if term.signal in SOURCES
        ]
        known = [term for term in self.equation.known if term.signal in SOURCES]
        return terms + [
            ExactTerm(SOURCES.index(term.signal), term.derivative, term.coefficient, None) for term in known
        ]

    def _main(self, held: list[ExactTerm]) -> int:
        """Return the index of the input term, from which the instruments are made."""
        names = [SOURCES[term.source] for term in held]
        return next(i for i, name in enumerate(names) if name in ("input", "process_input"))

    def _instruments(self, zeta: Floats, signal: Floats) -> None:
        """Replace the noisy regressors by s^j / f(s) of the filtered input, as `ColumnBuilder.prefiltered` does."""
        noisy = self.equation.noisy
        for column, power in zip(noisy, self.equation.instrument_powers, strict=True):
            made = signal
            for i, zero in enumerate(reversed(self.zeros)):
                pole = tustin_image(-zero, self.filter.dt)
                made = self.filter.stage(made, pole, differentiating=i >= len(noisy) - power)
            zeta[column] = made


def make_exact(estimator: Estimator, u: Floats, y: Floats) -> Exact:
    """Return the exact columns for the record u and y (n,). The equation consists of output terms and held signals, and
    the plant starts at rest. Raises UsageError for other terms."""
    equation = estimator.equation
    names = {term.signal for term in (*equation.unknown, *equation.known)}
    if not names <= {*OUTPUTS, *SOURCES}:
        raise UsageError(
            f"the exact discretisation does not allow the terms {sorted(names - {*OUTPUTS, *SOURCES})}; use matched"
        )
    if "process_output" not in names:  # positions are relative to the first sample
        y = y - y[0]
    late = np.r_[np.zeros(equation.delay), u][: u.size]
    one, motion = np.ones(u.size), np.sign(np.diff(y, append=y[-1:]))
    signals = {"input": late, "process_input": late, "direction": motion, "moving": one, "constant": one}
    return Exact(equation, Filter(estimator.cutoff, estimator.order, estimator.dt), estimator.zeros, y, signals)


@dataclass(frozen=True)
class Refined:
    """Result of the exact passes: theta (p,), the last pass, its gain (p, p), and the history (passes, p) of theta.
    `status` has the status bits of the record."""

    theta: Floats
    last: Pass
    gain: Floats
    history: Floats
    status: int = 0


def refine_exactly(exact: Exact, theta: Floats, used: slice) -> Refined | None:
    """Iterate from theta (p,) until sum zeta error = 0 with the exact columns, or return None without convergence. Each
    pass is a Newton step that neglects the change of the instruments."""
    change, history = np.inf, []
    for count in range(1, TUNING.ls_passes + 1):
        with np.errstate(all="ignore"):
            here = exact.compute_pass(theta)
            size = np.linalg.norm(here.zeta[used], axis=0)
        if not (np.all(np.isfinite(here.slope)) and np.all(np.isfinite(here.error)) and 0 < np.min(size) < np.inf):
            return None
        Q, R = np.linalg.qr(here.zeta[used] / size)
        inverse = np.linalg.pinv(Q.T @ here.slope[used], rcond=1e-14)
        step = inverse @ (Q.T @ here.error[used])
        theta, before = theta + step, change
        history.append(theta)
        change = float(np.max(np.abs(step) / np.maximum(np.abs(theta), 1e-300)))
        if change < TUNING.ls_settled or (
            change < TUNING.ls_close and (change > before / 4 or count == TUNING.ls_passes)
        ):
            return Refined(theta, here, inverse @ np.linalg.inv(R.T) / size, np.array(history))
    return None


def fit_exactly(estimator: BatchEstimator, u: Floats, y: Floats) -> Fit:
    """Return the fit of a linear method with the exact discretisation for u and y (n,). Raises as `refine_estimate`."""
    found, used = refine_estimate(estimator, u, y), slice(estimator.settle_samples, None)
    last = found.last
    target = last.error[used] + last.phi[used] @ found.theta
    columns = Columns(last.phi[used], target, last.zeta[used], np.arange(y.size) >= used.start, found.status)
    return estimator._result(columns, found.theta, estimator._covariance(columns, found.theta, found.gain))


def refine_estimate(estimator: BatchEstimator, u: Floats, y: Floats) -> Refined:
    """Return the passes from the estimate with matched filters. If these passes do not converge, new passes start from
    the filters' own poles. Raises NotIdentifiableError if the new passes do not converge, either."""
    first = like(type(estimator), estimator, discretization="matched").fit_output(u, y)
    exact, used = make_exact(estimator, u, y), slice(estimator.settle_samples, None)
    found = refine_exactly(exact, first.theta, used)
    guess = estimator.plant.another_guess(estimator.equation, estimator.cutoff)
    if found is None and guess is not None:
        found = refine_exactly(exact, guess, used)
    if found is None:
        raise NotIdentifiableError("the iteration of the exact discretisation does not converge; use matched, or srivc")
    return replace(found, status=first.status)


@dataclass(frozen=True)
class ExactEstimator(BatchEstimator):
    """A `BatchEstimator` that also takes the exact discretisation."""

    discretizations: ClassVar[tuple[str, ...]] = (*BatchEstimator.discretizations, EXACT)

    def _fit(self, u: ArrayLike, counts: ArrayLike) -> Fit:
        if self.discretization != EXACT:
            return super()._fit(u, counts)
        u, counts = check_arrays(u, counts)
        check_identifiable(self.columns(u, counts), self.names, self.least_part)
        return fit_exactly(self, u, self.encoder.position(counts))

    def _fit_output(self, u: ArrayLike, y: Floats) -> Fit:
        if self.discretization != EXACT:
            return super()._fit_output(u, y)
        return fit_exactly(self, check_arrays(u, np.zeros(y.shape, np.int64))[0], y)


@dataclass(frozen=True)
class BCLS(ExactEstimator):
    """Off-line bias-compensated least squares (paper eq. 17 to 32); see `BCRLS`.

    Parameters
    ----------
    model, encoder, dt, cutoff
        See `IV`.

    Notes
    -----
    theta = (sum zeta phi^T)^-1 sum zeta z.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import BCLS, Drive, Encoder, quantize
    >>> from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, simulate_drive
    >>> u = prbs(1500, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
    >>> counts = quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION)
    >>> fit = BCLS(Drive(CART.input_gain), Encoder(CART_RESOLUTION), CART_DT, 20.0).fit(u, counts)
    >>> fit.theta.round(2)
    array([ 1.07, 12.81,  0.8 ])
    """

    method: ClassVar[str] = "bcls"
    instrumental: ClassVar[bool] = True

    def _solve(self, columns: Columns) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return solve_with_instruments(columns)


@dataclass(frozen=True)
class LS(ExactEstimator):
    """Off-line least squares by orthogonal decomposition (paper eq. 17).

    Parameters
    ----------
    model, encoder, dt, cutoff
        See `IV`.
    prefilter_zeros : sequence of float, optional
        Zeros of the pre-filter [rad/s]. With these zeros, the result is the biased estimate of the extended model
        (paper eq. 19 to 21).

    Notes
    -----
    theta = (sum phi phi^T)^-1 sum phi z. Quantisation makes this estimate biased; `BCLS` compensates the bias.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import LS, Drive, Encoder, quantize
    >>> from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, simulate_drive
    >>> u = prbs(1500, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
    >>> counts = quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION)
    >>> fit = LS(Drive(CART.input_gain), Encoder(CART_RESOLUTION), CART_DT, 20.0).fit(u, counts)
    >>> fit.names
    ('mass', 'viscous_friction', 'coulomb_friction')
    """

    method: ClassVar[str] = "ls"

    def _solve(self, columns: Columns) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        scale = np.linalg.norm(columns.phi, axis=0)
        Q, R = np.linalg.qr(columns.phi / scale)
        inverse = inverse_of(R)
        return inverse @ (Q.T @ columns.z) / scale, inverse @ inverse.T / np.outer(scale, scale)

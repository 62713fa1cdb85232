"""Iterated instrumental variables with an auxiliary model that contains friction, as a base for `IV` and others."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.auxiliary import auxiliary_columns, make_auxiliary_kernel
from pmfid.estimators.base import Simulating
from pmfid.estimators.batch import check_identifiable, filter_parts
from pmfid.estimators.configuration import check_arrays, check_size, like
from pmfid.estimators.least_squares import inverse_of, solve_bounded, solve_with_instruments
from pmfid.estimators.ls import BCLS
from pmfid.estimators.recursive import impulse_products
from pmfid.estimators.results import Columns, Fit
from pmfid.estimators.srivc import ProcessSolver, fixed_filters
from pmfid.estimators.stretches import liveliest
from pmfid.estimators.tuning import TUNING
from pmfid.linear.solve import ProcessProblem, Solution
from pmfid.models.drive import Model
from pmfid.models.equation import (
    COULOMB_BACKWARD,
    COULOMB_FORWARD,
    DEAD_TIME,
    ESTIMATE,
    LAG,
    MASS,
    OFFSET,
    ROLES,
    STIFFNESS,
    VISCOUS_FORWARD,
    Equation,
)
from pmfid.status import Status


@dataclass(frozen=True)
class Instruments(ProcessSolver, Simulating):
    """The converged iteration of instrumental variables, and its error bars; see `IV`."""

    initial: Mapping[str, float] | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.equation.searched:
            names, other = ", ".join(self.equation.searched), "fit" if self.plant.rests else "srivc"
            raise UsageError(f"iv estimates parameters that act linearly, and {names} does not; use {other}")

    def solve_problem(self, problem: ProcessProblem) -> Solution:
        return fixed_filters(problem)

    def _fit(self, u: ArrayLike, counts: ArrayLike) -> Fit:
        """Estimate the parameters. Raises NotIdentifiableError also if the iteration does not converge."""
        u, counts = check_arrays(u, counts)
        return self.fit_settled(*self.settle_iteration(u, counts), u, counts)

    def fit_settled(
        self, columns: Columns, theta: NDArray[np.float64], u: NDArray[np.float64], counts: NDArray[np.int64]
    ) -> Fit:
        """Return the fit of a converged iteration from its columns and theta (p,)."""
        return self._result(columns, theta, self.estimate_covariance(columns, theta, u, counts))

    def settle_iteration(
        self, u: ArrayLike, counts: ArrayLike, near: float | None = None
    ) -> tuple[Columns, NDArray[np.float64]]:
        """Return the columns of the last iteration and theta (p,), as `fit` without the covariance. Raises the errors
        of `fit`. `start` describes `near`."""
        if np.size(u) > TUNING.stretch and self.steps is None:
            with suppress(NotIdentifiableError):
                return self._settle_from_stretch(*check_arrays(u, counts), near)
        theta = self.start(u, counts, near)
        for turn in range(TUNING.instruments_max_iterations):
            columns = self.columns_at(theta, u, counts)
            check_identifiable(columns, self.names, simulated=True)
            before, theta = theta, self._plausible(theta, self._solve(columns)[0])
            if turn >= TUNING.damped_from:
                theta = (theta + before) / 2
            change = _measure_change(columns, before, theta)
            if change <= TUNING.instruments_tolerance or (
                turn == TUNING.instruments_max_iterations - 1 and change <= TUNING.instruments_accepted
            ):
                return columns, theta
        raise NotIdentifiableError(
            "the iteration does not converge (last "
            f"{dict(zip(self.names, theta.round(4).tolist(), strict=True))}): the simulated motion does "
            "not follow the measured motion; check input_gain and the model, or in Python give `initial`"
        )

    def _settle_from_stretch(
        self, u: NDArray[np.float64], counts: NDArray[np.int64], near: float | None
    ) -> tuple[Columns, NDArray[np.float64]]:
        """Return the result of `settle_iteration` for a long record, by the method of Broyden (1965).

        The iteration starts from the liveliest stretch, with the gain of that stretch. Raises NotIdentifiableError also
        if a few turns do not settle.
        """
        part = liveliest(self.encoder.position(counts), TUNING.stretch)
        columns, theta = self.settle_iteration(u[part], counts[part], near)
        gain = self._gain(columns, theta, u[part], counts[part]) * columns.z.size
        score, step = np.zeros(theta.size), np.zeros(theta.size)
        for turn in range(TUNING.stretch_turns):
            columns = self.columns_at(theta, u, counts)
            check_identifiable(columns, self.names, simulated=True)
            last, score = score, columns.zeta.T @ (columns.z - columns.phi @ theta) / columns.z.size
            if turn > 0:
                expected = gain @ (last - score)
                gain += np.outer(step - expected, step @ gain) / (step @ expected)
            before, theta = theta, self._plausible(theta, theta + gain @ score)
            step = theta - before
            if _measure_change(columns, before, theta) <= TUNING.instruments_tolerance:
                return columns, theta
        raise NotIdentifiableError("the iteration does not converge on a part of the record")

    def estimate_covariance(
        self, columns: Columns, theta: NDArray[np.float64], u: NDArray[np.float64], counts: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        """Return the covariance (p, p) of theta (p,), with the gain that contains the reversals of the model."""
        return self._covariance(columns, theta, self._gain(columns, theta, u, counts))

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
        size[[name in (DEAD_TIME, LAG) for name in self.names]] = self.dt
        for i, step in enumerate(TUNING.jacobian_step * size):
            moved = [theta + side * np.eye(theta.size)[i] for side in (step, -step)]
            sides = [self.columns_at(at, u, counts, rests) for at in moved]
            # two motions use different samples if one of them moves while the other rests
            used = columns.used & sides[0].used & sides[1].used
            error = [(side.z - side.phi @ at)[used[side.used]] for side, at in zip(sides, moved, strict=True)]
            with np.errstate(over="ignore"):  # the error comes from a resolution that no encoder has
                jacobian[:, i] = columns.zeta[used[columns.used]].T @ (error[1] - error[0]) / (2 * step)
        return inverse_of(jacobian)

    def start(
        self, u: ArrayLike, counts: ArrayLike, near: float | None = None, bounded: bool = False
    ) -> NDArray[np.float64]:
        """Return the given start values (p,), or start values from the counts alone.

        `near` is the approximate delay of the input [s], if the estimator finds a delay, or None. If `bounded`, only a
        constant load and waves may be negative, so that the motion is stable.
        """
        if self.initial is not None:
            return initial_vector(self.initial, self.names)
        if self.equation.lag == ESTIMATE:
            tried = _nearest(TUNING.tried_lags, near, self.dt)
            return self._start_late(self.model.replace_lag, tried, u, counts, bounded)
        if self.equation.dead_time == ESTIMATE:
            tried = _nearest(TUNING.instruments_tried, near, self.dt)
            return self._start_late(self.model.replace_dead_time, tried, u, counts, bounded)
        batch = like(BCLS, self, model=self.model.simple)
        found = None if bounded else batch.solve(u, counts)
        if found is None or not found[batch.equation.leading] > 0:
            positive = np.array(batch.equation.positive)
            if (stiffness := batch.equation.roles[STIFFNESS]) is not None:
                positive[stiffness] = True
            found = solve_bounded(batch.columns(u, counts), positive)
        theta = spread(batch.equation.role_values(found), self.equation)
        for term in batch.equation.shaped:
            theta[self.names.index(str(term.name))] = found[batch.names.index(str(term.name))]
        return theta

    def _start_late(
        self, at: Callable[[float], Model], tried: Sequence[float], u: ArrayLike, counts: ArrayLike, bounded: bool
    ) -> NDArray[np.float64]:
        """Return start values with the dead time or lag whose simulated velocity is nearest to the measured velocity.
        `at` returns the model for a time [s], and `tried` are the times to try [samples]."""
        found: list[tuple[float, NDArray[np.float64]]] = []
        refused: NotIdentifiableError | None = None
        for samples in tried:
            known = like(Instruments, self, model=at(samples * self.dt))
            try:
                theta = known.start(u, counts, bounded=bounded)
            except NotIdentifiableError as error:
                refused = refused or error
                continue
            if not _poles_swapped(known.equation, theta):
                found.append((known.mismatch(theta, u, counts), np.r_[theta, samples * self.dt]))
        if not found:
            raise refused or NotIdentifiableError("the iteration has no start values")
        return min(found, key=lambda pair: pair[0])[1]

    def _fix_lag(self, seconds: float) -> Instruments:
        return like(Instruments, self, model=self.model.replace_lag(seconds))

    def mismatch(self, theta: NDArray[np.float64], u: ArrayLike, counts: ArrayLike) -> float:
        """Return the mean square error of the filtered velocity, relative to the mean square of the measured velocity.
        The model simulates the velocity at theta (p,)."""
        columns, used, _ = self._filter_record(theta, *check_arrays(u, counts), None)
        check = auxiliary_columns(self)[3]
        measured, modelled = columns[used, check], columns[used, check + 1]
        return float(np.sum((measured - modelled) ** 2) / max(float(np.sum(measured**2)), TUNING.tiny))

    def columns_at(
        self, theta: NDArray[np.float64], u: ArrayLike, counts: ArrayLike, rests: bool | None = None
    ) -> Columns:
        """Return regressors, target and instruments with the auxiliary model at theta (p,).

        If a record begins at rest and the model agrees, the axis has been at rest before, and its first motion counts.
        `rests` says whether the record begins at rest. None decides from the counts and theta.
        """
        if self.equation.lag == ESTIMATE:
            return linearise_lag(
                lambda lag: self._fix_lag(lag).columns_at(theta[:-1], u, counts, rests), theta, self.dt
            )
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
        used[: 0 if before else int(TUNING.start_part * used.size)] = False
        return columns, used, status

    def _rests(self, u: NDArray[np.float64], counts: NDArray[np.int64], theta: NDArray[np.float64]) -> bool:
        """Return whether the axis rests at first, according to the counts and the friction of theta (p,)."""
        begin = slice(0, TUNING.rest_samples)
        if counts.size <= TUNING.rest_samples or np.any(counts[begin] != counts[0]):
            return False
        friction = min(
            (theta[i] for i in (self.equation.roles[r] for r in (COULOMB_FORWARD, COULOMB_BACKWARD)) if i is not None),
            default=0.0,
        )
        index = self.equation.roles[OFFSET]
        force = self.equation.input_gain * u[begin] - (0.0 if index is None else theta[index])
        return bool(np.all(np.abs(force) <= friction)) and not self.equation.place_matters

    @property
    def positive(self) -> NDArray[np.bool_]:
        """Truth values (p,), True for parameters that are never negative in a machine."""
        return np.array([*self.equation.positive, *(True for _ in self.equation.further)])

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
        low = np.where(self.positive, 0.5 * theta, -np.inf)
        return np.maximum(found, low)


def _measure_change(columns: Columns, before: NDArray[np.float64], theta: NDArray[np.float64]) -> float:
    """Return the largest relative change of a parameter from `before` to `theta` (p,)."""
    small = (
        TUNING.instruments_small
        * np.linalg.norm(columns.z)
        / np.maximum(np.linalg.norm(columns.phi, axis=0), TUNING.tiny)
    )
    size = np.maximum(np.maximum(np.abs(theta), np.abs(before)), small)
    return float(np.max(np.abs(theta - before) / size))


def _nearest(tried: Sequence[float], near: float | None, dt: float) -> Sequence[float]:
    """Return the tried times [samples] next to the time `near` [s], or all of them without `near`."""
    if near is None:
        return tried
    return sorted(tried, key=lambda samples: abs(samples - near / dt))[: TUNING.tried_near]


def _poles_swapped(equation: Equation, theta: NDArray[np.float64]) -> bool:
    """Return whether the body is faster than a known lag of its input. Exchanged poles would then fit nearly as
    well.
    """
    values = equation.role_values(theta)
    return equation.lag != 0 and values[MASS] < float(equation.lag) * values[VISCOUS_FORWARD]


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


def linearise_lag(columns_at: Callable[[float], Columns], theta: NDArray[np.float64], dt: float) -> Columns:
    """Return the columns for theta (p,), whose last element is the lag [s], from columns at known lags.

    To first order, the term of the lag is the change of the equation's error with the lag. The target counts from the
    present lag, so that an iteration ends when this term is zero. The change of the error has no noise and is its own
    instrument.
    """
    lag, others = max(float(theta[-1]), 0.0), theta[:-1]
    low, high = max(lag - TUNING.lag_step * dt, 0.0), lag + TUNING.lag_step * dt
    below, here, above = (columns_at(value) for value in (low, lag, high))
    change = (below.z - below.phi @ others) - (above.z - above.phi @ others)
    column = change / (high - low)
    phi, zeta = (np.column_stack([side, column]) for side in (here.phi, here.zeta))
    return replace(here, phi=phi, z=here.z + lag * column, zeta=zeta)

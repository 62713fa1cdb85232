"""Output error and the interval likelihood of counts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from numbers import Real
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.base import Simulating
from pmfid.estimators.batch import BatchEstimator, check_identifiable
from pmfid.estimators.configuration import check_arrays, hold_last_input, like
from pmfid.estimators.instruments import Instruments
from pmfid.estimators.likelihood import Best, best_of, cost, expected_information, likeliest_of
from pmfid.estimators.ls import BCLS
from pmfid.estimators.motion import Difference, first_speed, invert_information, least, mean_velocity, rms
from pmfid.estimators.results import Fit
from pmfid.estimators.search import (
    LOST,
    Windows,
    choose_window,
    descend,
    find_least_from_start,
    fit_at_speeds,
    fit_windows,
    is_lost,
)
from pmfid.estimators.srivc import ProcessSolver, solve_by_descent
from pmfid.estimators.stretches import gaps_in
from pmfid.estimators.tuning import TUNING
from pmfid.estimators.uncertainty import (
    likelihood_covariance,
    phase_scatter,
    raise_variances,
    scatter,
    widen_covariance,
)
from pmfid.linear.solve import ProcessProblem, Solution
from pmfid.models.drive import EquationModel
from pmfid.models.equation import ESTIMATE
from pmfid.status import Status
from pmfid.types import Floats

#: Request for a window length that the record determines.
AUTO_WINDOW = "auto"


@dataclass(frozen=True)
class Following(Simulating, BatchEstimator):
    """A `BatchEstimator` that finds the simulated motion closest to the counts. `OE` describes the arguments."""

    initial: Mapping[str, float] | None = field(default=None, kw_only=True)
    drift_cutoff: float | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.drift_cutoff is not None and not 0 <= self.drift_cutoff * self.dt <= 2:
            raise UsageError(
                f"drift_cutoff must be from 0 to 2/dt = {2 / self.dt:g} rad/s, got {self.drift_cutoff}; 0 "
                "turns the high-pass filter off, None chooses it by the record"
            )

    def best(self, u: ArrayLike, counts: ArrayLike, start: Floats | None = None) -> Best:
        """Return the likeliest motion among those that the start values lead to. `fit_least_squares` describes the
        arguments and errors."""
        u, counts = check_arrays(u, counts)
        if start is not None or not self.equation.searched:
            return best_of(*self.fit_least_squares(u, counts, start))
        return likeliest_of(self._maxima(u, counts), self.cutoff)

    def _maxima(self, u: Floats, counts: NDArray[np.int64]) -> Iterator[Best]:
        """Yield the maximum from each Stribeck start speed. Raises NotIdentifiableError if no search converges."""
        refused, settled = None, False
        for theta, status in self._start_at_speeds(u, counts):
            try:
                yield replace(best_of(*self.fit_least_squares(u, counts, theta)), status=status)
                settled = True
            except NotIdentifiableError as error:
                refused = error
        if refused and not settled:
            raise refused

    def fit_least_squares(
        self, u: ArrayLike, counts: ArrayLike, start: Floats | None = None
    ) -> tuple[Difference, Floats, int]:
        """Return the difference in its final form, its least squares q, and the status bits of the record.

        The first pass always has the high-pass, because the position itself has local minima if friction drifts.
        `start` (p,) are start values of the parameters; None takes the estimate of `IV`.
        """
        u, counts = check_arrays(u, counts)
        theta, status = self._start(u, counts) if start is None else (start, 0)
        difference, q = self._prepare_difference(theta, u, self.position(counts))
        if not self.equation.place_matters or difference.breaks or self.drift_cutoff:
            return *self._fit_from_one_start(difference, q), status
        direct, single, refused = replace(difference, pole=0.0), None, None
        if not is_lost(direct, q):
            try:
                single = self._fit_from_one_start(difference, q)
                if not single[0].pole:
                    return *single, status
            except NotIdentifiableError as error:
                refused = error
        found = fit_windows(direct, q, self.cutoff)
        if found is None and refused:
            raise refused
        found = found or single
        if found is None and rms(difference(q)) > difference.size_of_motion:
            raise NotIdentifiableError(LOST)
        return *(found or self._fit_from_one_start(difference, q)), status

    def _fit_from_one_start(self, difference: Difference, q: Floats) -> tuple[Difference, Floats]:
        """Return the difference in its final form and its least squares, starting from q (q,)."""
        q = self._find_least(difference, q)
        difference = difference.fine_at(q[:-2] * difference.scale[:-2])
        if self.drift_cutoff:
            return difference, q
        direct = replace(difference, pole=0.0)
        if self.drift_cutoff is None and rms(difference(q)) > TUNING.output_error_hopeless * direct.explained:
            return difference, q
        closer = least(direct, q)
        if 1 < rms(direct(closer)) / direct.explained < TUNING.output_error_far:
            closer = min(closer, self._slowly(difference, q), key=lambda found: rms(direct(found)))
        if self.drift_cutoff == 0 or rms(direct(closer)) <= direct.explained:
            return direct, closer
        return difference, q

    def _find_least(self, difference: Difference, q: Floats) -> Floats:
        """Return the least squares from q (q,). A motion with many parts per sample is first fitted with fewer parts.
        One search with 16 parts takes as long as five searches with 2 parts."""
        if difference.parts > TUNING.parts_roughly:
            coarse = replace(difference, parts=TUNING.parts_roughly)
            with suppress(NotIdentifiableError):
                return least(difference, find_least_from_start(coarse, q, self.cutoff, [TUNING.output_error_roughly]))
        return find_least_from_start(difference, q, self.cutoff)

    def _slowly(self, difference: Difference, q: Floats) -> Floats:
        """Return the least squares of the position itself by a series of ever slower high-passes. The series avoids
        local minima. The result is the last q (q,) that converged."""
        try:
            for part in TUNING.output_error_slower:
                q = least(replace(difference, pole=part * difference.pole), q)
        except NotIdentifiableError:
            pass
        return q

    def make_least_squares_fit(self, best: Best) -> Fit:
        """Return the `Fit` of the least squares."""
        difference, q = best.difference, best.least
        moves, covariance = self._scatter_scores(difference, q)
        covariance = widen_covariance(covariance, lambda width: self._scatter_scores(difference, q, width)[1])
        if best.noise is not None:
            # the motion that explains every count rests where the axis rested: a controller parks the axis near an edge
            covariance = raise_variances(covariance, phase_scatter(difference, best.q, moves, None))
        covariance = self.with_drift(best, covariance) + _simulation_scatter(difference, q, moves)
        return self.result(difference, q, covariance, best.status)

    def _scatter_scores(
        self, difference: Difference, q: Floats, width: float = TUNING.quotient_step
    ) -> tuple[Floats, Floats]:
        """Return the effect (n, p) of each sample's error on the parameters, and the parameters' covariance (p, p). The
        covariance follows from the scatter of the residual. `width` is the width of the difference quotients."""
        sensitivity = self.own_sensitivity(difference, q, width=width)
        moves = sensitivity @ invert_information(sensitivity, self.names)
        return moves, scatter(difference.sum_by_sample(moves * difference(q)[:, None]), difference.recovery)

    def with_drift(self, best: Best, covariance: Floats) -> Floats:
        """Raise the variances of a covariance (p, p) to those of the high-pass if noise remains beyond the encoder's
        error.

        Unmodelled effects add up to a drift of the position. One record below half a count shows too little of this
        drift to measure its scatter.
        """
        if best.noise is None or best.clean:
            return covariance
        high_passed = replace(best.difference, pole=self.cutoff)
        return raise_variances(covariance, np.diagonal(self._scatter_scores(high_passed, best.q)[1]))

    def own_sensitivity(
        self, difference: Difference, q: Floats, root: Floats | None = None, width: float = TUNING.quotient_step
    ) -> Floats:
        """Return the effect (n, p) of each parameter on the difference that the start cannot reproduce."""
        return difference.own_sensitivity(q, root, width)

    def position(self, counts: NDArray[np.int64]) -> Floats:
        """Return the unwrapped position of the counts (n,), without the jumps beyond max_speed."""
        y = self.encoder.position(counts)
        if self.encoder.max_speed is None:
            return y
        change = np.diff(y)
        jump = np.abs(change) > self.encoder.max_speed * self.dt + self.encoder.resolution
        return np.asarray(y[0] + np.r_[0.0, np.cumsum(np.where(jump, 0.0, change))])

    def _start_at_speeds(self, u: Floats, counts: NDArray[np.int64]) -> list[tuple[Floats, int]]:
        """Return start values (p,) and status bits for each promising Stribeck speed."""
        y, usual, near = self.position(counts), *self._usual_motion(u, counts)

        def fit_at(speed: float) -> tuple[float, Floats, int]:
            known = like(OE, self, model=EquationModel(self.equation.replace_shapes([speed])))
            theta, status = known._start(u, counts, near)
            difference, q = known._prepare_difference(theta, u, y)
            follows = not (self.equation.place_matters and is_lost(replace(difference, pole=0.0), q))
            if follows:  # windows handle what is lost from a single start
                q = least(difference, q, [TUNING.output_error_roughly])
            return rms(difference(q)), np.r_[(q * difference.scale)[:-2], speed], status

        found = fit_at_speeds(usual, fit_at, lambda one: one[0])
        return [(theta, status) for _, (_, theta, status) in found]

    def _usual_motion(self, u: Floats, counts: NDArray[np.int64]) -> tuple[float, float]:
        """Return the root mean square speed of the usual motion, and the estimated delay of the input [s]. The speed
        comes from the motion of the model without shapes, or from the counts if this model makes no motion."""
        plain = like(Instruments, self, model=self.model.symmetric, initial=None)
        theta = plain.start(u, counts)
        velocity = mean_velocity(plain.equation, theta, self.intervals, hold_last_input(u))
        moving = velocity[velocity != 0]
        usual = rms(moving) if moving.size else rms(np.diff(self.position(counts))) / self.dt
        return usual, float(theta[-1])

    def _start(self, u: Floats, counts: NDArray[np.int64], near: float | None = None) -> tuple[Floats, int]:
        """Return the estimate (p,) of `IV` and the status bits of the record.

        If `IV` does not converge, the result is its start value. If the model has an unknown Stribeck speed, the result
        belongs to the best of the promising speeds. `near` is the approximate delay of the input [s], if the estimator
        finds a delay. Raises NotIdentifiableError if the counts alone show that no parameter can be identified.
        """
        if self.equation.searched:
            return self._start_at_speeds(u, counts)[0]
        first = like(Instruments, self)
        try:
            columns, theta = first.settle_iteration(u, counts, near)
        except NotIdentifiableError:
            batch = like(BCLS, self, model=self.model.simple)
            check_identifiable(batch.columns(u, counts), batch.names, TUNING.motion_apart**2)
            theta = first.start(u, counts, near, bounded=True)
            columns = first.columns_at(theta, u, counts)
        return theta, columns.status

    def _prepare_difference(self, theta: Floats, u: Floats, y: Floats) -> tuple[Difference, Floats]:
        """Return the high-passed difference, and the start value q for theta (p,) at the first count. A NaN in the
        input u (n,) marks a gap."""
        breaks, u = gaps_in(u), hold_last_input(u)
        travel, dt = float(np.ptp(y)), self.dt
        force, mass = abs(self.equation.input_gain) * rms(u), abs(theta[self.equation.leading])
        drag = force * y.size * dt / travel
        inertia = max(mass, drag * dt)  # a smaller inertia shows only within a sample
        natural = np.r_[[inertia, drag, drag, force, force, force, force / travel], self._sizes(theta, force, y)]
        size = np.abs(theta)
        for index, smallest in zip(self.equation.roles, np.r_[0.01 * natural, dt], strict=True):
            if index is not None:
                size[index] = max(size[index], smallest)
        if self.equation.lag == ESTIMATE:
            size[len(self.equation.names)] = max(size[len(self.equation.names)], dt)
        scale, pole = np.r_[size, travel, travel * self.cutoff], self.drift_cutoff or self.cutoff
        steps = self.steps_before(u.size)
        intervals = None if steps is None else np.r_[steps[1:], dt]
        difference = Difference(self.equation, dt, u, y, self.encoder.resolution, scale, pole, uneven=intervals)
        difference = replace(difference, breaks=breaks).fine_at(theta)
        v0 = first_speed(y, difference.intervals, self.cutoff, self.encoder.resolution)
        return difference, np.maximum(np.r_[theta, y[0], v0] / scale, difference.lower)

    def _sizes(self, theta: Floats, force: float, y: Floats) -> list[float]:
        """Return the coefficients for which each shape equals the force at the speed of y (n,)."""
        shaped = self.equation.known_at(theta[len(self.equation.names) :]).shaped
        speed = rms(np.diff(y)) / self.dt
        return [force / term.shape.size(speed) for term in shaped if term.shape is not None]

    def make_difference(self, theta: Floats, u: Floats, y: Floats) -> Difference:
        """Return the difference without a high-pass for an input u (n,) and a position y (n,). theta (p,) has the
        typical sizes of the parameters."""
        return replace(self._prepare_difference(theta, u, y)[0], pole=0.0)

    def result(self, difference: Difference, q: Floats, q_cov: Floats, status: int) -> Fit:
        """Return the `Fit` at q with the scaled covariance (p, p). Raises NotIdentifiableError for an invalid result
        and for a mass at its lower bound."""
        leading = difference.equation.leading
        if q[leading] < TUNING.at_bound * TUNING.least_mass:
            raise NotIdentifiableError(
                f"{self.names[leading]} is estimated as zero: this record cannot identify it, or an input "
                "that was logged late hides it; record stronger accelerations, and compare the times of the "
                "columns"
            )
        residual = difference(q)
        relative = rms(residual) / difference.size_of_motion
        if not (relative < TUNING.worst_fit or rms(residual) <= difference.explained):
            raise NotIdentifiableError(
                f"the simulated position does not follow the record: {relative:.0%} of the motion remains "
                "unexplained; check the sign of input_gain, look for unmodelled load or friction, or use a "
                "recursive method"
            )
        scale = difference.scale[: len(self.names)]
        theta, cov = q[: scale.size] * scale, q_cov * np.outer(scale, scale)
        residual = (
            difference.sum_by_sample(residual)
            / difference.sum_by_sample(np.ones(residual.size))
            * difference.resolution
        )
        return Fit(self.names, self.units, theta, cov, residual.size, residual, relative, status)


def _simulation_scatter(difference: Difference, q: Floats, moves: Floats) -> Floats:
    """Return the covariance (p, p) of the change by a simulation with twice as many parts per sample.

    `moves` (n, p) is the effect of each sample's error on the parameters. In a sensitive motion, such as that of a
    pendulum driven over its top, an error of a millionth of a count grows to hundreds of counts. Many parameters
    explain every count of such a motion.
    """
    if not (difference.equation.shaped or difference.equation.lag):
        return np.zeros((moves.shape[1], moves.shape[1]))
    change = moves.T @ (difference.finer(q) - difference(q))
    return np.outer(change, change)


@dataclass(frozen=True)
class OE(ProcessSolver, Following):
    """Off-line output error (Ljung 1999, sections 4.2 and 7.2), which simulates the kernel's body with stiction.

    Parameters
    ----------
    model, encoder, dt, cutoff
        See `IV`.
    drift_cutoff : float, optional
        Pole of a first-order high-pass on y - x [rad/s], 0 to 2/dt. The value 0 means no high-pass. By default the
        high-pass has the pole `cutoff` if y - x exceeds the encoder's error (0.5 counts root mean square).
    window : float or "auto", optional
        Length [s] of overlapping windows for a least squares fit of the position itself. Each window has its own start,
        and neighbouring windows overlap by half. Windows suit long predictions by a model with inexact friction. "auto"
        takes the length that predicts unfitted parts of the record best. Only machines without `drift_cutoff` take
        windows.
    initial : mapping, optional
        Start values for `IV` by parameter name.

    Notes
    -----
    The method minimises the sum of (y(k) - x(k))^2, k = 0..n-1. y is the middle of the count, and x is the position
    that
    the input alone gives from the start x0, v0. The fit includes the start and keeps mass > 0 and frictions >= 0. The
    search starts from the estimate of `IV`, or from the start values of `IV` if `IV` does not converge.

    theta_cov holds for residuals with any correlation in time, and for the encoder's error along this motion at any
    place of the lattice. The residual is y - x [unit of the resolution] after the high-pass. relative_error is the norm
    of the residual over the norm of y less its mean. If the fit uses windows, the residual (n,) is the mean over them.

    Unmodelled friction adds up to a random walk of the position, and the high-pass whitens a random walk plus white
    noise. The high-pass costs information. On the cart with 128 increments, a high-pass of 20 rad/s multiplies the
    standard deviation of the mass by 2.4, and of the frictions by 7.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import OE, Drive, Encoder, quantize
    >>> from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, simulate_drive
    >>> u = prbs(1500, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
    >>> counts = quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION)
    >>> fit = OE(Drive(CART.input_gain), Encoder(CART_RESOLUTION), CART_DT, 20.0).fit(u, counts)
    >>> fit.theta.round(2)
    array([ 1.07, 12.8 ,  0.8 ])
    """

    method: ClassVar[str] = "output-error"
    window: float | str | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.window is None:
            return
        if self.drift_cutoff is not None or not self.plant.rests:
            other = "a drift_cutoff" if self.plant.rests else "a transfer function"
            raise UsageError(
                f"window cannot be combined with {other}, because the windows replace it; remove one of the two"
            )
        if self.window != AUTO_WINDOW:
            _check_window(self.window, self.dt)

    def solve_problem(self, problem: ProcessProblem) -> Solution:
        return solve_by_descent(problem)

    def _fit(self, u: ArrayLike, counts: ArrayLike) -> Fit:
        """Return the fit. Raises NotIdentifiableError if the simulation does not follow the counts."""
        return (
            self.make_least_squares_fit(self.best(u, counts)) if self.window is None else self._fit_windows(u, counts)
        )

    def _fit_windows(self, u: ArrayLike, counts: ArrayLike) -> Fit:
        u, counts = check_arrays(u, counts)
        theta, status = self._start(u, counts)
        direct = self.make_difference(theta, hold_last_input(u), self.position(counts))
        theta = np.maximum(theta / direct.scale[:-2], direct.lower[:-2])
        choice = choose_window(direct, theta, self.cutoff) if isinstance(self.window, str) else None
        samples = choice.samples if choice else round(min(u.size, float(self.window or 0.0) / self.dt))
        windows = Windows.cover_stretches(direct, [(0, u.size)], samples)
        q = descend(windows, windows.start_windows(theta, self.cutoff))
        fit = self.result(windows, q, self._window_covariance(windows, q), status)
        return replace(fit, notes=(choice.says,)) if choice else fit

    def _window_covariance(self, windows: Windows, q: Floats) -> Floats:
        """Return the covariance (p, p) of the scaled parameters from windows."""
        moves, covariance = self._scatter_scores(windows, q)
        covariance = widen_covariance(covariance, lambda width: self._scatter_scores(windows, q, width)[1])
        if rms(windows(q)) <= windows.explained:
            covariance = raise_variances(covariance, phase_scatter(windows, q, moves, None))
        samples = moves.shape[0]
        return np.asarray(covariance * (samples / max(1, samples - q.size)))


def _check_window(window: object, dt: float) -> None:
    usable = isinstance(window, Real) and TUNING.search_fewest * dt <= float(window) < math.inf
    if isinstance(window, bool) or not usable:
        raise UsageError(
            f"window must be at least {TUNING.search_fewest * dt:g} s ({TUNING.search_fewest} samples), "
            f"or {AUTO_WINDOW!r}, got {window!r}"
        )


@dataclass(frozen=True)
class IntervalML(Following):
    """Off-line maximum likelihood of the counts (Ljung 1999, section 7.4, for a quantised output).

    Parameters
    ----------
    model, encoder, dt, cutoff
        See `IV`.
    drift_cutoff : float, optional
        Pole of a first-order high-pass on y - x [rad/s]. The value 0 means no high-pass; the default is that of `OE`.
    initial : mapping, optional
        Start values by parameter name.

    Notes
    -----
    The method maximises log L = sum log(Phi((b - x)/s) - Phi((a - x)/s)). x(k) is the simulated position, and a =
    resolution * counts and b = a + resolution are the edges of the count. The fit also estimates s >= 0.02 counts, the
    standard deviation of other errors of the position. The search starts from `OE`.

    theta_cov is the inverse of the expected information, because the observed likelihood has no curvature far from the
    edges. If the scores scatter more than expected, theta_cov contains the excess scatter. The scatter is measured in
    blocks of every length and over all places of the encoder's lattice.

    If y - x exceeds the encoder's error, or if `OE` has a high-pass, the edges of the counts say nothing about x. In
    this case, the result comes from `OE`, with `Status.FALLBACK`.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import Drive, Encoder, IntervalML, quantize
    >>> from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, simulate_drive
    >>> u = prbs(1000, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
    >>> counts = quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION)
    >>> fit = IntervalML(Drive(CART.input_gain), Encoder(CART_RESOLUTION), CART_DT, 20.0).fit(u, counts)
    >>> fit.theta.round(3)
    array([ 1.07, 12.8 ,  0.8 ])
    """

    method: ClassVar[str] = "interval"

    def _fit(self, u: ArrayLike, counts: ArrayLike) -> Fit:
        """Return the fit. Raises NotIdentifiableError if the simulation does not follow the counts."""
        return self.fit_of(self.best(u, counts))

    def fit_of(self, best: Best) -> Fit:
        """Return the result for the best motion."""
        if best.noise is None:
            return self.make_least_squares_fit(replace(best, status=best.status | int(Status.FALLBACK)))
        difference, q, noise = best.difference, best.q, best.noise
        error = difference(q)
        root = np.sqrt(expected_information(error, noise))
        own = self.own_sensitivity(difference, q, root)
        weighted, slope = own * root[:, None], cost(error, noise)[1]
        inverse = invert_information(weighted, self.names)
        covariance = likelihood_covariance(best, weighted, own * slope[:, None])
        moves = weighted * root[:, None] @ inverse
        covariance = self.with_drift(best, covariance) + _simulation_scatter(difference, q, moves)
        return self.result(difference, q, covariance, best.status)

"""Output error: the position simulated from the input alone against the counts, off-line."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import lfilter

from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.base import check_arrays, held, like
from pmfid.estimators.batch import (
    BCLS,
    BatchEstimator,
    Fit,
    check_identifiable,
    parts_of_their_own,
)
from pmfid.estimators.iv import IV
from pmfid.estimators.rough import on_every_width
from pmfid.estimators.scatter import raised, scatter
from pmfid.estimators.srivc import by_descent, counted, fit_process, without_start
from pmfid.models.equation import Equation

#: Step of the difference quotients as a part of a parameter: far above the kinks that stops and reversals leave in
#: the simulated position, far below what makes the position bend.
STEP = 1e-4
MAX_EVALUATIONS = 200
TOLERANCE = 1e-10
#: A stop of the model that comes and goes puts kinks into the sum of squares, at which the last digits never settle.
ROUGH_TOLERANCE = 1e-7
#: Root mean square of the difference, in counts, up to which the encoder explains it; rounding down alone gives 0.29.
ENCODER_ALONE = 0.5
#: Accuracy of the simulated position, as a part of the travel.
SIMULATION_ERROR = 1e-5
#: A larger part of the motion left unexplained is no fit.
WORST_FIT = 0.5
#: The high-pass lets white noise grow by less than this: where more is left behind it, the counts are not explained.
HOPELESS = 2.5
#: A difference so many times what the encoder explains is no matter of local minima.
FAR = 10.0
#: High-passes on the way to none, as parts of the first.
SLOWER = (1 / 4, 1 / 16, 1 / 64, 0.0)
#: Counts within a filter time constant by which the start velocity may be off.
START_COUNTS = 3.0
#: Square root of the information [1/counts] of a sample with a white encoder error.
WHITE = math.sqrt(12.0)
#: Part of a sensitivity that must not follow from the others.
APART = 1e-3

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Difference:
    """Position of the counts minus simulated position, in counts, as a function of q = (theta, x0, v0) / scale.

    equation: its roles say what the simulation takes of theta; u, y: (n,), dt [s]; resolution; scale: (q,);
    pole: of the high-pass on the difference [rad/s], 0: none.
    """

    equation: Equation
    dt: float
    u: Floats
    y: Floats
    resolution: float
    scale: Floats
    pole: float

    def __call__(self, q: Floats) -> Floats:
        return self.filtered(self.y - self.motion(q)[0]) / self.resolution

    def motion(self, q: Floats, force: Floats | None = None) -> tuple[Floats, Floats]:
        """Simulated position at the samples and mean velocity between them, each (n,); force (n,): on top of that of
        the input [unit of the equation]."""
        from pmfid import _kernel64

        *theta, x0, v0 = q * self.scale
        gain = self.equation.input_gain
        u = self.u if force is None else self.u + force / gain
        start = float(v0), float(x0 - self.y[0])  # a spring's length counts from the first count
        velocity = _kernel64.simulate(self.roles_of(theta), gain, self.dt, u, *start)[0]
        return x0 + np.r_[0.0, np.cumsum(velocity[:-1])] * self.dt, velocity

    def roles_of(self, theta: Sequence[float]) -> list[float]:
        """The parameters (p,) as the simulation takes them, 0 for what the equation lacks."""
        return [0.0 if index is None else float(theta[index]) for index in self.equation.roles]

    def filtered(self, signal: Floats) -> Floats:
        """The high-pass, from rest: white noise on top of a random walk leaves it white."""
        if self.pole == 0:
            return signal
        return np.asarray(lfilter([1.0, -1.0], [1.0, -math.exp(-self.pole * self.dt)], signal))

    def jacobian(self, q: Floats, width: float = STEP) -> Floats:
        """Derivatives by q, (n, q), as central differences that stay above the bounds."""
        columns = []
        for step in width * np.eye(q.size):
            low = np.maximum(q - step, self.lower)
            columns.append((self(q + step) - self(low)) / np.sum(q + step - low))
        return np.column_stack(columns)

    @property
    def start_velocity_std(self) -> float:
        """What the start velocity is known to, in the unit of q: some counts within a filter time constant."""
        return START_COUNTS * self.resolution / float(self.scale[-2])

    @property
    def recovery(self) -> int:
        """Samples after which the high-pass has forgotten a step; 1 without one."""
        return math.ceil(1 / (self.pole * self.dt)) if self.pole > 0 else 1

    @property
    def explained(self) -> float:
        """Root mean square [counts] that the encoder and the simulation explain."""
        return ENCODER_ALONE + SIMULATION_ERROR * float(np.ptp(self.y)) / self.resolution

    @property
    def lower(self) -> Floats:
        """Bounds of q: a mass above zero, frictions of at least zero."""
        lower = np.full(self.scale.size, -np.inf)
        lower[: len(self.equation.names)][np.array(self.equation.positive)] = 0.0
        lower[self.equation.leading] = 1e-3
        return lower


@dataclass(frozen=True)
class OE(BatchEstimator):
    """Output error, off-line (Ljung 1999, sections 4.2 and 7.2; simulation: the kernel's body with stiction).

    Least squares of y(k) - x(k), k = 0..n-1: y the middle of the count, x the position that the input alone gives
    from the start x0, v0, which are fitted as well; mass > 0, frictions >= 0. Starts from `IV`, or where that does
    not settle from its start. theta_cov is for residuals correlated in time, on whatever scale (`scatter`), and for
    the error that the encoder makes along this very motion, wherever its lattice lies (`phase_scatter`). samples is n;
    residual is y - x [unit of the resolution], relative_error its norm over that of y less its mean; both behind
    the high-pass, where there is one.

    drift_cutoff: pole of a first-order high-pass on y - x [rad/s], 0 to 2/dt; 0: none; None: none where y - x is
    within what the encoder explains (0.5 counts root mean square), and otherwise `cutoff`. Friction that the model
    lacks adds up in the position to a random walk, and this high-pass whitens a random walk with white noise on
    top. It costs information: on the cart with 128 increments and 20 rad/s the standard deviation of the mass
    becomes 2.4 times, that of the frictions 7 times as large. initial: parameters by name for `IV` to start from.
    """

    method: ClassVar[str] = "output-error"
    simulates: ClassVar[bool] = True
    on_processes: ClassVar[bool] = True

    initial: Mapping[str, float] | None = field(default=None, kw_only=True)
    drift_cutoff: float | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        without_start(self)
        if self.drift_cutoff is not None and not 0 <= self.drift_cutoff * self.dt <= 2:
            raise UsageError(
                f"drift_cutoff must be from 0 to 2/dt = {2 / self.dt:g} rad/s, got {self.drift_cutoff}; 0 is no "
                "high-pass, None chooses by the record"
            )

    def fit(self, u: ArrayLike, counts: ArrayLike) -> Fit:
        """Estimates from u, counts: (n,). Raises UsageError for arrays that do not fit each other and
        NotIdentifiableError where the record cannot identify every parameter, or the simulation does not follow."""
        if self.equation.process:
            return fit_process(self, [counted(self, u, counts)], by_descent)
        return self.by_squares(*self.followed(u, counts))

    def followed(self, u: ArrayLike, counts: ArrayLike, start: Floats | None = None) -> tuple[Difference, Floats, int]:
        """The difference as it is to be judged, its least squares q, and the status bits of the record.

        The first pass is always behind the high-pass: the position itself has local minima where friction drifts.
        start: parameters (p,) to start from, None: those of `IV`.
        """
        u, counts = check_arrays(u, counts)
        theta, status = self._start(u, counts) if start is None else (start, 0)
        difference, q = self._prepared(theta, held(u), self.position(counts))
        q = least(difference, q)
        if self.drift_cutoff:
            return difference, q, status
        direct = replace(difference, pole=0.0)
        if self.drift_cutoff is None and rms(difference(q)) > HOPELESS * direct.explained:
            return difference, q, status
        closer = least(direct, q)
        if 1 < rms(direct(closer)) / direct.explained < FAR:
            closer = min(closer, self._slowly(difference, q), key=lambda found: rms(direct(found)))
        if self.drift_cutoff == 0 or rms(direct(closer)) <= direct.explained:
            return direct, closer, status
        return difference, q, status

    def _slowly(self, difference: Difference, q: Floats) -> Floats:
        """Least squares of the position itself by way of ever slower high-passes: around local minima, or q itself
        where that does not settle."""
        try:
            for part in SLOWER:
                q = least(replace(difference, pole=part * difference.pole), q)
        except NotIdentifiableError:
            pass
        return q

    def by_squares(self, difference: Difference, q: Floats, status: int) -> Fit:
        """The result at the least squares q."""
        from pmfid.estimators.phases import phase_scatter

        error = difference(q)
        phases = difference.pole == 0 and rms(error) <= difference.explained

        def at(width: float) -> Floats:
            sensitivity = self.own_sensitivity(difference, q, width=width)
            inverse = inverted(sensitivity, self.names)
            spread = scatter(sensitivity * error[:, None], difference.recovery)
            if phases and width == STEP:
                spread = raised(spread, phase_scatter(difference, q, sensitivity, None))
            return np.asarray(inverse @ spread @ inverse)

        return self.result(difference, q, on_every_width(at(STEP), at), status)

    def own_sensitivity(
        self, difference: Difference, q: Floats, root: Floats | None = None, width: float = STEP
    ) -> Floats:
        """(n, p) by how much the difference moves with each parameter, beyond what the start can do as well."""
        jacobian, p = difference.jacobian(q, width), len(self.names)
        return without_nuisance(difference, jacobian[:, :p], jacobian[:, p:], root)

    def position(self, counts: NDArray[np.int64]) -> Floats:
        """Position of the counts (n,), unwrapped, less the jumps beyond max_speed."""
        y = self.encoder.position(counts)
        if self.encoder.max_speed is None:
            return y
        change = np.diff(y)
        jump = np.abs(change) > self.encoder.max_speed * self.dt + self.encoder.resolution
        return np.asarray(y[0] + np.r_[0.0, np.cumsum(np.where(jump, 0.0, change))])

    def _start(self, u: Floats, counts: NDArray[np.int64]) -> tuple[Floats, int]:
        """theta (p,) of `IV`, or what that starts from, if it does not settle; and the status bits of the record.

        Raises NotIdentifiableError where the counts alone show that nothing can be identified."""
        first = like(IV, self, initial=self.initial)
        try:
            columns, theta = first.settled(u, counts)
        except NotIdentifiableError:
            batch = like(BCLS, self, model=self.model.symmetric)
            check_identifiable(batch.columns(u, counts), batch.names)
            theta = first.start(u, counts)
            columns = first.columns_at(theta, u, counts)
        return theta, columns.status

    def _prepared(self, theta: Floats, u: Floats, y: Floats) -> tuple[Difference, Floats]:
        """The difference behind the high-pass, and q to start from: theta (p,), at the first count."""
        travel, dt = float(np.ptp(y)), self.dt
        force, mass = abs(self.equation.input_gain) * rms(u), abs(theta[self.equation.leading])
        drag = force * y.size * dt / travel
        inertia = max(mass, drag * dt)  # less of it shows within a sample only
        natural = np.array([inertia, drag, drag, force, force, force, force / travel])
        size = np.abs(theta)
        for index, least in zip(self.equation.roles, 0.01 * natural, strict=True):
            if index is not None:
                size[index] = max(size[index], least)
        scale, pole = np.r_[size, travel, travel * self.cutoff], self.drift_cutoff or self.cutoff
        difference = Difference(self.equation, dt, u, y, self.encoder.resolution, scale, pole)
        near = min(y.size - 1, math.ceil(1 / (self.cutoff * dt)))
        rise = y[near] - y[0]
        # from rest within stiction a small v0 changes nothing: only a motion that shows gives it a start
        v0 = rise / (near * dt) if abs(rise) > 1.5 * self.encoder.resolution else 0.0
        return difference, np.maximum(np.r_[theta, y[0], v0] / scale, difference.lower)

    def result(self, difference: Difference, q: Floats, q_cov: Floats, status: int) -> Fit:
        """The `Fit` at q with the scaled covariance (p, p). Raises NotIdentifiableError where it is no fit."""
        residual = difference(q)
        motion = difference.filtered(difference.y - np.mean(difference.y)) / difference.resolution
        relative = rms(residual) / rms(motion)
        if not (relative < WORST_FIT or rms(residual) <= difference.explained):
            raise NotIdentifiableError(
                f"the simulated position does not follow the record, {relative:.0%} of the motion is left: check the "
                "sign of input_gain, and for a load or friction that the model lacks; or use a recursive method"
            )
        scale = difference.scale[: len(self.names)]
        theta, cov = q[: scale.size] * scale, q_cov * np.outer(scale, scale)
        residual = residual * difference.resolution
        return Fit(self.names, self.units, theta, cov, residual.size, residual, relative, status)


def rms(signal: Floats) -> float:
    """Root mean square of a signal (n,)."""
    return float(np.sqrt(np.mean(signal**2)))


def least(difference: Difference, q: Floats) -> Floats:
    """Least squares from q (q,). Raises NotIdentifiableError where the iteration does not settle."""
    from scipy.optimize import least_squares  # slow to import, and only this needs it

    for tolerance in (TOLERANCE, ROUGH_TOLERANCE):
        try:
            with np.errstate(over="ignore", invalid="ignore"):  # a step too far is taken back
                found = least_squares(
                    difference,
                    q,
                    difference.jacobian,
                    bounds=(difference.lower, np.inf),
                    x_scale="jac",
                    ftol=tolerance,
                    xtol=tolerance,
                    gtol=tolerance,
                    max_nfev=MAX_EVALUATIONS,
                )
        except ValueError:  # sensitivities that are not finite
            raise NotIdentifiableError(
                "the simulated position leaves the range of numbers: it does not follow the record; use iv, or in "
                "Python give `initial`"
            ) from None
        q = np.maximum(found.x, difference.lower)
        if found.status > 0 or rms(difference(q)) <= difference.explained:
            return np.asarray(q)
    raise NotIdentifiableError(
        f"the iteration did not settle within {MAX_EVALUATIONS} simulations: the simulated position does not "
        "follow the record closely; use iv, or in Python give `initial`"
    )


def without_nuisance(difference: Difference, columns: Floats, nuisance: Floats, root: Floats | None = None) -> Floats:
    """Effects (n, k) [counts] less what the start position and velocity, nuisance (n, 2), can do as well.

    root: (n,) square roots of the samples' information, None: that of a white encoder error. The start velocity is
    taken for known to a few counts in a filter time constant: from rest it moves nothing, and must not be made up.
    """
    weight = np.full((columns.shape[0], 1), WHITE) if root is None else root[:, None]
    prior = np.array([[0.0, 1 / difference.start_velocity_std]])
    weighted, targets = np.r_[weight * nuisance, prior], np.r_[weight * columns, np.zeros((1, columns.shape[1]))]
    return np.asarray(columns - nuisance @ np.linalg.lstsq(weighted, targets)[0])


def inverted(sensitivity: Floats, names: tuple[str, ...]) -> Floats:
    """(S^T S)^-1 (p, p) of the sensitivities S (n, p). Raises NotIdentifiableError where one of them is zero or a
    combination of the others, naming the parameter."""
    parts, inverse = parts_of_their_own(sensitivity)
    worst = int(np.argmin(parts))
    if not parts[worst] > APART:
        raise NotIdentifiableError(
            f"the position depends on {names[worst]} hardly, or just as on the others: too little excitation; record "
            "reversals, and speeds and accelerations that vary"
        )
    size = np.linalg.norm(sensitivity, axis=0)
    return np.asarray(inverse @ inverse.T / np.outer(size, size))

"""Friction over velocity, without an assumed law."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import NotIdentifiableError, UsageError, whole_number
from pmfid.estimators.adequacy import filter_force
from pmfid.estimators.configuration import check_arrays, hold_last_input, like
from pmfid.estimators.iv import IV
from pmfid.estimators.least_squares import inverse_of
from pmfid.estimators.motion import mean_velocity
from pmfid.estimators.results import Columns
from pmfid.estimators.tuning import TUNING
from pmfid.estimators.uncertainty import lattice_scatter, scatter
from pmfid.kernel.configuration import ShapeTable
from pmfid.models.axes import LINEAR, Units
from pmfid.models.drive import EquationModel
from pmfid.models.equation import COULOMB_BACKWARD, COULOMB_FORWARD, VISCOUS_BACKWARD, VISCOUS_FORWARD, Equation, Term
from pmfid.models.shapes import Shape
from pmfid.presentation import Presentable, Summary, plain_dict, remarks_of
from pmfid.types import Counts, Floats

CURVE = "curve"
#: Speeds and friction of the nodes, first forward, then backward.
Sides = tuple[tuple[Floats, Floats], tuple[Floats, Floats]]


@dataclass(frozen=True)
class Remainder(Shape):
    """Part of a curve beyond Coulomb and viscous friction, at even speeds from 0 on, as the mean of both directions."""

    values: tuple[float, ...]
    step: float

    of_speed = True

    def table(self) -> ShapeTable:
        return ShapeTable("speed", self.values, step=self.step)

    @property
    def reads(self) -> str:
        return "(a curve)"


@dataclass(frozen=True)
class Basis:
    """Columns of a piecewise linear friction curve.

    `speeds` are those of the nodes from 0 on, forward and backward. `regressors` and `instruments` (n, 1 + k) belong to
    the mass and to the hat functions, `target` is (n,). `used` (N,) marks the used samples of the whole record.
    `settle` is the number of samples in which the filters settle.
    """

    speeds: tuple[Floats, Floats]
    regressors: Floats
    instruments: Floats
    target: Floats
    used: NDArray[np.bool_]
    settle: int


def make_basis(model: IV, theta: Floats, u: Floats, counts: Counts, nodes: int) -> Basis:
    columns, roles = model.columns_at(theta, u, counts), model.equation.roles
    simulated = mean_velocity(
        model.equation, theta, model.dt / TUNING.friction_curve_parts, np.repeat(u, TUNING.friction_curve_parts)
    )
    corrected = np.where(
        simulated == 0, 0.0, simulated + np.repeat(_slow(model, simulated, counts), TUNING.friction_curve_parts)
    )
    speeds, hats = [], []
    mass = model.equation.leading
    friction = np.delete(columns.zeta, mass, axis=1) @ np.delete(theta, mass)
    for side, role in ((1.0, COULOMB_FORWARD), (-1.0, COULOMB_BACKWARD)):
        own = _nodes(side * corrected, nodes, "forward" if side > 0 else "backward")
        whole = columns.zeta[:, roles[role]]
        # the kernel computes the share of a sample in one direction, exact to the instant of a reversal
        hats += _with_first(whole, [h[columns.used] for h in _hats(model, side, side * corrected, own)])
        known = _model_friction(model, theta, own, side)
        alone = _with_first(whole, [h[columns.used] for h in _hats(model, side, side * simulated, own)])
        friction = friction - np.column_stack(alone) @ known
        speeds.append(own)
    curve = np.column_stack(hats)
    regressors = np.column_stack([columns.phi[:, mass], curve])
    instruments = np.column_stack([columns.zeta[:, mass], curve])
    # for the model's own friction, the kernel's exact result replaces the result of the hat functions
    return Basis(
        (speeds[0], speeds[1]), regressors, instruments, columns.z - friction, columns.used, model.settle_samples
    )


def _with_first(whole: Floats, rising: list[Floats]) -> list[Floats]:
    return [whole - np.sum(rising, axis=0), *rising]


def _model_friction(model: IV, theta: Floats, speeds: Floats, side: float) -> Floats:
    """Return the model's friction (k,) at speeds (k,) of one direction."""
    values = model.equation.role_values(theta)
    forward = side > 0
    body = (
        values[COULOMB_FORWARD if forward else COULOMB_BACKWARD]
        + speeds * (values[VISCOUS_FORWARD if forward else VISCOUS_BACKWARD])
    )
    sizes = dict(zip(model.equation.names, theta, strict=False))
    return np.asarray(
        body + sum(sizes[str(t.name)] * t.shape.evaluate(speeds) for t in model.equation.shaped if t.shape)
    )


def _slow(model: IV, simulated: Floats, counts: Counts) -> Floats:
    """Return the slow deviation (n,) of the counts from the simulated velocity (n parts,)."""
    from scipy.signal import filtfilt  # slow to import, and used here only

    moved = np.diff(counts) * model.encoder.resolution / model.dt
    late = np.r_[moved - simulated.reshape(-1, TUNING.friction_curve_parts).mean(axis=1)[:-1], 0.0]
    part = 1 - np.exp(-TUNING.friction_curve_slow * model.cutoff * model.dt)
    return np.asarray(filtfilt([part], [1.0, part - 1.0], late))


def _nodes(speed: Floats, nodes: int, direction: str) -> Floats:
    """Return the speed 0 and distinct quantiles of the positive speeds."""
    moving = speed[speed > 0]
    if moving.size < TUNING.least_part * speed.size + 10 * nodes:
        raise NotIdentifiableError(f"the axis moves too little {direction}: record a motion in both directions")
    found = np.asarray(
        np.quantile(moving, np.r_[TUNING.friction_curve_slowest, np.arange(1, nodes - 1) / (nodes - 1), 1.0])
    )
    kept = [0.0]
    for value in found[:-1].tolist():
        if (
            value - kept[-1] > TUNING.friction_curve_closest * found[-1]
            and found[-1] - value > TUNING.friction_curve_apart * found[-1]
        ):
            kept.append(value)
    return np.array([*kept, found[-1]])


def _hats(model: IV, side: float, speed: Floats, nodes: Floats) -> Iterator[Floats]:
    """Yield the filtered hat function (n,) of each node but the first, at speeds (n parts,), with the sign of the
    direction.
    """
    for j in range(1, nodes.size):
        unit = np.zeros(nodes.size)
        unit[j] = 1.0
        yield filter_force(
            side * np.where(speed > 0, np.interp(speed, nodes, unit), 0.0),
            model,
            speed.size // TUNING.friction_curve_parts,
        )


def bend_of(speeds: tuple[Floats, Floats]) -> Floats:
    """Return a matrix (rows, 1 + k) whose product with the parameters has the square: integral of the second
    derivative squared.
    """
    k = sum(own.size for own in speeds)
    rows, first = [], 1
    for own in speeds:
        h = np.diff(own) / own[-1]
        for j in range(1, own.size - 1):
            row = np.zeros(1 + k)
            width = (h[j - 1] + h[j]) / 2
            row[first + j - 1 : first + j + 2] = (
                np.array([1 / h[j - 1], -1 / h[j - 1] - 1 / h[j], 1 / h[j]]) / width**0.5
            )
            rows.append(row)
        first += own.size
    return np.array(rows)


def with_curve(estimator: IV, mass: float, sides: Sides) -> tuple[IV, Floats]:
    """Return the method with a curve in its simulated motion, and its parameters.

    `sides` are speeds and friction, forward and backward.
    """
    lines = [np.asarray(np.polyfit(speed, force, 1)) for speed, force in sides]
    even = np.linspace(0.0, max(speed[-1] for speed, _ in sides), TUNING.friction_curve_knots)
    remainders = [
        np.interp(even, *side) - np.polyval(line, np.minimum(even, side[0][-1]))
        for side, line in zip(sides, lines, strict=True)
    ]
    remainder = Remainder(tuple(np.mean(remainders, axis=0).tolist()), float(even[1]))
    terms = (
        Term("output", 2, "mass", "kg"),
        Term("forward_output", 1, "viscous_friction_forward", "N s/m"),
        Term("backward_output", 1, "viscous_friction_backward", "N s/m"),
        Term("forward", 0, "coulomb_friction_forward", "N"),
        Term("backward", 0, "coulomb_friction_backward", "N"),
        Term("friction", 0, CURVE, "", shape=remainder),
    )
    equation = Equation(terms, estimator.equation.known, dead_time=estimator.equation.dead_time)
    (slope, level), (slope_back, level_back) = (np.maximum(line, 0.0).tolist() for line in lines)
    theta = np.array([mass, slope, slope_back, level, level_back, 1.0])
    return like(IV, estimator, model=EquationModel(equation), prefilter_zeros=None), theta


#: Weights of the bend that are tried, relative to the information of the samples.
WEIGHTS = 10.0 ** np.arange(-8.0, 4.1, 0.5)


@dataclass(frozen=True, eq=False, repr=False)
class FrictionCurve(Presentable):
    """Friction over velocity, with error bars.

    `velocity` (k,) [m/s] are the nodes in rising order, the backward ones first. `force` and `std` (k,) [N] are the
    friction and its standard errors, `mass` and `mass_std` [kg] the mass and its standard error. `weight` is the chosen
    weight of the bend. `error` (n,) [N] is the residual of the n used samples, which are the last of the record.
    `notes` are for people. `motion` holds the units, which for a rotary axis are rad/s, N m and kg m2.
    """

    velocity: Floats
    force: Floats
    std: Floats
    mass: float
    mass_std: float
    weight: float
    error: Floats
    notes: tuple[str, ...] = ()
    motion: Units = LINEAR

    @property
    def visited(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Ranges of the velocity [m/s] that the record covers, backward and forward.

        Between the two ranges, at speeds below the first nodes, the record cannot separate the curve from the jump at
        zero.
        """
        back, ahead = self.velocity[self.velocity < 0], self.velocity[self.velocity > 0]
        return (float(back[0]), float(back[-1])), (float(ahead[0]), float(ahead[-1]))

    def evaluate(self, velocity: ArrayLike) -> Floats:
        """Return the friction (n,) [N] at velocities (n,) [m/s]; NaN for velocities that the record does not cover."""
        return self._interpolate(velocity, self.force)

    def std_at(self, velocity: ArrayLike) -> Floats:
        """Return the standard error of the curve (n,) [N]; NaN outside the range of `evaluate`."""
        return self._interpolate(velocity, self.std)

    def _interpolate(self, velocity: ArrayLike, values: Floats) -> Floats:
        v = np.asarray(velocity, np.float64)
        inside = np.any([(low <= v) & (v <= high) for low, high in self.visited], axis=0)
        return np.where(inside, np.interp(v, self.velocity, values), np.nan)

    def summary(self) -> Summary:
        own = self.motion
        mass = f"{own.inertia} = {self.mass:.6g} ± {self.mass_std:.2g} {own.of_inertia}"
        header = (f"velocity [{own.speed}]", f"friction [{own.force}]", f"std [{own.force}]")
        found = zip(self.velocity, self.force, self.std, strict=True)
        rows = [(f"{velocity:.4g}", f"{force:.5g}", f"{std:.2g}") for velocity, force, std in found]
        ends = [rows[i] for i in np.flatnonzero(np.isin(self.velocity, self.visited)).tolist()]
        lines = [f"{force} ± {std} {own.force} at {velocity} {own.speed}" for velocity, force, std in ends]
        title = f"friction at {self.velocity.size} speeds; {mass}"
        return Summary(title, header, rows, lines, remarks_of((), self.notes))

    def columns(self) -> dict[str, object]:
        """Return the columns of a table with one row for each node."""
        return {"velocity": self.velocity, "force": self.force, "std": self.std}

    def to_dict(self) -> dict[str, object]:
        rows = zip(self.velocity.tolist(), self.force.tolist(), self.std.tolist(), strict=True)
        return plain_dict(
            {
                "samples": int(self.error.size),
                self.motion.inertia: {"value": self.mass, "std": self.mass_std, "unit": self.motion.of_inertia},
                "curve": [{"velocity": velocity, "force": force, "std": std} for velocity, force, std in rows],
                "visited": [list(part) for part in self.visited],
                "notes": list(self.notes),
            }
        )


def friction_curve(
    estimator: IV,
    u: ArrayLike,
    counts: ArrayLike,
    nodes: int = TUNING.friction_curve_nodes,
    rising_from: float | None = None,
) -> FrictionCurve:
    """Estimate the friction curve from u, counts: (n,).

    `estimator` has a `Drive` with directional friction, and `nodes` is the number of nodes in each direction. From the
    speed `rising_from` on [m/s], the friction does not fall with the speed; 0 means at no speed, and None sets no such
    condition.

    The error bars contain noise and smoothing. The bar of the mass also contains what further iterations would change.
    The bars do not contain the error of straight lines at a sharp bend, which more nodes reveal.
    A constant load is half the difference between both directions.

    Raises UsageError for wrong arguments, and NotIdentifiableError if the record does not separate the friction from
    other effects.
    """
    nodes = whole_number("nodes", nodes, 3, "it is the number of speeds in each direction")
    if rising_from is not None and not 0 <= rising_from < np.inf:
        raise UsageError(f"rising_from must be a speed in m/s from 0 on, or None, got {rising_from!r}")
    u, counts = check_arrays(u, counts)
    u = hold_last_input(u)
    model, theta = estimator, estimator.settle_iteration(u, counts)[1]
    basis = make_basis(model, theta, u, counts, nodes)
    fastest = max(float(own[-1]) for own in basis.speeds)
    if rising_from is not None and rising_from >= fastest:
        raise UsageError(
            f"rising_from is {rising_from:g} m/s, but the fastest motion of the record has {fastest:.3g} "
            "m/s, so the limit would have no effect; give a lower speed, or leave rising_from out"
        )
    solved = _solve_curve(basis, rising_from)
    change = 0.0
    for _ in range(TUNING.friction_curve_turns - 1):
        before = solved
        model, theta = with_curve(estimator, float(solved.theta[0]), solved.sides)
        solved = _solve_curve(make_basis(model, theta, u, counts, nodes), rising_from)
        change = abs(solved.theta[0] - before.theta[0])

    def read(counts: Counts) -> Columns:
        columns, mass = model.columns_at(theta, u, counts), model.equation.leading
        phi = columns.zeta.copy()
        phi[:, mass] = columns.phi[:, mass]
        return replace(columns, phi=phi, zeta=solved.everywhere[columns.used])

    along = lattice_scatter(model, theta, u, counts, read, solved.gain)
    std = np.sqrt(np.maximum(solved.noise, along) + solved.bias**2)
    std[0] = np.hypot(std[0], TUNING.friction_curve_left * change)
    return _make_curve(solved, std)


@dataclass(frozen=True)
class _Solved:
    """Solution of the smoothed least squares problem.

    `theta` (1 + k,) are the mass and the friction at the nodes. The other arrays belong to a curve with
    friction_curve_less smoothing. `gain` (1 + k, 1 + k) is its gain, and `noise` (1 + k,) are its variances by the
    scatter of the scores. `bias` (1 + k,) is the difference of `theta` from that curve. `everywhere` (N, 1 + k) are the
    instruments of the whole record, and `error` (n,) is the residual.
    """

    speeds: tuple[Floats, Floats]
    theta: Floats
    gain: Floats
    noise: Floats
    bias: Floats
    weight: float
    everywhere: Floats
    error: Floats

    @property
    def sides(self) -> Sides:
        """Speeds and friction, forward and backward."""
        forward, backward = np.split(self.theta[1:], [self.speeds[0].size])
        return (self.speeds[0], forward), (self.speeds[1], backward)


def _solve_curve(basis: Basis, rising_from: float | None) -> _Solved:
    Q = np.linalg.qr(basis.instruments)[0]
    mass = Q @ (Q.T @ basis.regressors[:, 0])  # least squares in two stages gives the estimate with instruments
    A = np.column_stack([mass, basis.instruments[:, 1:]])
    bend, information, right = bend_of(basis.speeds), A.T @ A, A.T @ basis.target
    bend = bend * np.sqrt(np.trace(information[1:, 1:]) / np.sum(bend**2))
    weight = _weight(A, basis, bend)
    penalty = weight * bend.T @ bend
    theta = inverse_of(information + penalty) @ right
    if rising_from is not None:
        theta = _rising(information + penalty, right, basis.speeds, rising_from)
    rest = basis.target - basis.regressors @ theta
    gain = inverse_of(information + TUNING.friction_curve_less * penalty)
    noise = np.diagonal(scatter((A * rest[:, None]) @ gain.T, TUNING.instruments_lasting * basis.settle))
    everywhere = np.zeros((basis.used.size, theta.size))
    everywhere[basis.used] = A
    return _Solved(basis.speeds, theta, gain, noise, theta - gain @ right, weight, everywhere, rest)


def _make_curve(solved: _Solved, std: Floats) -> FrictionCurve:
    """Return the curve without the nodes at rest.

    The record has no sample at rest, and Stribeck friction may exist below the first node above 0.
    """
    (ahead, forward), (back, backward) = solved.sides
    bars_ahead, bars_back = np.split(std[1:], [ahead.size])
    velocity, force = np.r_[-back[:0:-1], ahead[1:]], np.r_[-backward[:0:-1], forward[1:]]
    bars = np.r_[bars_back[:0:-1], bars_ahead[1:]]
    return FrictionCurve(velocity, force, bars, float(solved.theta[0]), float(std[0]), solved.weight, solved.error)


def _weight(A: Floats, basis: Basis, bend: Floats) -> float:
    """Return the largest weight whose prediction error is within one standard error of the best.

    The other blocks of the record predict each block (Hastie, Tibshirani and Friedman 2009, section 7.10).
    """
    n = basis.target.size
    block = np.arange(n) * TUNING.friction_curve_blocks // n
    sums = [
        _sums(A[block == k], basis.regressors[block == k], basis.target[block == k])
        for k in range(TUNING.friction_curve_blocks)
    ]
    square, cross = (np.sum([part[i] for part in sums], axis=0) for i in (0, 1))
    errors = np.empty((WEIGHTS.size, TUNING.friction_curve_blocks))
    for row, weight in enumerate(WEIGHTS):
        for fold in range(TUNING.friction_curve_folds):
            own = range(fold, TUNING.friction_curve_blocks, TUNING.friction_curve_folds)
            rest = square - sum(sums[k][0] for k in own) + weight * bend.T @ bend
            right = cross - sum(sums[k][1] for k in own)
            theta = np.linalg.lstsq(rest, right, rcond=None)[0]  # without these blocks, a node may have no sample
            for k in own:
                errors[row, k] = theta @ sums[k][2] @ theta - 2 * theta @ sums[k][3]
    apart = errors - errors[np.argmin(errors.sum(axis=1))]
    allowed = apart.std(axis=1) * np.sqrt(TUNING.friction_curve_blocks)
    return float(WEIGHTS[np.flatnonzero(apart.sum(axis=1) <= allowed)[-1]])


def _sums(A: Floats, regressors: Floats, target: Floats) -> tuple[Floats, ...]:
    return A.T @ A, A.T @ target, regressors.T @ regressors, regressors.T @ target


def _rising(square: Floats, right: Floats, speeds: tuple[Floats, Floats], rising_from: float) -> Floats:
    """Return the best parameters whose friction does not fall with the speed from `rising_from` on."""
    from scipy.optimize import lsq_linear  # slow to import, and used here only

    k, low, first = square.shape[0], np.full(square.shape[0], -np.inf), 1
    steps = np.eye(k)
    for own in speeds:
        own_steps = np.tril(np.ones((own.size, own.size)))
        steps[first : first + own.size, first : first + own.size] = own_steps
        low[first + 1 : first + own.size][own[:-1] >= rising_from] = 0.0
        first += own.size
    root = np.linalg.cholesky(square).T
    found = lsq_linear(root @ steps, np.linalg.solve(root.T, right), (low, np.full(k, np.inf)))
    return np.asarray(steps @ found.x)

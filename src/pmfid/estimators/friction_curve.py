"""A free friction curve: piecewise linear over the velocity, each direction for itself, with a jump at zero.

    m x'' + sum_j c_j h_j(x') = gain u,    h_j: a hat of a node of the speed, forward or backward

No law of friction is assumed. The nodes are quantiles of the speed, so that each has its share of the samples; what the
curve bends is penalised, the integral of its second derivative squared, with the weight that predicts blocks best which
were left out (Eilers and Marx 1996; Hastie, Tibshirani and Friedman 2009, section 7.10). The hats are of the simulated
motion, into which the curve goes back, with what slowly departs from the measured velocity; the mass has the simulated
acceleration as its instrument, so that the noise of the counts is in neither.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from pmfid.errors import UsageError, whole_number
from pmfid.estimators.arguments import check_arrays, hold_last_input
from pmfid.estimators.friction_basis import Basis, Sides, bend_of, make_basis, with_curve
from pmfid.estimators.instruments import LASTING
from pmfid.estimators.iv import IV
from pmfid.estimators.lattice import lattice_scatter
from pmfid.estimators.least_squares import inverse_of
from pmfid.estimators.results import Columns
from pmfid.estimators.scatter import scatter
from pmfid.models.axes import LINEAR, Units
from pmfid.presentation import Presentable, Summary, plain_dict, remarks_of
from pmfid.types import Counts, Floats

#: Nodes of each direction in addition to the one at rest.
NODES = 10
#: Turns in which the curve goes back into the simulation.
TURNS = 3
#: Weights of the bend that are tried, over the information of the samples.
WEIGHTS = 10.0 ** np.arange(-8.0, 4.1, 0.5)
#: Blocks of the record, and the turns in which they are left out.
BLOCKS, FOLDS = 32, 8
#: Part of the smoothing in the curve of the error bars: the whole smoothing may hide what the record can hardly show.
LESS = 0.01


@dataclass(frozen=True, eq=False, repr=False)
class FrictionCurve(Presentable):
    """velocity (k,) [m/s]: the nodes, rising, those backward first; force, std (k,) [N]; mass, mass_std [kg]; weight:
    of the bend, that was chosen; error (n,) [N] that is left of the n samples in use, the last of the record; notes:
    for people; motion: the units, of a rotary axis rad/s, N m and kg m2."""

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
        """Velocities [m/s] that the record covers, backward and forward; between the two, slower than the
        first nodes, it does not tell the curve from the jump at zero."""
        back, ahead = self.velocity[self.velocity < 0], self.velocity[self.velocity > 0]
        return (float(back[0]), float(back[-1])), (float(ahead[0]), float(ahead[-1]))

    def at(self, velocity: ArrayLike) -> Floats:
        """Friction (n,) [N] at velocities (n,) [m/s]; NaN where the record has none of them."""
        return self._interpolate(velocity, self.force)

    def std_at(self, velocity: ArrayLike) -> Floats:
        """Its standard deviation (n,) [N], NaN where `at` is."""
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
        """A row for each node."""
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
    estimator: IV, u: ArrayLike, counts: ArrayLike, nodes: int = NODES, rising_from: float | None = None
) -> FrictionCurve:
    """From u, counts: (n,). estimator: of a `Drive` with directional friction; nodes: of each direction; rising_from:
    friction does not fall with the speed from there on [m/s], 0: nowhere; None: it may. Error bars are for noise and
    smoothing; what straight lines between the nodes leave out of a sharp bend more nodes show. A constant load is half
    of what both directions differ by.

    Raises UsageError for wrong arguments and NotIdentifiableError where the record does not show friction apart.
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
            f"rising_from is {rising_from:g} m/s, but the record has no speed beyond {fastest:.3g} m/s: friction would "
            "nowhere be asked to rise; give a lower speed, or leave it out"
        )
    solved = _solve_curve(basis, rising_from)
    for _ in range(TURNS - 1):
        model, theta = with_curve(estimator, float(solved.theta[0]), solved.sides)
        solved = _solve_curve(make_basis(model, theta, u, counts, nodes), rising_from)

    def read(counts: Counts) -> Columns:
        columns, mass = model.columns_at(theta, u, counts), model.equation.leading
        phi = columns.zeta.copy()
        phi[:, mass] = columns.phi[:, mass]
        return replace(columns, phi=phi, zeta=solved.everywhere[columns.used])

    along = lattice_scatter(model, theta, u, counts, read, solved.gain)
    return _make_curve(solved, np.sqrt(np.maximum(solved.noise, along) + solved.bias**2))


@dataclass(frozen=True)
class _Solved:
    """theta (1 + k,): mass and friction at the nodes; of a curve with LESS smoothing gain (1 + k, 1 + k), noise
    (1 + k,): variances by the scatter of the scores, and bias (1 + k,): how far it is from that; everywhere (N, 1 + k):
    instruments of the whole record; error (n,): what is left."""

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
    mass = Q @ (Q.T @ basis.regressors[:, 0])  # two stages of least squares are the instruments' estimate
    A = np.column_stack([mass, basis.instruments[:, 1:]])
    bend, information, right = bend_of(basis.speeds), A.T @ A, A.T @ basis.target
    bend = bend * np.sqrt(np.trace(information[1:, 1:]) / np.sum(bend**2))
    weight = _weight(A, basis, bend)
    penalty = weight * bend.T @ bend
    theta = inverse_of(information + penalty) @ right
    if rising_from is not None:
        theta = _rising(information + penalty, right, basis.speeds, rising_from)
    rest = basis.target - basis.regressors @ theta
    gain = inverse_of(information + LESS * penalty)
    noise = np.diagonal(scatter((A * rest[:, None]) @ gain.T, LASTING * basis.settle))
    everywhere = np.zeros((basis.used.size, theta.size))
    everywhere[basis.used] = A
    return _Solved(basis.speeds, theta, gain, noise, theta - gain @ right, weight, everywhere, rest)


def _make_curve(solved: _Solved, std: Floats) -> FrictionCurve:
    """Without the nodes at rest: no sample is there, and Stribeck friction may hide below the first of the others."""
    (ahead, forward), (back, backward) = solved.sides
    bars_ahead, bars_back = np.split(std[1:], [ahead.size])
    velocity, force = np.r_[-back[:0:-1], ahead[1:]], np.r_[-backward[:0:-1], forward[1:]]
    bars = np.r_[bars_back[:0:-1], bars_ahead[1:]]
    return FrictionCurve(velocity, force, bars, float(solved.theta[0]), float(std[0]), solved.weight, solved.error)


def _weight(A: Floats, basis: Basis, bend: Floats) -> float:
    """The largest of those tried with which blocks are predicted, by the others, as well as with the best one, within a
    standard error of the difference (Hastie, Tibshirani and Friedman 2009, section 7.10)."""
    n = basis.target.size
    block = np.arange(n) * BLOCKS // n
    sums = [_sums(A[block == k], basis.regressors[block == k], basis.target[block == k]) for k in range(BLOCKS)]
    square, cross = (np.sum([part[i] for part in sums], axis=0) for i in (0, 1))
    errors = np.empty((WEIGHTS.size, BLOCKS))
    for row, weight in enumerate(WEIGHTS):
        for fold in range(FOLDS):
            own = range(fold, BLOCKS, FOLDS)
            rest = square - sum(sums[k][0] for k in own) + weight * bend.T @ bend
            right = cross - sum(sums[k][1] for k in own)
            theta = np.linalg.lstsq(rest, right, rcond=None)[0]  # without these blocks a node may have no sample
            for k in own:
                errors[row, k] = theta @ sums[k][2] @ theta - 2 * theta @ sums[k][3]
    apart = errors - errors[np.argmin(errors.sum(axis=1))]
    allowed = apart.std(axis=1) * np.sqrt(BLOCKS)
    return float(WEIGHTS[np.flatnonzero(apart.sum(axis=1) <= allowed)[-1]])


def _sums(A: Floats, regressors: Floats, target: Floats) -> tuple[Floats, ...]:
    return A.T @ A, A.T @ target, regressors.T @ regressors, regressors.T @ target


def _rising(square: Floats, right: Floats, speeds: tuple[Floats, Floats], rising_from: float) -> Floats:
    """The best parameters whose friction does not fall with the speed from `rising_from` on."""
    from scipy.optimize import lsq_linear  # slow to import, and only this needs it

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

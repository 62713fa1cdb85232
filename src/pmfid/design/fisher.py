"""Fisher information of an input, and the criteria that rate it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm

from pmfid.design.problem import Problem
from pmfid.errors import NotIdentifiableError, UsageError, did_you_mean
from pmfid.models.drive import Drive
from pmfid.types import Floats

__all__ = ["Regime", "StateStep", "discretise", "drive_regime"]

#: Indices of the state of a drive.
POSITION, VELOCITY = 0, 1


@dataclass(frozen=True, eq=False)
class Regime:
    """The plant between two events, x' = A x + b u + g, and its derivatives by p parameters.

    `A` is (n, n), and `b` and `g` are (n,). The derivatives by the parameters are `A_slope` (p, n, n), `b_slope` (p, n)
    and `g_slope` (p, n). The matrix `entry` (n, n) multiplies the sensitivities of the state where the regime begins.
    The matrix `entry` is the identity except for a rest, in which friction removes every deviation of the velocity.
    """

    A: Floats
    b: Floats
    g: Floats
    A_slope: Floats
    b_slope: Floats
    g_slope: Floats
    entry: Floats


@dataclass(frozen=True, eq=False)
class StateStep:
    """The step X+ = A X + b u + g of X = (x, dx/dp_1, ..., dx/dp_p), the state and its sensitivities.

    `A` is (n(p+1), n(p+1)), and `b` and `g` are (n(p+1),). The step is exact for an input that is held.
    """

    A: Floats
    b: Floats
    g: Floats


def drive_regime(drive: Drive, nominal: Mapping[str, float], names: tuple[str, ...], direction: int) -> Regime:
    """Return the regime m v' = input_gain u - d v - direction F_c - offset, or rest for the direction 0.

    The state is (position, velocity). `names` has the p parameters for which derivatives are wanted.
    """
    if direction == 0:
        return _rest(len(names))
    side = {1: "_forward", -1: "_backward"}[direction]
    viscous, coulomb = (name if name in nominal else name + side for name in ("viscous_friction", "coulomb_friction"))
    mass = nominal["mass"]
    # The force on the mass has one entry for each of position, velocity, input and 1.
    force = np.array([0.0, -nominal[viscous], drive.equation.input_gain, -direction * nominal[coulomb]])
    force[3] -= nominal.get("offset", 0.0)
    slopes = {
        "mass": -force / mass**2,
        viscous: np.array([0.0, -1.0, 0.0, 0.0]) / mass,
        coulomb: np.array([0.0, 0.0, 0.0, -direction]) / mass,
        "offset": np.array([0.0, 0.0, 0.0, -1.0]) / mass,
    }
    slope = np.zeros((len(names), 2, 4))
    for i, name in enumerate(names):
        slope[i, VELOCITY] = slopes.get(name, 0.0)
    field = np.array([[0.0, 1.0, 0.0, 0.0], force / mass])
    split = (field[:, :2], field[:, 2], field[:, 3])
    return Regime(*split, slope[:, :, :2], slope[:, :, 2], slope[:, :, 3], np.eye(2))


def _rest(size: int) -> Regime:
    none, many = np.zeros(2), np.zeros((size, 2))
    hold = np.diag([1.0, 0.0])
    return Regime(np.zeros((2, 2)), none, none, np.zeros((size, 2, 2)), many, many, hold)


def discretise(regime: Regime, dt: float) -> StateStep:
    """Return the step over dt [s] of the state and its sensitivities, by one matrix exponential (Van Loan 1978)."""
    p, n = regime.b_slope.shape
    size = n * (p + 1)
    M = np.zeros((size + 2, size + 2))
    for i in range(p + 1):
        rows = slice(n * i, n * (i + 1))
        M[rows, rows] = regime.A
        M[rows, size] = regime.b_slope[i - 1] if i else regime.b
        M[rows, size + 1] = regime.g_slope[i - 1] if i else regime.g
        if i:
            M[rows, :n] = regime.A_slope[i - 1]
    E = expm(M * dt)
    return StateStep(E[:size, :size], E[:size, size], E[:size, size + 1])


@dataclass(frozen=True, eq=False)
class Affine:
    """Sensitivities that are affine in the input u (K,) of a problem with p parameters, N samples and K intervals.

    `matrix` (p N, K) and `offset` (p N,) give the sensitivities to the scaled parameters, in units of the noise's
    deviation, parameter by parameter. `prior` (p, p) is the prior information on the scaled parameters. `scale` (p,)
    has the values that scale the parameters.
    """

    matrix: Floats
    offset: Floats
    prior: Floats
    scale: Floats

    def weigh_sensitivities(self, u: ArrayLike) -> Floats:
        """Return the sensitivities (p, N) over the deviation of the noise."""
        return np.asarray(self.matrix @ np.asarray(u) + self.offset).reshape(len(self.scale), -1)

    def information(self, u: ArrayLike) -> Floats:
        """Return the information (p, p) on the scaled parameters, with the prior."""
        s = self.weigh_sensitivities(u)
        return np.asarray(s @ s.T + self.prior)


def propagate(start: Floats, steps: Sequence[tuple[Regime, StateStep]], parts: int = 1) -> Floats:
    """Return states and sensitivities (K parts + 1, n(p+1), K+1) at the samples, from their values `start` (n(p+1),).

    The last axis has the coefficients of the K inputs, and then the constant part. Each step holds for a part of an
    interval.
    """
    K, n = len(steps), len(steps[0][0].b)
    X = np.zeros((start.size, K + 1))
    X[:, K] = start
    found = [X]
    for k, (regime, step) in enumerate(steps):
        X = X.copy()
        X[n:] = (regime.entry @ X[n:].reshape(-1, n, K + 1)).reshape(-1, K + 1)
        for _ in range(parts):
            X = step.A @ X
            X[:, k] += step.b
            X[:, K] += step.g
            found.append(X)
    return np.array(found)


def affine(problem: Problem, parameters: Mapping[str, float] | None = None) -> Affine:
    """Return the affine maps of a problem.

    `parameters` maps names to the values of another case. Each other case has the scale of the nominal case.
    """
    parts, p, K = problem.samples_per_interval, len(problem.names), problem.intervals
    steps = _steps(problem, {**problem.nominal, **(parameters or {})}, problem.names, parts)
    nodes = propagate(np.append(problem.start, np.zeros(2 * p)), steps, parts)
    weight = problem.scale / np.sqrt(problem.variance)
    # the position and its derivatives stand at every second place
    S = (nodes[1:, 2::2].swapaxes(0, 1) * weight[:, None, None]).reshape(-1, K + 1)
    prior = np.zeros((p, p)) if problem.prior is None else np.asarray(problem.prior)
    return Affine(
        np.ascontiguousarray(S[:, :K]), S[:, K].copy(), prior * np.outer(problem.scale, problem.scale), problem.scale
    )


def _steps(
    problem: Problem, parameters: Mapping[str, float], names: tuple[str, ...], parts: int
) -> list[tuple[Regime, StateStep]]:
    """Return the regime of each interval, and its step over a part of the interval."""
    regimes = {d: drive_regime(problem.drive, parameters, names, d) for d in set(problem.sense)}
    known = {d: (regime, discretise(regime, problem.dt / parts)) for d, regime in regimes.items()}
    return [known[d] for d in problem.sense]


def node_states(problem: Problem, parameters: Mapping[str, float] | None = None) -> tuple[Floats, Floats]:
    """Return the matrix (2, K+1, K) and offset (2, K+1) of position [m] and velocity [m/s] at the nodes.

    Position and velocity are matrix u + offset. `parameters` maps names to values other than the nominal ones.
    """
    steps = _steps(problem, {**problem.nominal, **(parameters or {})}, (), 1)
    states = propagate(np.array(problem.start, float), steps).swapaxes(0, 1)
    return states[..., :-1], states[..., -1]


def motion(problem: Problem, u: ArrayLike, parameters: Mapping[str, float] | None = None) -> tuple[Floats, Floats]:
    """Return position [m] and velocity [m/s] at the nodes, each (intervals + 1,), for the directions of the problem.

    `parameters` maps names to values other than the nominal ones. Raises UsageError if u has another length.
    """
    matrix, offset = node_states(problem, parameters)
    x, v = matrix @ _check_input(problem, u) + offset
    return x, v


def information(problem: Problem, u: ArrayLike) -> Floats:
    """Return the Fisher information on unknown and nuisance parameters.

    Parameters
    ----------
    problem
        Equation, parameters, time grid and noise.
    u
        (K,) input [V], one value per interval.

    Returns
    -------
    ndarray
        (p, p) information on the parameters in their own units, with the prior.

    Raises
    ------
    UsageError
        If the input has another shape or is not finite.

    References
    ----------
    Paper eq. 4.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import Drive
    >>> from pmfid.design import Limits, Problem, information
    >>> nominal = {"mass": 1.5, "viscous_friction": 6.0, "coulomb_friction": 0.6}
    >>> problem = Problem(Drive(2.0), nominal, ("mass",), 2.0, 10, Limits(input=3.0), resolution=1e-5)
    >>> slow, fast = (information(problem, np.full(10, u))[0, 0] for u in (1.0, 2.0))
    >>> bool(fast > slow)
    True
    """
    maps = affine(problem)
    return maps.information(_check_input(problem, u)) / np.outer(maps.scale, maps.scale)


def _check_input(problem: Problem, u: ArrayLike) -> Floats:
    values = np.asarray(u, float)
    if values.shape != (problem.intervals,) or not np.isfinite(values).all():
        raise UsageError(f"u must hold {problem.intervals} finite values, one per interval, got shape {values.shape}")
    return values


def check_identifiable(problem: Problem, maps: Affine) -> None:
    """Raise NotIdentifiableError with the parameters that no input, or no single run, can determine or separate."""
    p = len(problem.names)
    every = np.hstack([maps.matrix, maps.offset[:, None]]).reshape(p, -1)
    gram = every @ every.T + maps.prior
    size = np.sqrt(gram.diagonal())
    dead = [name for name, s in zip(problem.names, size, strict=True) if s <= 1e-12 * max(size.max(), 1e-300)]
    if dead:
        raise NotIdentifiableError(f"the position does not depend on {', '.join(dead)} in this motion; {_REMEDY}")
    values, vectors = np.linalg.eigh(gram / np.outer(size, size))
    if values[0] < 1e-10:
        alike = [name for name, part in zip(problem.names, vectors[:, 0], strict=True) if abs(part) > 1e-3]
        raise NotIdentifiableError(f"no input distinguishes {' from '.join(alike)} in this motion; {_REMEDY}")
    rank = _rank_of_a_run(maps)
    if rank < p:
        raise NotIdentifiableError(
            f"one run of this motion, with {maps.matrix.shape[0] // p} samples, determines only {rank} of {p} "
            f"parameters ({', '.join(problem.names)}); give more intervals or samples_per_interval, remove {p - rank} "
            'of these parameters from the list "unknown", or give prior information'
        )


def _rank_of_a_run(maps: Affine) -> int:
    """Return the number of parameter combinations that one run determines together with the prior.

    Several inputs may determine more combinations.
    """
    run = maps.weigh_sensitivities(np.random.default_rng(0).standard_normal(maps.matrix.shape[1]))
    both = np.hstack([run / max(float(np.abs(run).max()), 1e-300), maps.prior / max(np.abs(maps.prior).max(), 1e-300)])
    size = np.linalg.norm(both, axis=1)
    return int(np.linalg.matrix_rank(both / np.where(size > 0, size, 1.0)[:, None], tol=1e-10))


_REMEDY = (
    'remove one of these parameters from the list "unknown", give prior information, or allow motion in both directions'
)

#: Each criterion is a function of S, the information on p parameters of interest without the nuisance parameters.
CRITERIA = {
    "trace": "trace S, the criterion of the paper; also T",
    "D": "det(S)^(1/p): volume of the confidence ellipsoid",
    "A": "p / trace(inverse of S): mean variance of the parameters",
    "E": "least eigenvalue of S: the combination with the largest variance",
    "ME": "least over largest eigenvalue of S: roundness, not size",
    "c": "1 / (c' inverse(S) c): variance of one combination of the parameters",
}


@dataclass(frozen=True, eq=False)
class Criterion:
    """A criterion for the first `size` parameters of F. All further parameters are nuisance parameters.

    `combination` (size,) has the weights of the scaled parameters for the criterion "c".
    """

    name: str
    size: int
    combination: Floats | None = None

    def log_value(self, F: Floats) -> Floats:
        """Return the logarithm of the value (...) for F (..., p, p), or -inf if F is singular."""
        with np.errstate(divide="ignore", invalid="ignore"):
            value = np.log(_value(self.name, _schur(F, self.size), self.combination))
        return np.where(np.isnan(value), -np.inf, value)

    def value(self, F: Floats) -> float:
        return float(np.exp(self.log_value(F)))

    def gradient(self, F: Floats) -> Floats:
        """Return the gradient (p, p) of the log value by F, a symmetric matrix.

        If F is singular, the gradient belongs to a nearby regular matrix.
        """
        S, G = eliminate(F, self.size)
        try:
            slope = _slope(self.name, S, self.combination)
        except np.linalg.LinAlgError:
            size = float(np.trace(S))
            ridge = 1e-9 * (size if size > np.finfo(float).tiny else 1.0)
            slope = _slope(self.name, S + ridge * np.eye(self.size), self.combination)
        return np.asarray(G @ slope @ G.T)

    @property
    def concave(self) -> bool:
        """Whether the value is a concave function of F.

        A concave criterion gives the information of a mixture a bound (Kiefer 1974).
        """
        return self.name != "ME"


def criterion_of(problem: Problem, name: str) -> Criterion:
    """Return the criterion with a given name for the unknown parameters of a problem.

    Raises UsageError for an unknown name or a wrong combination of the problem.
    """
    known = {**{key: key for key in CRITERIA}, "T": "trace"}
    if name not in known:
        raise UsageError(f"criterion must be one of {', '.join(CRITERIA)}, got {name!r}{did_you_mean(name, CRITERIA)}")
    size = len(problem.unknown)
    if known[name] != "c":
        return Criterion(known[name], size)
    weights = dict(problem.combination)
    if not any(weights.values()) or set(weights) - set(problem.unknown):
        raise UsageError(
            f"criterion c needs a weight for at least one of {', '.join(problem.unknown)}, got {weights}; give the key "
            "weights of SPEC.toml, or the argument combination"
        )
    vector = np.array([weights.get(key, 0.0) for key in problem.unknown]) * problem.scale[:size]
    return Criterion("c", size, vector / np.linalg.norm(vector))


def eliminate(F: Floats, size: int) -> tuple[Floats, Floats]:
    """Return the information S = G' F G (size, size) on the first `size` parameters, and G.

    The other parameters are estimated as well.
    """
    G = np.eye(len(F))[:, :size]
    if len(F) == size:
        return F, G
    G[size:] = -np.linalg.solve(F[size:, size:], F[size:, :size])
    return np.asarray(G.T @ F @ G), G


def _schur(F: Floats, size: int) -> Floats:
    S = F[..., :size, :size]
    if F.shape[-1] == size:
        return S
    return np.asarray(S - F[..., :size, size:] @ np.linalg.solve(F[..., size:, size:], F[..., size:, :size]))


def _value(name: str, S: Floats, combination: Floats | None) -> Floats:
    p = S.shape[-1]
    if name == "trace":
        return np.asarray(np.trace(S, axis1=-2, axis2=-1))
    if name == "D":
        sign, log = np.linalg.slogdet(S)
        return np.asarray(np.where(sign > 0, np.exp(log / p), 0.0))
    if name == "c":
        return _evaluate_along(S, np.ones(p) if combination is None else combination)
    eigenvalues = np.maximum(np.linalg.eigvalsh(S), 0.0)
    if name == "A":
        return np.asarray(p / (1.0 / eigenvalues).sum(axis=-1))
    if name == "E":
        return np.asarray(eigenvalues[..., 0])
    return np.asarray(eigenvalues[..., 0] / eigenvalues[..., -1])


def _evaluate_along(S: Floats, combination: Floats) -> Floats:
    eigenvalues, vectors = np.linalg.eigh(S)
    part = np.einsum("...ij,i->...j", vectors, combination)
    return np.asarray(1.0 / (part**2 / np.maximum(eigenvalues, 0.0)).sum(axis=-1))


def _slope(name: str, S: Floats, combination: Floats | None) -> Floats:
    """Return the gradient of the log value by S.

    Raises LinAlgError if S is singular, or for `trace` if the trace of S is 0.
    """
    p = len(S)
    if name == "trace" and np.trace(S) > np.finfo(float).tiny:
        return np.asarray(np.eye(p) / np.trace(S))
    if name == "D":
        return np.asarray(np.linalg.inv(S) / p)
    if name == "A":
        inverse = np.linalg.inv(S)
        return np.asarray(inverse @ inverse / np.trace(inverse))
    if name == "c" and combination is not None:
        pull = np.linalg.solve(S, combination)
        return np.outer(pull, pull) / float(combination @ pull)
    eigenvalues, vectors = np.linalg.eigh(S)
    if name == "trace" or not eigenvalues[0] > 0:
        raise np.linalg.LinAlgError("no information")
    least = np.outer(vectors[:, 0], vectors[:, 0]) / eigenvalues[0]
    if name == "E":
        return np.asarray(least)
    return np.asarray(least - np.outer(vectors[:, -1], vectors[:, -1]) / eigenvalues[-1])

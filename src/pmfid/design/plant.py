"""Optimal inputs for any linear plant with one input and one output (paper eq. 1 to 5)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pmfid.design.ascent import ASCENT_TOLERANCE, Climber
from pmfid.design.fisher import CRITERIA, Affine, Criterion, Regime, discretise, propagate
from pmfid.design.oracle import Oracle
from pmfid.design.polytope import InputSet
from pmfid.design.problem import InfeasibleError
from pmfid.errors import NotIdentifiableError, UsageError, did_you_mean
from pmfid.types import Floats

#: Matrices A (n, n), b (n,), c (n,) and the initial state x0 (n,) for values of the parameters.
Matrices = Callable[[Mapping[str, float]], Sequence[Any]]
#: Relative step of the central differences: the cube root of the precision of a float.
STEP = float(np.finfo(float).eps) ** (1 / 3)


@dataclass(frozen=True, eq=False)
class PlantProblem:
    """The problem of designing an input for x' = A(p) x + b(p) u, y = c(p)' x (paper eq. 5).

    The input is held over each of `intervals` intervals, and the output is measured at the end of each interval.

    Parameters
    ----------
    matrices
        Function from {name: value} to A (n, n), b (n,), c (n,) and the initial state x0 (n,).
    nominal
        First guess of each parameter.
    unknown
        Parameters that the experiment shall determine.
    horizon
        Duration of the experiment [s].
    intervals
        Number of intervals, >= 1.
    noise_variance
        Variance of the measured output, for example resolution^2 / 12.
    input
        Lower and upper bound of the input.
    states
        Lower and upper bound of each state that has one, {index: (lower, upper)}.
    end
        State at the end, for each state that has a given end, {index: value}.

    Raises
    ------
    UsageError
        If a field is wrong.

    Examples
    --------
    >>> from pmfid.design import PlantProblem, solve_plant
    >>> def lag(p):
    ...     return [[-p["pole"]]], [p["gain"] * p["pole"]], [1.0], [0.0]
    >>> nominal = {"gain": 2.0, "pole": 3.0}
    >>> problem = PlantProblem(lag, nominal, ("pole",), 2.0, 20, noise_variance=1e-4, input=(-1.0, 1.0), end={0: 0.0})
    >>> design = solve_plant(problem)
    >>> design.u.shape, bool(abs(design.x[0, -1]) < 1e-9), sorted(design.predicted_std)
    ((20,), True, ['pole'])
    """

    matrices: Matrices
    nominal: Mapping[str, float]
    unknown: tuple[str, ...]
    horizon: float
    intervals: int
    noise_variance: float
    input: tuple[float, float]
    states: Mapping[int, tuple[float, float]] | None = None
    end: Mapping[int, float] | None = None

    def __post_init__(self) -> None:
        for name in ("horizon", "intervals", "noise_variance"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise UsageError(f"{name} must be positive and finite, got {getattr(self, name)}")
        if not (len(self.input) == 2 and np.isfinite(self.input).all() and self.input[0] < self.input[1]):
            raise UsageError(f"input must be (lower, upper) with lower < upper, got {self.input}")
        for name in self.unknown:
            if name not in self.nominal:
                raise UsageError(f"{name!r} is no parameter of nominal{did_you_mean(name, self.nominal)}")
        if not self.unknown:
            raise UsageError("unknown is empty; name at least one parameter that the experiment shall determine")
        self._check_states()

    def _check_states(self) -> None:
        n = len(np.atleast_1d(np.asarray(self.matrices(self.nominal)[0], float)))
        for key, places in (("states", self.states or {}), ("end", self.end or {})):
            for index in places:
                if index not in range(n):
                    raise UsageError(f"{key} has the state {index}, and the plant has the states 0 to {n - 1}")

    @property
    def dt(self) -> float:
        return self.horizon / self.intervals

    def evaluate_plant(self, values: Mapping[str, float]) -> tuple[Floats, Floats, Floats, Floats]:
        """Return A (n, n), b (n,), c (n,) and x0 (n,) for values of the parameters."""
        A, b, c, x0 = (np.asarray(part, float) for part in self.matrices(values))
        return np.atleast_2d(A), b.ravel(), c.ravel(), x0.ravel()

    def differentiate_plant(self, name: str) -> tuple[Floats, Floats, Floats, Floats]:
        """Return the derivatives of A, b, c and x0 by a parameter, from central differences."""
        step = STEP * max(abs(self.nominal[name]), STEP)
        high, low = (self.evaluate_plant({**self.nominal, name: self.nominal[name] + side}) for side in (step, -step))
        dA, db, dc, dx0 = ((above - below) / (2 * step) for above, below in zip(high, low, strict=True))
        return dA, db, dc, dx0

    @cached_property
    def response(self) -> tuple[Floats, Floats]:
        """States (n, K+1, K+1) at the nodes and output sensitivities (p, K, K+1) at the ends of the intervals.

        The last axis holds the coefficients of the K inputs, and last the constant part.
        """
        A, b, c, x0 = self.evaluate_plant(self.nominal)
        slopes = [self.differentiate_plant(name) for name in self.unknown]
        n, none = len(b), np.zeros((len(slopes), len(b)))
        dA, db = (np.array([one[part] for one in slopes]) for part in (0, 1))
        regime = Regime(A, b, np.zeros(n), dA, db, none, np.eye(n))
        start = np.concatenate([x0, *(dx0 for _, _, _, dx0 in slopes)])
        nodes = propagate(start, [(regime, discretise(regime, self.dt))] * self.intervals)
        outputs = [
            np.tensordot(c, nodes[1:, n * i : n * (i + 1)], (0, 1)) + np.tensordot(dc, nodes[1:, :n], (0, 1))
            for i, (_, _, dc, _) in enumerate(slopes, 1)
        ]
        return np.moveaxis(nodes[:, :n], 0, 1), np.array(outputs)

    @cached_property
    def inputs(self) -> InputSet:
        """The inputs that the limits allow."""
        states, K = self.response[0], self.intervals
        rows: list[tuple[str, Floats, float, float]] = [("input", np.eye(K)[k], *self.input) for k in range(K)]
        for i, (low, high) in (self.states or {}).items():
            rows += [(f"state {i}", row[:K], low - row[K], high - row[K]) for row in states[i, 1:]]
        for i, value in (self.end or {}).items():
            exact = value - float(states[i, -1, K])
            rows.append((f"end of state {i}", states[i, -1, :K], exact, exact))
        matrix = np.array([row for _, row, _, _ in rows])
        lower, upper = np.array([low for *_, low, _ in rows]), np.array([high for *_, high in rows])
        names = tuple(name for name, *_ in rows)
        return InputSet(matrix, lower, upper, names, np.inf, states[..., :K], states[..., K])

    @cached_property
    def maps(self) -> Affine:
        """Sensitivities to the unknown parameters as affine functions of the input."""
        K, p = self.intervals, len(self.unknown)
        flat = self.response[1].reshape(p * K, K + 1) / np.sqrt(self.noise_variance)
        return Affine(np.ascontiguousarray(flat[:, :K]), flat[:, K].copy(), np.zeros((p, p)), np.ones(p))


@dataclass(frozen=True, eq=False)
class PlantDesign:
    """An input for a linear plant, its motion and its information.

    Attributes
    ----------
    t
        (K+1,) nodes [s].
    u
        (K,) input, held from t[k] to t[k+1].
    x
        (n, K+1) states at the nodes.
    sensitivity
        (K, p) derivatives of the output by the unknown parameters.
    fisher
        (p, p) information on the unknown parameters (paper eq. 4).
    value
        Value of the criterion.
    predicted_std
        Standard deviation of each unknown parameter after one experiment (Cramér-Rao).

    Examples
    --------
    >>> from pmfid.design import PlantProblem, evaluate_plant_input
    >>> def lag(p):
    ...     return [[-p["pole"]]], [p["pole"]], [1.0], [0.0]
    >>> problem = PlantProblem(lag, {"pole": 3.0}, ("pole",), 1.0, 4, noise_variance=1e-4, input=(-1.0, 1.0))
    >>> design = evaluate_plant_input(problem, [1.0, 1.0, 1.0, 1.0])
    >>> design.t.shape, design.x.shape, design.sensitivity.shape, design.fisher.shape
    ((5,), (1, 5), (4, 1), (1, 1))
    """

    t: Floats
    u: Floats
    x: Floats
    sensitivity: Floats
    fisher: Floats
    value: float
    predicted_std: Mapping[str, float]


def evaluate_plant_input(problem: PlantProblem, u: ArrayLike, criterion: str = "trace") -> PlantDesign:
    """Return the motion and the information of an input, inside or outside the limits.

    Parameters
    ----------
    problem
        Plant, parameters and limits.
    u
        (K,) input, one value per interval.
    criterion
        "trace", "D", "A", "E" or "ME".

    Returns
    -------
    PlantDesign
        The input with its motion and information.

    Raises
    ------
    UsageError
        If the input has another length or the criterion is unknown.

    References
    ----------
    Paper eq. 4 and 5.

    Examples
    --------
    >>> from pmfid.design import PlantProblem, evaluate_plant_input
    >>> def lag(p):
    ...     return [[-p["pole"]]], [p["pole"]], [1.0], [0.0]
    >>> problem = PlantProblem(lag, {"pole": 3.0}, ("pole",), 1.0, 4, noise_variance=1e-4, input=(-1.0, 1.0))
    >>> steady, switched = (evaluate_plant_input(problem, u) for u in ([1, 1, 1, 1], [1, 1, -1, -1]))
    >>> switched.value > steady.value
    True
    """
    values = np.asarray(u, float)
    if values.shape != (problem.intervals,) or not np.isfinite(values).all():
        raise UsageError(f"u must hold {problem.intervals} finite values, one per interval, got shape {values.shape}")
    states, sensitivity = problem.response
    whole = np.append(values, 1.0)
    s = sensitivity @ whole
    fisher = s @ s.T / problem.noise_variance
    variance = np.diag(np.linalg.pinv(fisher)) if np.linalg.matrix_rank(fisher) == len(s) else np.full(len(s), np.inf)
    std = dict(zip(problem.unknown, np.sqrt(variance).tolist(), strict=True))
    t = np.linspace(0.0, problem.horizon, problem.intervals + 1)
    return PlantDesign(t, values, states @ whole, s.T, fisher, _rule(problem, criterion).value(fisher), std)


def _rule(problem: PlantProblem, criterion: str) -> Criterion:
    if criterion not in CRITERIA or criterion == "c":
        known = [name for name in CRITERIA if name != "c"]
        raise UsageError(f"criterion must be one of {', '.join(known)}, got {criterion!r}")
    return Criterion(criterion, len(problem.unknown))


def solve_plant(problem: PlantProblem, criterion: str = "trace", *, starts: int = 20, seed: int = 0) -> PlantDesign:
    """Search for the input with the most information, from random starts.

    The trace is the criterion of the paper. It is a convex function of the input, so the best input switches between
    limits, and local optima abound.

    Parameters
    ----------
    problem
        Plant, parameters and limits.
    criterion
        "trace", "D", "A", "E" or "ME".
    starts
        Number of random starts, >= 1.
    seed
        Seed of the starts.

    Returns
    -------
    PlantDesign
        The best input that the starts find.

    Raises
    ------
    UsageError
        If an argument is wrong.
    NotIdentifiableError
        If the output does not depend on the unknown parameters.
    InfeasibleError
        If no input meets the limits.

    Examples
    --------
    >>> from pmfid.design import PlantProblem, solve_plant
    >>> def spring(p):  # a mass on a spring that starts from rest
    ...     return [[0, 1], [-p["stiffness"] / p["mass"], -0.4]], [0, 1 / p["mass"]], [1, 0], [0, 0]
    >>> nominal = {"mass": 1.0, "stiffness": 40.0}
    >>> problem = PlantProblem(spring, nominal, ("stiffness",), 2.0, 40, noise_variance=1e-8, input=(-1.0, 1.0))
    >>> design = solve_plant(problem)
    >>> bool(abs(abs(design.u) - 1.0).max() < 1e-9)  # the best input switches between its limits
    True
    """
    if starts < 1:
        raise UsageError(f"starts must be at least 1, got {starts}")
    rule, oracle = _rule(problem, criterion), Oracle(problem.inputs)
    if not oracle.feasible():
        raise InfeasibleError("no input meets the limits; widen input or states, drop an end, or give a longer horizon")
    size = np.abs(problem.maps.matrix).max() or 1.0
    scaled = replace(problem.maps, matrix=problem.maps.matrix / size, offset=problem.maps.offset / size)
    climber = Climber(scaled, rule, oracle)
    seeds = np.random.SeedSequence(seed).spawn(starts)
    results = [climber.start(np.random.default_rng(child)) for child in seeds]
    value, u = max(results, key=lambda result: result[0])
    if not np.isfinite(value):
        raise NotIdentifiableError(f"the output does not determine {', '.join(problem.unknown)}; name fewer of them")
    return evaluate_plant_input(problem, climber.ascend(u, ASCENT_TOLERANCE, 300)[1], criterion)

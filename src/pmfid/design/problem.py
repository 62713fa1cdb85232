"""The problem of an input design, and its result."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from pmfid.errors import PmfidError, UsageError, did_you_mean
from pmfid.models.drive import Drive
from pmfid.models.equation import ESTIMATE
from pmfid.presentation import Presentable, Summary, plain_dict
from pmfid.types import Floats

#: Largest size of a value of a machine, in SI units. Its inverse is the smallest size.
PROBLEM_MOST = 1e20


def check_pair(name: str, value: float | tuple[float, float] | None) -> None:
    if value is None:
        return
    if not isinstance(value, tuple):
        check_positive(name, value)
    elif not (len(value) == 2 and all(map(math.isfinite, value)) and value[0] < value[1]):
        raise UsageError(f"limit {name} must be (lower, upper) with lower < upper, got {value}")


def check_positive(name: str, value: float | None) -> None:
    if value is not None and not (math.isfinite(value) and value > 0):
        raise UsageError(
            f"limit {name} must be positive and finite, got {value}; leave the limit out if the axis has none"
        )


def check_drive(drive: Drive) -> None:
    if drive.input_gain == ESTIMATE:
        raise UsageError(
            "a design needs the gain of the input: give input_gain as a number, for example the estimate of pmfid "
            "identify with a known mass"
        )


def parameters_of(drive: Drive) -> dict[str, bool]:
    """Return the names of the parameters, and whether each is never negative."""
    equation = drive.equation
    signs = dict(zip(equation.names, map(bool, equation.positive), strict=True))
    return signs | {name: True for name, _ in equation.further}


def check_parameters(problem: Problem) -> None:
    check_drive(problem.drive)
    signs = parameters_of(problem.drive)
    known, mass = tuple(signs), problem.lead
    for name in (*problem.names, *problem.nominal, *(name for case in problem.scenarios for name in case)):
        if name not in known:
            raise UsageError(f"{name!r} is no parameter of the drive, which has {known}{did_you_mean(name, known)}")
    for case in (dict.fromkeys(known, math.nan) | dict(problem.nominal), *problem.scenarios):
        for name, value in case.items():
            if not math.isfinite(value) or (name == mass and value <= 0) or (signs[name] and value < 0):
                sign = "positive" if name == mass else "at least 0" if signs[name] else "a number"
                raise UsageError(f"{name} must be given, finite and {sign}, got {value}")
            if abs(value) > PROBLEM_MOST or (name == mass and value < 1 / PROBLEM_MOST):
                raise UsageError(f"{name} = {value:g} is impossible for a machine; give the value in SI units")
    if not problem.unknown or len(set(problem.names)) < len(problem.names):
        raise UsageError(
            f"unknown and nuisance must name different parameters, at least one unknown, got {problem.names}"
        )
    if problem.drive.spring and "offset" not in problem.names:
        raise UsageError("an encoder does not show where the spring is at rest; add offset to the nuisance parameters")
    if problem.scaled and 0.0 in [problem.nominal[name] for name in problem.unknown]:
        raise UsageError(
            "a parameter whose nominal value is 0 cannot be scaled; give a likely value, or scaled = false"
        )


def check_grid(problem: Problem) -> None:
    for name in ("intervals", "samples_per_interval"):
        if getattr(problem, name) != int(getattr(problem, name)) or getattr(problem, name) < 1:
            raise UsageError(f"{name} must be a whole number, at least 1, got {getattr(problem, name)}")
    if not (math.isfinite(problem.horizon) and problem.horizon > 0):
        raise UsageError(f"horizon must be positive and finite, got {problem.horizon}; give the duration in s")
    sense = problem.sense
    if len(sense) != problem.intervals or set(sense) - {-1, 0, 1}:
        raise UsageError(f"directions must hold 1, -1 or 0 for each of the {problem.intervals} intervals, got {sense}")
    if problem.scenarios and 0 in sense:
        raise UsageError(
            "no input brings the axis to rest at the same instant in every scenario; leave out the scenarios (the "
            "section robust), or give directions without an interval of rest (0)"
        )
    if any(a * b < 0 for a, b in pairwise(sense)):
        raise UsageError("directions must have an interval of rest, 0, between forward and backward")


def check_ends(problem: Problem) -> None:
    ends = {"start": problem.start, "end": problem.end, "end_tolerance": problem.end_tolerance}
    for name, pair in ends.items():
        if len(pair) != 2 or any(value is not None and not math.isfinite(value) for value in pair):
            raise UsageError(f"{name} must be a (position, velocity) of finite numbers, got {pair}")
    if min(problem.end_tolerance) < 0:
        raise UsageError(f"end_tolerance must not be negative, got {problem.end_tolerance}")
    if problem.end[0] is not None and (problem.end[0] - problem.start[0]) * sum(sorted(set(problem.sense))) < 0:
        raise UsageError(
            f"directions never lead from start {problem.start[0]} to end {problem.end[0]}; give other directions"
        )
    for name, velocity, direction in (
        ("start", problem.start[1], problem.sense[0]),
        ("end", problem.end[1] or 0.0, problem.sense[-1]),
    ):
        if velocity * direction < 0 or (velocity and not direction):
            raise UsageError(f"{name} velocity {velocity} is against the direction {direction}; give other directions")
    for name, position in (("start", problem.start[0]), ("end", problem.end[0])):
        bounds = problem.limits.position
        if bounds and position is not None and not bounds[0] <= position <= bounds[1]:
            raise UsageError(
                f"{name} position {position} is outside the position limit {bounds}; change the position, or widen the "
                "limit"
            )


def check_noise(problem: Problem) -> None:
    if problem.resolution is None and problem.noise_variance is None:
        raise UsageError("the noise is not known; give resolution in m per count, or noise_variance in m^2")
    for name in ("resolution", "noise_variance"):
        value = getattr(problem, name)
        if value is not None and not (math.isfinite(value) and value > 0):
            raise UsageError(f"{name} must be positive and finite, got {value}")
        if value is not None and not PROBLEM_MOST**-2 < value < PROBLEM_MOST**2:
            raise UsageError(f"{name} = {value:g} is impossible for an encoder; check the unit")
    if problem.prior is not None:
        _check_prior(problem.prior, len(problem.names))


def _check_prior(prior: ArrayLike, size: int) -> None:
    prior = np.asarray(prior, float)
    if prior.shape != (size, size) or not np.isfinite(prior).all() or not np.allclose(prior, prior.T):
        raise UsageError(
            f"prior must be a finite symmetric ({size}, {size}) information matrix, got shape {prior.shape}"
        )
    eigenvalues = np.linalg.eigvalsh(prior)
    if eigenvalues[0] < -1e-9 * max(1e-300, eigenvalues[-1]):
        raise UsageError("prior must be positive semidefinite; give the inverse of a covariance")


@dataclass(frozen=True)
class Relaxation:
    """A change of the limit `name` from `value` to `needed`, both in `unit`, that makes limits feasible."""

    name: str
    value: float
    needed: float
    unit: str

    def __str__(self) -> str:
        return f"{self.name} {self.value:.4g} -> {self.needed:.4g} {self.unit}".rstrip()


class InfeasibleError(PmfidError):
    """Raised if no input meets all limits (exit code 3 of the command).

    Attributes
    ----------
    relaxations
        Changes of one limit that make the problem feasible, smallest first.

    Examples
    --------
    >>> from pmfid import Drive
    >>> from pmfid.design import InfeasibleError, Limits, Problem, solve
    >>> nominal = {"mass": 1.5, "viscous_friction": 6.0, "coulomb_friction": 0.6}
    >>> problem = Problem(
    ...     Drive(2.0), nominal, ("mass",), 2.0, 10, Limits(input=0.5, min_speed=0.01), resolution=1e-5, end=(0.4, 0.0)
    ... )
    >>> try:
    ...     solve(problem, starts=1)
    ... except InfeasibleError as error:
    ...     print(error.relaxations[0].name)
    horizon
    """

    exit_code: ClassVar[int] = 3

    def __init__(self, message: str, relaxations: tuple[Relaxation, ...] = ()) -> None:
        super().__init__(message)
        self.relaxations = relaxations


@dataclass(frozen=True)
class Limits:
    """Limits of a machine. None means no limit, and a single number b stands for (-b, b).

    Parameters
    ----------
    input
        Bounds of the input [V, or the unit of u].
    input_rate
        Largest change of the input [V/s]: |u[k] - u[k-1]| / dt, with u[-1] = 0.
    position
        Bounds of the position [m], at every instant.
    velocity
        Bounds of the velocity [m/s], at every instant.
    acceleration
        Bounds of the acceleration [m/s^2], at every instant.
    jerk
        Largest change of the mean acceleration from one interval to the next, divided by dt [m/s^3].
    energy
        Largest integral of u^2 dt [V^2 s].
    rms
        Largest root of the mean square of u [V].
    min_speed
        Least speed at the nodes between standstills [m/s], >= 0: v_min of the paper. At 0 the best motion may rest,
        where the linear sensitivities are wrong.

    Raises
    ------
    UsageError
        If a limit is not finite, empty or of the wrong sign.

    Examples
    --------
    >>> from pmfid.design import Limits
    >>> limits = Limits(input=3.0, position=(0.0, 0.4), min_speed=0.01)
    >>> limits.pair("input"), limits.pair("position"), limits.pair("velocity")
    ((-3.0, 3.0), (0.0, 0.4), None)
    """

    input: float | tuple[float, float] | None = None
    input_rate: float | None = None
    position: tuple[float, float] | None = None
    velocity: float | tuple[float, float] | None = None
    acceleration: float | tuple[float, float] | None = None
    jerk: float | None = None
    energy: float | None = None
    rms: float | None = None
    min_speed: float = 0.0

    def __post_init__(self) -> None:
        for name in ("input", "position", "velocity", "acceleration"):
            check_pair(name, getattr(self, name))
        for name in ("input_rate", "jerk", "energy", "rms"):
            check_positive(name, getattr(self, name))
        if not (math.isfinite(self.min_speed) and self.min_speed >= 0):
            raise UsageError(f"limit min_speed must be finite and at least 0, got {self.min_speed}")

    def pair(self, name: str) -> tuple[float, float] | None:
        """Return the lower and upper bound of a limit, or None."""
        value = getattr(self, name)
        return value if value is None or isinstance(value, tuple) else (-float(value), float(value))


@dataclass(frozen=True, eq=False)
class Problem:
    """The problem of designing an input u[0..intervals-1] that is held over intervals of dt = horizon / intervals.

    Parameters
    ----------
    drive
        Drive with the equation of the plant.
    nominal
        Value of each parameter of the equation, {name: value}.
    unknown
        Parameters that the experiment shall determine.
    horizon
        Duration of a run [s].
    intervals
        Number of intervals K, >= 1.
    limits
        Limits of the machine.
    resolution
        Travel per count of the encoder [m].
    noise_variance
        Variance of the measured position [m^2]; None: resolution^2 / 12.
    nuisance
        Further unknown parameters, of no interest. All parameters that are neither unknown nor nuisance count as known.
    start, end
        (position [m], velocity [m/s]) at the start and at the end; None if the end is free.
    end_tolerance
        (position [m], velocity [m/s]) by which the motion may miss the end.
    samples_per_interval
        Position samples per interval, >= 1: the sampling may be finer than the input.
    prior
        Prior information, (p, p) over unknown + nuisance, in the units of the parameters.
    scaled
        Whether criteria refer to the parameters divided by their nominal values.
    directions
        Direction of each interval: 1 forward, -1 backward, 0 at rest. An empty tuple means forward throughout. Between
        forward and backward, friction holds the axis for at least one interval. Only this rest makes the sensitivities
        exact.
    scenarios
        Other parameter sets {name: value} in which the limits must hold as well; missing values are nominal. In a
        scenario, only an end with a tolerance counts.
    combination
        {unknown parameter: weight} for the criterion "c".

    Raises
    ------
    UsageError
        If a field is wrong; the message names it.

    Examples
    --------
    >>> from pmfid import Drive
    >>> from pmfid.design import Limits, Problem
    >>> nominal = {"mass": 1.5, "viscous_friction": 6.0, "coulomb_friction": 0.6}
    >>> limits = Limits(input=3.0, min_speed=0.01)
    >>> problem = Problem(
    ...     Drive(2.0), nominal, ("mass",), horizon=2.0, intervals=10, limits=limits, resolution=1e-5, end=(0.4, 0.0)
    ... )
    >>> problem.dt, problem.names, problem.t.shape
    (0.2, ('mass',), (11,))
    """

    drive: Drive
    nominal: Mapping[str, float]
    unknown: tuple[str, ...]
    horizon: float
    intervals: int
    limits: Limits
    resolution: float | None = None
    noise_variance: float | None = None
    nuisance: tuple[str, ...] = ()
    start: tuple[float, float] = (0.0, 0.0)
    end: tuple[float | None, float | None] = (None, None)
    end_tolerance: tuple[float, float] = (0.0, 0.0)
    samples_per_interval: int = 1
    prior: Floats | None = None
    scaled: bool = True
    directions: tuple[int, ...] = ()
    scenarios: tuple[Mapping[str, float], ...] = field(default=())
    combination: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_parameters(self)
        check_grid(self)
        check_ends(self)
        check_noise(self)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the Fisher information's parameters, with the unknown parameters first, and the nuisance parameters
        last.
        """
        return (*self.unknown, *self.nuisance)

    @property
    def dt(self) -> float:
        return self.horizon / self.intervals

    @property
    def t(self) -> Floats:
        """Instants of the nodes [s], (intervals + 1,)."""
        return np.linspace(0.0, self.horizon, self.intervals + 1)

    @property
    def sense(self) -> tuple[int, ...]:
        """Direction of motion in each interval."""
        return self.directions or (1,) * self.intervals

    @property
    def lead(self) -> str:
        """The name of the mass, or of that of the motor."""
        return self.drive.equation.names[self.drive.equation.leading]

    @property
    def linear(self) -> bool:
        """Whether the equation is linear in one direction of motion, so that an optimum has a bound."""
        drive, equation = self.drive, self.drive.equation
        late = drive.dead_time or drive.lag
        return not (drive.spring or late or equation.elastic or equation.shaped or drive.axis == "rotary")

    @property
    def counted(self) -> bool:
        """Whether the error of the position is the rounding of an encoder."""
        return self.noise_variance is None

    @property
    def variance(self) -> float:
        """Variance of the measured position [m^2]."""
        if self.noise_variance is not None:
            return self.noise_variance
        return float(self.resolution or 0.0) ** 2 / 12.0

    @property
    def scale(self) -> Floats:
        """Nominal values (p,), or ones if the criteria are not scaled. A nuisance parameter of 0 has the scale 1."""
        return np.array([abs(self.nominal[name]) or 1.0 if self.scaled else 1.0 for name in self.names])


@dataclass(frozen=True, eq=False, repr=False)
class Design(Presentable):
    """An input, its nominal motion, and its information.

    Attributes
    ----------
    problem
        The problem of the design.
    criterion
        Name of the criterion.
    t
        (n+1,) nodes [s].
    u
        (n,) input [V], held from t[k] to t[k+1].
    x, v
        (n+1,) nominal position [m] and velocity [m/s].
    fisher
        (p, p) information on the unknown parameters, in their own units. The information includes the prior, and
        nuisance parameters are eliminated.
    value
        Value of the criterion; larger is better (see `criteria`).
    bound
        Proved upper bound of the value, for the time grid and directions of the problem, or None.
    starts, reached
        Number of starts, and the fraction of them within 0.1 % of the best.
    solve_seconds
        Time of the search [s].
    feasible
        Whether the limits hold.
    warnings
        Warnings for the user, as sentences.

    Examples
    --------
    >>> from pmfid import Drive
    >>> from pmfid.design import Limits, Problem, solve
    >>> nominal = {"mass": 1.5, "viscous_friction": 6.0, "coulomb_friction": 0.6}
    >>> problem = Problem(
    ...     Drive(2.0), nominal, ("mass",), 2.0, 10, Limits(input=3.0, min_speed=0.01), resolution=1e-5, end=(0.4, 0.0)
    ... )
    >>> design = solve(problem, starts=3)
    >>> design.u.shape, list(design.predicted_std), design.feasible
    ((10,), ['mass'], True)
    """

    problem: Problem
    criterion: str
    t: Floats
    u: Floats
    x: Floats
    v: Floats
    fisher: Floats
    value: float
    bound: float | None = None
    starts: int = 1
    reached: float = 1.0
    solve_seconds: float = 0.0
    feasible: bool = True
    warnings: tuple[str, ...] = ()

    @property
    def gap(self) -> float | None:
        """Proved bound over the value, minus 1. The property is None if no bound is proved."""
        return None if self.bound is None else max(0.0, self.bound / self.value - 1.0)

    @property
    def predicted_std(self) -> dict[str, float]:
        """Standard deviation of each unknown parameter after one run (Cramér-Rao), infinite without information."""
        scale = self.problem.scale[: len(self.fisher)]
        values, vectors = np.linalg.eigh(self.fisher * np.outer(scale, scale))
        known = values > 1e-12 * max(values[-1], 0.0)
        variance = (vectors[:, known] ** 2 / values[known]).sum(axis=1)
        variance[np.any(vectors[:, ~known] ** 2 > 0, axis=1)] = math.inf
        return dict(zip(self.problem.unknown, (scale * np.sqrt(variance)).tolist(), strict=True))

    def summary(self) -> Summary:
        """Return the predicted standard deviations after one run."""
        proved = "no bound proved" if self.gap is None else f"at most {100 * self.gap:.3g} % below the optimum"
        title = f"design by {self.criterion}: {self.u.size} intervals over {self.t[-1]:g} s, {proved}; after one run:"
        nominal = self.problem.nominal
        rows = [
            (name, f"{nominal[name]:.4g}", f"{std:.2g}", f"{100 * std / abs(nominal[name]):.2g}")
            for name, std in self.predicted_std.items()
        ]
        lines = [f"{name} = {value} ± {std}, {percent} %" for name, value, std, percent in rows]
        return Summary(title, ("parameter", "nominal", "std", "std [%]"), rows, lines, self.warnings)

    def columns(self) -> dict[str, object]:
        """Return a table with a row for each interval, at its beginning."""
        return {"t": self.t[:-1], "u": self.u, "x": self.x[:-1], "v": self.v[:-1]}

    def to_dict(self) -> dict[str, object]:
        own = {"criterion": self.criterion, "value": self.value, "bound": self.bound, "gap": self.gap}
        return plain_dict({**own, "predicted_std": self.predicted_std, "warnings": self.warnings, **self.columns()})

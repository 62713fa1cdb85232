"""What a problem of design must be; every error names the field and the remedy."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import UsageError, did_you_mean
from pmfid.models.drive import Drive
from pmfid.models.equation import ESTIMATE

__all__ = ["check_ends", "check_grid", "check_noise", "check_pair", "check_parameters", "check_positive"]


#: Sizes of what machines are made of, in SI units.
LEAST, MOST = 1e-20, 1e20


class Posed(Protocol):
    """What the checks read of a problem (`problem.Problem`)."""

    @property
    def drive(self) -> Drive: ...
    @property
    def nominal(self) -> Mapping[str, float]: ...
    @property
    def unknown(self) -> tuple[str, ...]: ...
    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def scenarios(self) -> tuple[Mapping[str, float], ...]: ...
    @property
    def scaled(self) -> bool: ...
    @property
    def horizon(self) -> float: ...
    @property
    def intervals(self) -> int: ...
    @property
    def sense(self) -> tuple[int, ...]: ...
    @property
    def position_limit(self) -> tuple[float, float] | None: ...
    @property
    def start(self) -> tuple[float, float]: ...
    @property
    def end(self) -> tuple[float | None, float | None]: ...
    @property
    def end_tolerance(self) -> tuple[float, float]: ...
    @property
    def resolution(self) -> float | None: ...
    @property
    def noise_variance(self) -> float | None: ...
    @property
    def prior(self) -> NDArray[np.float64] | None: ...


def check_pair(name: str, value: float | tuple[float, float] | None) -> None:
    if value is None:
        return
    if not isinstance(value, tuple):
        check_positive(name, value)
    elif not (len(value) == 2 and all(map(math.isfinite, value)) and value[0] < value[1]):
        raise UsageError(f"limit {name} must be (lower, upper) with lower < upper, got {value}")


def check_positive(name: str, value: float | None) -> None:
    if value is not None and not (math.isfinite(value) and value > 0):
        raise UsageError(f"limit {name} must be positive and finite, got {value}; leave it out where there is none")


#: Of a drive, what no design takes.
NOT_YET = {"spring": "a load on a spring", "dead_time": "an input that acts late", "lag": "an input with a lag"}


def check_drive(drive: Drive) -> None:
    for key, what in NOT_YET.items():
        if getattr(drive, key):
            raise UsageError(f"a design for {what} is not there yet; leave {key} out")
    if drive.input_gain == ESTIMATE:
        raise UsageError(
            "a design needs the gain of the input: give input_gain as a number, such as pmfid identify finds with a "
            "known mass"
        )
    shaped = ", ".join(str(term.name) for term in drive.equation.shaped)
    if shaped:
        raise UsageError(f"a design for {shaped} is not there yet; leave that out")


def check_parameters(problem: Posed) -> None:
    check_drive(problem.drive)
    known = problem.drive.equation.names
    for name in (*problem.names, *problem.nominal, *(name for case in problem.scenarios for name in case)):
        if name not in known:
            raise UsageError(f"{name!r} is no parameter of the drive, which has {known}{did_you_mean(name, known)}")
    for case in (dict.fromkeys(known, math.nan) | dict(problem.nominal), *problem.scenarios):
        for name, value in case.items():
            if not math.isfinite(value) or (name == "mass" and value <= 0) or (name != "offset" and value < 0):
                raise UsageError(f"{name} must be given, finite and {_SIGN.get(name, 'at least 0')}, got {value}")
            if abs(value) > MOST or (name == "mass" and value < LEAST):
                raise UsageError(f"{name} = {value:g}: no machine has that; give it in SI units")
    if not problem.unknown or len(set(problem.names)) < len(problem.names):
        raise UsageError(
            f"unknown and nuisance must name different parameters, at least one unknown, got {problem.names}"
        )
    if problem.scaled and 0.0 in [problem.nominal[name] for name in problem.names]:
        raise UsageError(
            "a parameter whose nominal value is 0 cannot be scaled; give a likely value, or scaled = false"
        )


_SIGN = {"mass": "positive", "offset": "a number"}


def check_grid(problem: Posed) -> None:
    for name in ("intervals", "samples_per_interval"):
        if getattr(problem, name) != int(getattr(problem, name)) or getattr(problem, name) < 1:
            raise UsageError(f"{name} must be a whole number, at least 1, got {getattr(problem, name)}")
    if not (math.isfinite(problem.horizon) and problem.horizon > 0):
        raise UsageError(f"horizon must be positive and finite, got {problem.horizon}; it is the duration in s")
    sense = problem.sense
    if len(sense) != problem.intervals or set(sense) - {-1, 0, 1}:
        raise UsageError(f"directions must hold 1, -1 or 0 for each of the {problem.intervals} intervals, got {sense}")
    if problem.scenarios and 0 in sense:
        raise UsageError(
            "no input brings the axis to rest at the same instant in every scenario; leave out the scenarios (robust), "
            "or the rests in directions"
        )
    if any(a * b < 0 for a, b in pairwise(sense)):
        raise UsageError("directions must have an interval of rest, 0, between forward and backward")


def check_ends(problem: Posed) -> None:
    ends = {"start": problem.start, "end": problem.end, "end_tolerance": problem.end_tolerance}
    for name, pair in ends.items():
        if len(pair) != 2 or any(value is not None and not math.isfinite(value) for value in pair):
            raise UsageError(f"{name} must be a (position, velocity) of finite numbers, got {pair}")
    if min(problem.end_tolerance) < 0:
        raise UsageError(f"end_tolerance must not be negative, got {problem.end_tolerance}")
    if problem.end[0] is not None and (problem.end[0] - problem.start[0]) * sum(sorted(set(problem.sense))) < 0:
        raise UsageError(
            f"directions never lead from start {problem.start[0]} to end {problem.end[0]}; give directions"
        )
    for name, velocity, direction in (
        ("start", problem.start[1], problem.sense[0]),
        ("end", problem.end[1] or 0.0, problem.sense[-1]),
    ):
        if velocity * direction < 0 or (velocity and not direction):
            raise UsageError(f"{name} velocity {velocity} is against the direction {direction} there; give directions")
    for name, position in (("start", problem.start[0]), ("end", problem.end[0])):
        bounds = problem.position_limit
        if bounds and position is not None and not bounds[0] <= position <= bounds[1]:
            raise UsageError(f"{name} position {position} is outside the position limit {bounds}; widen one of them")


def check_noise(problem: Posed) -> None:
    if problem.resolution is None and problem.noise_variance is None:
        raise UsageError("give resolution, of the encoder in m per count, or noise_variance in m^2")
    for name in ("resolution", "noise_variance"):
        value = getattr(problem, name)
        if value is not None and not (math.isfinite(value) and value > 0):
            raise UsageError(f"{name} must be positive and finite, got {value}")
        if value is not None and not LEAST**2 < value < MOST**2:
            raise UsageError(f"{name} = {value:g}: no encoder has that; check the unit")
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
        raise UsageError("prior must be positive semidefinite: it is the inverse of a covariance")

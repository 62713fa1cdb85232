"""What is to be designed: the axis as far as it is known, what is unknown, and the limits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from pmfid.design.problem.checks import (
    check_ends,
    check_grid,
    check_noise,
    check_pair,
    check_parameters,
    check_positive,
)
from pmfid.errors import PmfidError, UsageError
from pmfid.models.drive import Drive
from pmfid.types import Floats

__all__ = ["InfeasibleError", "Limits", "Problem", "Relaxation"]


@dataclass(frozen=True)
class Relaxation:
    """One way out of infeasible limits: set the limit `name` from `value` to `needed` (in its `unit`)."""

    name: str
    value: float
    needed: float
    unit: str

    def __str__(self) -> str:
        return f"{self.name} {self.value:.4g} -> {self.needed:.4g} {self.unit}".rstrip()


class InfeasibleError(PmfidError):
    """No input meets all limits (exit code 3); `relaxations` are single changes that would do, smallest first."""

    exit_code: ClassVar[int] = 3

    def __init__(self, message: str, relaxations: tuple[Relaxation, ...] = ()) -> None:
        super().__init__(message)
        self.relaxations = relaxations


@dataclass(frozen=True)
class Limits:
    """What the machine bears; None if there is no limit. A single number b stands for (-b, b).

    input [V, or what u is in], input_rate [1/s of it]: |u[k] - u[k-1]| / dt, with u[-1] = 0; position [m],
    velocity [m/s], acceleration [m/s^2]: at every instant; jerk [m/s^3]: change of the mean acceleration from one
    interval to the next, over dt; energy: integral of u^2 dt [V^2 s]; rms: root of the mean square of u [V].
    min_speed: at the nodes between standstills the speed is at least this [m/s], >= 0; at 0 the optimum may park at
    standstill, where the linear sensitivities are wrong.
    Raises UsageError if a limit is not finite, empty or of the wrong sign.
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
        """Lower and upper bound of a limit, or None."""
        value = getattr(self, name)
        return value if value is None or isinstance(value, tuple) else (-float(value), float(value))


@dataclass(frozen=True, eq=False)
class Problem:
    """Design of u[0..intervals-1], held over intervals of dt = horizon / intervals.

    drive: the equation. nominal: value of each of its parameters, {name: value}. unknown: those that the experiment is
    for; nuisance: unknown as well, but of no interest; the others are taken as known.
    horizon [s]; intervals: >= 1. limits: see `Limits`. start: (position [m], velocity [m/s]); end: the same, None where
    free.
    noise_variance: of the measured position [m^2]; None: resolution^2 / 12. resolution: of the encoder [m per count].
    samples_per_interval: position samples per interval (the sampling may be finer than the input), >= 1.
    prior: information known beforehand, (p, p) over unknown + nuisance, in the units of the parameters.
    scaled: criteria refer to the parameters divided by their nominal values. v_min is `limits.min_speed`.
    directions: 1 forward, -1 backward, 0 at rest, for each interval; empty: forward throughout. Between forward and
    backward there is at least one interval of rest, where friction holds the axis: only so the sensitivities are exact.
    end_tolerance: (position, velocity) by which the end may be missed; scenarios: other parameter sets {name: value}
    (missing ones nominal) in which the limits must hold as well; there, the end counts only where it has a tolerance.
    average: of the criterion, "mean" (geometric) or "worst" over the nominal case and the scenarios; None: nominal.
    Raises UsageError naming the field that is wrong.
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
    average: str | None = None

    def __post_init__(self) -> None:
        check_parameters(self)
        check_grid(self)
        check_ends(self)
        check_noise(self)
        if self.average not in (None, "mean", "worst"):
            raise UsageError(
                f"average must be 'mean' or 'worst', or left out for the nominal case, got {self.average!r}"
            )

    @property
    def cases(self) -> tuple[Mapping[str, float], ...]:
        """The parameters of the criterion: the nominal ones, and with an average the ones of each scenario."""
        return (self.nominal, *(({**self.nominal, **case} for case in self.scenarios) if self.average else ()))

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that the Fisher information is over: unknown, then nuisance."""
        return (*self.unknown, *self.nuisance)

    @property
    def position_limit(self) -> tuple[float, float] | None:
        """The positions within which the axis stays [m]."""
        return self.limits.position

    @property
    def dt(self) -> float:
        return self.horizon / self.intervals

    @property
    def t(self) -> Floats:
        """Instants of the nodes [s], (intervals + 1,)."""
        return np.linspace(0.0, self.horizon, self.intervals + 1)

    @property
    def sense(self) -> tuple[int, ...]:
        """Direction of motion in each interval, written out."""
        return self.directions or (1,) * self.intervals

    @property
    def variance(self) -> float:
        """Variance of the measured position [m^2]."""
        if self.noise_variance is not None:
            return self.noise_variance
        return float(self.resolution or 0.0) ** 2 / 12.0

    @property
    def scale(self) -> Floats:
        """(p,) nominal values, or ones if the criteria are not scaled."""
        return np.array([abs(self.nominal[name]) if self.scaled else 1.0 for name in self.names])

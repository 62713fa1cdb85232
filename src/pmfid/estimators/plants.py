"""Defaults of the two kinds of plants: machines that rest and reverse, and linear processes."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from pmfid.elementary import geometric
from pmfid.models.equation import Equation
from pmfid.types import Counts, Floats

#: Relative pivot of the information matrix from which a first estimate exists.
START_PIVOT = 1e-4
#: Least number of time constants of the slowest pre-filter zero in a memory.
ZERO_MEMORIES = 2
#: Least ratio of the two zeros. With a ratio of three, a short memory had weak instruments.
PLANTS_APART = 5.0
#: Candidates for the faster zero, as parts of the cutoff. The slower zero is a thirtieth of the faster one.
PLANTS_FRACTIONS = (1 / 5, 1 / 10, 1 / 20, 1 / 40, 1 / 80)
PLANTS_RATIO = 30.0
#: Candidates for the fastest zero of a linear process, and ratios of the fastest to the slowest zero. The zeros are
#: evenly spaced on a logarithmic scale.
PROCESS_FRACTIONS = (1 / 2, 1 / 4, 1 / 8, 1 / 16)
PROCESS_RATIOS = (3.0, 10.0, 30.0)
#: Example motion of a machine: counts per sample at full speed, and the parts of the input that the frictions take.
COUNTS_PER_SAMPLE = 40.0
VISCOUS_PART = 0.6
COULOMB_PART = 0.3
#: Counts of the example linear process for an input of one.
PROCESS_COUNTS = 500.0


@dataclass(frozen=True)
class PlantDefaults(ABC):
    """Defaults of one kind of plant.

    `regularization` is the part of the largest information that is never forgotten. `pivot` is the relative pivot of
    the information matrix from which a first estimate exists. `least_part` is the least independent part of a column's
    power. `rests` is True if a motion may rest and reverse inside a sample, so that a large motion says little about a
    small one. `extended` is True if the pre-filter's coefficients can be further unknowns. `fewer` names the unknowns
    that a user can reduce.
    """

    regularization: float
    pivot: float
    least_part: float
    rests: bool
    extended: bool
    fewer: str

    @abstractmethod
    def default_zeros(self, cutoff: float, memory: float, needed: int) -> tuple[float, ...]:
        """Return pre-filter zeros [rad/s] for an unknown plant and an estimator with `memory` [s]."""

    @abstractmethod
    def candidate_zeros(self, cutoff: float, memory: float, needed: int) -> list[tuple[float, ...]]:
        """Return the sets of `needed` zeros [rad/s] from which a record chooses."""

    @abstractmethod
    def zeros_without_record(self, cutoff: float, memory: float, needed: int) -> tuple[float, ...]:
        """Return zeros [rad/s] for an estimator that is made before a record exists."""

    @abstractmethod
    def made_up_counts(self, equation: Equation, u: Floats, dt: float, cutoff: float, resolution: float) -> Counts:
        """Return the counts (n,) of an example plant for an input u (n,) up to 1. The plant suits dt, cutoff and
        resolution."""


@dataclass(frozen=True)
class MachineDefaults(PlantDefaults):
    """Defaults for a machine with friction. Position, direction and intervals of partial motion matter."""

    regularization: float = 1e-4  # P stays below 1e4 times its smallest value
    pivot: float = START_PIVOT
    least_part: float = START_PIVOT
    rests: bool = True
    extended: bool = True
    fewer: str = "unknown terms"

    def default_zeros(self, cutoff: float, memory: float, needed: int) -> tuple[float, ...]:
        return default_zeros(cutoff, memory)[:needed]

    def candidate_zeros(self, cutoff: float, memory: float, needed: int) -> list[tuple[float, ...]]:
        return [limit_zeros(cutoff * part, cutoff * part / PLANTS_RATIO, memory)[:needed] for part in PLANTS_FRACTIONS]

    def zeros_without_record(self, cutoff: float, memory: float, needed: int) -> tuple[float, ...]:
        return self.default_zeros(cutoff, memory, needed)

    def made_up_counts(self, equation: Equation, u: Floats, dt: float, cutoff: float, resolution: float) -> Counts:
        from pmfid._kernel64 import simulate

        gain, full_speed = equation.input_gain, COUNTS_PER_SAMPLE * resolution / dt
        viscous, coulomb = VISCOUS_PART * abs(gain) / full_speed, COULOMB_PART * abs(gain)
        mass = viscous * 2 / cutoff
        velocity, *_ = simulate([mass, viscous, viscous, coulomb, coulomb, 0.0, 0.0], gain, dt, u)
        position = np.concatenate([[0.0], np.cumsum(np.asarray(velocity)[:-1])]) * dt
        return np.asarray(np.floor(position / resolution).astype(np.int64) - 100)


@dataclass(frozen=True)
class LinearProcess(PlantDefaults):
    """Defaults for a transfer function. Rest has no meaning for a process, and counts are a reading.

    The columns may nearly depend on each other. The third derivative of a lightly damped mode, for example, is almost a
    multiple of y'.
    """

    regularization: float = 1e-7
    pivot: float = 1e-7
    least_part: float = 1e-12
    rests: bool = False
    extended: bool = False
    fewer: str = "poles (n), zeros (m) or extras, or srivc on whole records"

    def default_zeros(self, cutoff: float, memory: float, needed: int) -> tuple[float, ...]:
        return process_zeros(cutoff, needed)

    def candidate_zeros(self, cutoff: float, memory: float, needed: int) -> list[tuple[float, ...]]:
        ratios = PROCESS_RATIOS if needed > 1 else PROCESS_RATIOS[:1]
        return [
            tuple(-cutoff * part * step for step in _spread(1.0, 1 / ratio, needed))
            for part in PROCESS_FRACTIONS
            for ratio in ratios
        ]

    def zeros_without_record(self, cutoff: float, memory: float, needed: int) -> tuple[float, ...]:
        return self.candidate_zeros(cutoff, memory, needed)[0]

    def made_up_counts(self, equation: Equation, u: Floats, dt: float, cutoff: float, resolution: float) -> Counts:
        """Return the counts of a chain of lags, up to some hundred."""
        y, states, part = [], [0.0] * equation.order, min(0.5, cutoff * dt / 2)
        for value in u.tolist():
            y.append(states[-1])
            for i, source in enumerate([value, *states[:-1]]):
                states[i] += part * (source - states[i])
        return np.asarray(np.floor(PROCESS_COUNTS * np.asarray(y)).astype(np.int64))


MACHINE, LINEAR_PROCESS = MachineDefaults(), LinearProcess()


def plant_of(equation: Equation) -> PlantDefaults:
    """Return the defaults for the kind of plant that an equation describes. No other function chooses the defaults of a
    plant.
    """
    return LINEAR_PROCESS if equation.process else MACHINE


def default_zeros(cutoff: float, memory: float = math.inf) -> tuple[float, float]:
    """Return pre-filter zeros for an unknown plant: -cutoff / 10 and -cutoff / 300.

    The compensation is an instrumental variable method with the instruments s u/f and s^2 u/f. Zeros at the drive's own
    poles, 0 and -d/m, make the instruments most similar to the velocity and the acceleration. With one slow zero, the
    other zero may lie anywhere near d/m or above. `memory` is the estimator's memory [s]; see `limit_zeros`.
    """
    return limit_zeros(cutoff / 10, cutoff / 300, memory)


def limit_zeros(fast: float, slow: float, memory: float) -> tuple[float, float]:
    """Return two pre-filter zeros [rad/s] of the sizes `fast` and `slow`, limited for an estimator with `memory` [s].

    A slow zero is a filter that remembers the input. If the filter remembered a large part of the estimator's memory,
    the instruments after a large motion would be weak remains. The limit makes a slow zero faster, but keeps the zeros
    apart, because two similar zeros give the same instrument.
    """
    return (-fast, -min(max(slow, ZERO_MEMORIES / memory), max(slow, fast / PLANTS_APART)))


def process_zeros(cutoff: float, n: int) -> tuple[float, ...]:
    """Return n pre-filter zeros for an unknown linear process. The zeros are evenly spaced on a logarithmic scale from
    half the cutoff to a twentieth."""
    return tuple(-cutoff * part for part in (_spread(0.5, 0.05, n) if n > 1 else [0.2]))


def _spread(first: float, last: float, n: int) -> list[float]:
    """Return n numbers from `first` to `last` on a logarithmic scale, or only the first one."""
    return geometric(first, last, n).tolist() if n > 1 else [first]

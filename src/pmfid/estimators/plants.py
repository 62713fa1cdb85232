"""What is particular to a kind of plant, for every estimator: machines that rest and reverse, and linear processes."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from pmfid.estimators.tuning import TUNING
from pmfid.models.equation import Equation
from pmfid.types import Counts, Floats


@dataclass(frozen=True)
class PlantDefaults(ABC):
    """A kind of plant.

    regularization: information that is never forgotten, as a part of the largest seen. pivot: relative one of the
    information matrix from which on a first estimate is given. least_part: of the power of a column that must not
    follow from the others. spike: multiple of the largest recent input from which on an input is a spike, unless the
    counts answer or it stays. rests: a motion rests and reverses inside a sample, and a large one says little of a
    small. extended: takes the coefficients of the pre-filter as further unknowns. fewer: what to ask less of where
    there are more unknowns than an estimator holds.
    """

    regularization: float
    pivot: float
    least_part: float
    spike: float
    rests: bool
    extended: bool
    fewer: str

    @abstractmethod
    def default_zeros(self, cutoff: float, memory: float, needed: int) -> tuple[float, ...]:
        """Pre-filter zeros [rad/s] where nothing is known of the plant; memory: of the estimator [s]."""

    @abstractmethod
    def candidate_zeros(self, cutoff: float, memory: float, needed: int) -> list[tuple[float, ...]]:
        """Sets of `needed` zeros [rad/s] that a record chooses from."""

    @abstractmethod
    def zeros_without_record(self, cutoff: float, memory: float, needed: int) -> tuple[float, ...]:
        """Zeros [rad/s] of an estimator that is made before there is a record to choose by."""

    @abstractmethod
    def another_guess(self, equation: Equation, cutoff: float) -> Floats | None:
        """theta (p,) to start from where least squares are too far off; None: there is no other."""

    @abstractmethod
    def made_up_counts(self, equation: Equation, u: Floats, dt: float, cutoff: float, resolution: float) -> Counts:
        """(n,) of some plant of this kind that suits dt, cutoff and resolution, for an input u (n,) of up to one."""


@dataclass(frozen=True)
class MachineDefaults(PlantDefaults):
    """Defaults for a machine with friction: position and direction matter, and so does every interval that moves only
    partly."""

    regularization: float = 1e-4  # P stays below 1e4 times its best
    pivot: float = TUNING.start_pivot
    least_part: float = TUNING.start_pivot
    spike: float = 8.0
    rests: bool = True
    extended: bool = True
    fewer: str = "unknown terms"

    def default_zeros(self, cutoff: float, memory: float, needed: int) -> tuple[float, ...]:
        return default_zeros(cutoff, memory)[:needed]

    def candidate_zeros(self, cutoff: float, memory: float, needed: int) -> list[tuple[float, ...]]:
        return [
            limit_zeros(cutoff * part, cutoff * part / TUNING.plants_ratio, memory)[:needed]
            for part in TUNING.plants_fractions
        ]

    def zeros_without_record(self, cutoff: float, memory: float, needed: int) -> tuple[float, ...]:
        return self.default_zeros(cutoff, memory, needed)

    def another_guess(self, equation: Equation, cutoff: float) -> None:
        return None

    def made_up_counts(self, equation: Equation, u: Floats, dt: float, cutoff: float, resolution: float) -> Counts:
        from pmfid._kernel64 import simulate

        gain, full_speed = equation.input_gain, TUNING.counts_per_sample * resolution / dt
        viscous, coulomb = TUNING.viscous_part * abs(gain) / full_speed, TUNING.coulomb_part * abs(gain)
        mass = viscous * 2 / cutoff
        velocity, *_ = simulate([mass, viscous, viscous, coulomb, coulomb, 0.0, 0.0], gain, dt, u)
        position = np.concatenate([[0.0], np.cumsum(np.asarray(velocity)[:-1])]) * dt
        return np.asarray(np.floor(position / resolution).astype(np.int64) - 100)


@dataclass(frozen=True)
class LinearProcess(PlantDefaults):
    """A transfer function, where rest means nothing and counts are a reading.

    Its columns may nearly follow from each other: the third derivative of a lightly damped mode is hardly more than a
    multiple of y'. And it answers late, so that a spike must be larger to be one.
    """

    regularization: float = 1e-7
    pivot: float = 1e-7
    least_part: float = 1e-12
    spike: float = 100.0
    rests: bool = False
    extended: bool = False
    fewer: str = "poles (n), zeros (m) or extras, or srivc on whole records"

    def default_zeros(self, cutoff: float, memory: float, needed: int) -> tuple[float, ...]:
        return process_zeros(cutoff, needed)

    def candidate_zeros(self, cutoff: float, memory: float, needed: int) -> list[tuple[float, ...]]:
        ratios = TUNING.process_ratios if needed > 1 else TUNING.process_ratios[:1]
        return [
            tuple(-cutoff * part * float(step) for step in np.geomspace(1, 1 / ratio, needed))
            for part in TUNING.process_fractions
            for ratio in ratios
        ]

    def zeros_without_record(self, cutoff: float, memory: float, needed: int) -> tuple[float, ...]:
        return self.candidate_zeros(cutoff, memory, needed)[0]

    def another_guess(self, equation: Equation, cutoff: float) -> Floats:
        """All poles at the cutoff, and no input."""
        A = np.poly(np.full(equation.order, -cutoff))[::-1]
        outputs = [term.signal == "process_output" for term in equation.unknown]
        return np.array([A[t.derivative] if own else 0.0 for t, own in zip(equation.unknown, outputs, strict=True)])

    def made_up_counts(self, equation: Equation, u: Floats, dt: float, cutoff: float, resolution: float) -> Counts:
        """Counts of lags in series; some hundred of them."""
        y, states, part = [], [0.0] * equation.order, min(0.5, cutoff * dt / 2)
        for value in u.tolist():
            y.append(states[-1])
            for i, source in enumerate([value, *states[:-1]]):
                states[i] += part * (source - states[i])
        return np.asarray(np.floor(TUNING.process_counts * np.asarray(y)).astype(np.int64))


MACHINE, LINEAR_PROCESS = MachineDefaults(), LinearProcess()


def plant_of(equation: Equation) -> PlantDefaults:
    """The defaults of the kind of plant that an equation describes; no other place decides this."""
    return LINEAR_PROCESS if equation.process else MACHINE


def default_zeros(cutoff: float, memory: float = math.inf) -> tuple[float, float]:
    """Pre-filter zeros where nothing is known of the plant: a tenth of the cutoff, and a thirtieth of that.

    The compensation is an instrumental variable method with s u/f and s^2 u/f for instruments. They resemble the
    drive's velocity and acceleration most for zeros at its own poles, 0 and -d/m; with one slow zero the other may
    lie anywhere near or above d/m.
    memory: of the estimator [s], see `limit_zeros`.
    """
    return limit_zeros(cutoff / 10, cutoff / 300, memory)


def limit_zeros(fast: float, slow: float, memory: float) -> tuple[float, float]:
    """Two pre-filter zeros [rad/s] from their sizes, fit for an estimator with this memory [s].

    A slow zero is a filter that remembers the input: where it did so for longer than a part of the memory, the
    instruments after a large motion would be what is left of it, and weak. So it is faster then, but not as fast as
    the other: too much alike, both would say the same.
    """
    return (-fast, -min(max(slow, TUNING.zero_memories / memory), max(slow, fast / TUNING.plants_apart)))


def process_zeros(cutoff: float, n: int) -> tuple[float, ...]:
    """Pre-filter zeros for an unknown linear process: n, evenly in the logarithm from half the cutoff
    down to a twentieth of it."""
    spread = np.geomspace(0.5, 0.05, n) if n > 1 else np.array([0.2])
    return tuple(-cutoff * float(part) for part in spread)

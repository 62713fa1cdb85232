"""Motions of a machine with known parameters, each from the start state that its first observations show."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from pmfid.fit.likelihood import Gaussian
from pmfid.fit.machine import (
    DELAY,
    LAGGING,
    LOAD_MASS,
    LOAD_VISCOUS,
    MASS,
    STIFFNESS,
    VISCOUS,
    BodyModel,
    Excitation,
    machine_of,
    simulate,
)
from pmfid.fit.problem import PARTS, FitProblem, ObservedStretch, ResidualBlock
from pmfid.fit.search import EXPLAINED, GAIN, MOST_SQUARES
from pmfid.fit.solve import solve
from pmfid.fit.within import reach_counts, start_precision
from pmfid.models.equation import Equation
from pmfid.types import Floats


class KnownProblem(FitProblem):
    """A problem with known parameters. Only its start states are unknown."""

    def linearise(self, q: Floats, starts: Floats) -> list[ResidualBlock]:
        return [replace(block, J=np.zeros_like(block.J)) for block in super().linearise(q, starts)]


@dataclass(frozen=True, eq=False)
class FreeMotion:
    """A machine at parameters theta (p,), simulated from the input alone.

    The `first` observations determine the start, and then twice as many as long as the motion explains them, up to
    `read`. They come after the time `lead` [s] whose force depends on an unknown earlier input. `step` is the mean time
    between observations [s]. `resolution` is the travel of a count.
    """

    machine: BodyModel
    theta: Floats
    resolution: float
    read: int
    lead: float
    step: float
    first: ClassVar[int] = 20

    @classmethod
    def make(cls, problem: FitProblem, theta: Floats) -> FreeMotion:
        """Return the motion of a problem's machine at theta (p,).

        N counts over a time T show a velocity to a count over T sqrt(N). An error of the velocity moves the axis for
        its time constant, mass over viscous friction, or to the end of the motion. The start is read until this error
        is below a tenth of a count, and over two periods of a second mass.
        """
        body = problem.machine.body(theta)
        mass, viscous, period = float(body[MASS]), float(body[VISCOUS]), 0.0
        if problem.machine.elastic:
            period = 2 * math.pi * math.sqrt(1 / (1 / mass + 1 / body[LOAD_MASS]) / body[STIFFNESS])
            mass, viscous = mass + float(body[LOAD_MASS]), viscous + float(body[LOAD_VISCOUS])
        times = [float(np.sum(one.drive.step)) for one in problem.stretches]
        step = sum(times) / problem.rows
        lasting = min(max(times), mass / max(viscous, 1e-300)) / step
        read = max(cls.first, math.ceil((10 * lasting) ** (2 / 3)), math.ceil(2 * period / step))
        lead = float(body[DELAY] + 5 * body[LAGGING])  # exp(-5) is below 1 %
        return cls(problem.machine, theta, problem.resolution, read, lead, step)

    @property
    def reads(self) -> float:
        """Time from the start of a stretch whose observations are used [s]."""
        return self.lead + self.read * self.step

    def simulate(self, stretch: ObservedStretch, start: Floats | None = None) -> tuple[Floats, Floats]:
        """Return positions and velocities (k,) at the observations of a stretch [unit, unit/s].

        `start` (1, s) is that of `find_start`, which is the default.
        """
        problem = self._make_problem(stretch)
        start = self.find_start(stretch) if start is None else start
        (motion,) = problem.motion(problem.start(self.theta), start / _units(problem))
        return motion

    def find_start(self, stretch: ObservedStretch) -> Floats:
        """Return the most likely start (1, s) of a stretch: position from the first one [counts], speed [counts/s], and
        those of a second mass relative to the first."""
        size = self.first
        problem = self._make_problem(self._begin(stretch, size))
        starts = self._try_speeds(problem)
        while _explains(problem, self.theta, starts) and size < min(self.read, stretch.y.size):
            size = min(2 * size, self.read)
            longer = self._make_problem(self._begin(stretch, size))
            start = starts * _units(problem) / _units(longer)
            start = _solve(longer, self.theta, start)
            if not _explains(longer, self.theta, start):
                break
            problem, starts = longer, start
        precision = np.append(np.ones(problem.size), start_precision(starts))
        inside = reach_counts(problem, problem.start(self.theta), starts, precision, EXPLAINED)
        starts = (starts if inside is None else inside[1]) * _units(problem)
        away = (problem.stretches[0].y[0] - stretch.y[0]) / self.resolution
        starts[0, 0] += away
        return np.asarray(starts)

    def _make_problem(self, stretch: ObservedStretch) -> KnownProblem:
        return KnownProblem(self.machine, (stretch,), self.resolution)

    def _begin(self, stretch: ObservedStretch, size: int) -> ObservedStretch:
        """Return the first observations of a stretch, without those that an unknown earlier input moves."""
        row = stretch.drive.row
        times = stretch.times if self.lead else row
        skipped = int(np.searchsorted(times, times[0] + self.lead))
        last = min(skipped + size, row.size)
        early = stretch.part(0, max(int(row[last - 1]), 1))
        kept = np.arange(early.y.size) >= skipped
        return early.keep(kept) if np.count_nonzero(kept) > 2 else early

    def _try_speeds(self, problem: KnownProblem) -> Floats:
        """Return the start (1, s) of least squares, from the speeds that the counts show and from standstill.

        A search from standstill does not leave stiction, and one from a wrong speed may end in it.
        """
        (early,) = problem.stretches
        whole = float((early.y[-1] - early.y[0]) / self.resolution / (early.y.size - 1))
        speeds = dict.fromkeys((float(problem.first_starts()[0, 1]), whole, 0.0))
        soft, q = Gaussian(problem.stretches), problem.start(self.theta)
        still = [0.0] * (len(self.machine.starts) - 2)
        first = min(speeds, key=lambda v: soft(problem.linearise(q, np.array([[0.0, v, *still]])))[0])
        return _solve(problem, self.theta, np.array([[0.0, first, *still]]))


def _units(problem: KnownProblem) -> Floats:
    """Return the units (s,) of a start state [counts, counts/s]."""
    return np.resize([1.0, next(problem.scales())], len(problem.machine.starts))


def _solve(problem: KnownProblem, theta: Floats, starts: Floats) -> Floats:
    """Return the start (1, s) of least squares."""
    likelihood = Gaussian(problem.stretches)
    return solve(problem, likelihood, problem.start(theta), starts, np.zeros(problem.size), small=GAIN).starts


def _explains(problem: KnownProblem, theta: Floats, starts: Floats) -> bool:
    """Return whether a motion is so near the counts that one next to it may explain every count."""
    return float(np.mean(problem.residuals(problem.start(theta), starts)[0] ** 2)) < MOST_SQUARES


def simulate_from_rest(equation: Equation, theta: Floats, u: Floats, dt: float | Floats) -> Floats:
    """Return the positions (n + 1,) from rest at zero at the parameters theta (p,), under an input u (n,) that is held
    over each dt [s], a number or (n,). Raises UsageError for an equation that no body simulates."""
    machine, row = machine_of(equation), np.arange(u.size + 1, dtype=np.int32)
    steps = np.array(np.broadcast_to(dt, u.shape), np.float64)
    drive = Excitation(steps, np.ascontiguousarray(u * equation.input_gain), row, np.zeros((0, u.size)))
    body = machine.body(theta)
    return simulate(drive, machine.forces, body, PARTS, elastic=machine.elastic, load=machine.load)[0]

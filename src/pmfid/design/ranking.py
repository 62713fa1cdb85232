"""Inputs for drives that no linear equation describes: two masses, springs, dead times, lags and further forces.

The body of the fit gives the motion and its derivatives for any input. Standard inputs are ranked, and the best one is
improved by exchanges of its values (after Fedorov 1972). No bound of the optimum is proved.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from pmfid.design.ascent import ASCENT_TOLERANCE
from pmfid.design.body import BodyMotion, prior_of, simulate
from pmfid.design.fisher import Criterion, criterion_of, eliminate
from pmfid.design.problem import Design, InfeasibleError, Problem
from pmfid.design.solver import Progress
from pmfid.design.standard import standard_signals
from pmfid.errors import UsageError
from pmfid.types import Floats

#: Parts of the limit of the input that a standard input tries.
RANKING_SIZES = (1.0, 0.7, 0.5, 0.35, 0.25, 0.17, 0.12, 0.08)


def rank(
    problem: Problem, criterion: str = "D", *, sweeps: int = 5, seed: int = 0, progress: Progress | None = None
) -> dict[str, Design]:
    """Rank the standard inputs within the limits, and improve the best one.

    Parameters
    ----------
    problem
        Equation, parameters and limits, among them one of the input. The axis starts at rest, and the end is free.
    criterion
        Name of the criterion: "trace", "D", "A", "E", "ME" or "c".
    sweeps
        Largest number of passes over the values of the input. Each pass tries to exchange each value.
    seed
        Seed of the random inputs and exchanges.
    progress
        Function that is called after each pass.

    Returns
    -------
    dict of str to Design
        The improved input "design", and then the standard inputs, the best one first. The deviations are those of least
        squares, and a fit that explains each count reaches smaller ones.

    Raises
    ------
    UsageError
        If an argument is wrong, or if the problem has limits that only a drive with mass and friction knows.
    InfeasibleError
        If no standard input moves the axis within the limits.

    Examples
    --------
    >>> from pmfid import Drive
    >>> from pmfid.design import Limits, Problem, rank
    >>> nominal = {"motor_mass": 1.0, "viscous_friction": 1.0, "coulomb_friction": 0.5, "load_mass": 2.0}
    >>> nominal |= {"load_viscous_friction": 1.0, "load_coulomb_friction": 0.5, "stiffness": 4e3, "damping": 2.0}
    >>> belt, unknown = Drive(1.0, body="two-mass"), ("load_mass", "stiffness")
    >>> designs = rank(Problem(belt, nominal, unknown, 2.0, 100, Limits(input=30.0), resolution=1e-5), sweeps=1)
    >>> list(designs)[0], designs["design"].predicted_std["stiffness"] < 40.0
    ('design', True)
    """
    _check_free(problem)
    judge, rng = _Judge(problem, criterion_of(problem, criterion)), np.random.default_rng(seed)
    inputs = dict(_standard_inputs(judge, rng))
    if not inputs:
        raise InfeasibleError("no standard input moves the axis within the limits; widen the limits")
    order = sorted(inputs, key=lambda name: -judge.value(inputs[name]))
    best = judge.improve(inputs[order[0]], rng, sweeps, progress)
    return {"design": judge.design(best)} | {name: judge.design(inputs[name]) for name in order}


def find_hidden(designs: Mapping[str, Design]) -> tuple[str, ...]:
    """Return the unknown parameters whose deviation exceeds their value after every input."""
    problem = designs["design"].problem
    least = {name: min(one.predicted_std[name] for one in designs.values()) for name in problem.unknown}
    return tuple(name for name, std in least.items() if not std < abs(problem.nominal[name]))


def _check_free(problem: Problem) -> None:
    """Raise UsageError if a problem has parts that only the linear design knows."""
    limits = problem.limits
    wanted = {
        "end of the motion": problem.end != (None, None),
        "directions": bool(problem.directions),
        "section robust": bool(problem.scenarios),
        "least speed, jerk or start velocity": bool(limits.min_speed or limits.jerk or problem.start[1]),
    }
    for what, given in wanted.items():
        if given:
            raise UsageError(f"the design for this drive knows no {what}; leave it out")
    if limits.input is None:
        raise UsageError("the design for this drive needs a limit of the input; give limits.input")


@dataclass(frozen=True, eq=False)
class _Judge:
    """The value of an input for a problem, by the motion of its body."""

    problem: Problem
    rule: Criterion

    @property
    def bounds(self) -> tuple[float, float]:
        return self.problem.limits.pair("input") or (-1.0, 1.0)

    def information(self, motion: BodyMotion) -> Floats:
        """Return the information (p, p) on the scaled parameters with the prior, for an unknown start position."""
        scale = self.problem.scale
        slopes = (motion.slopes - motion.slopes.mean(axis=0)) * scale
        prior = prior_of(self.problem, self.problem.names) * np.outer(scale, scale)
        return np.asarray(slopes.T @ slopes / self.problem.variance + prior)

    def value(self, u: Floats) -> float:
        """Return the logarithm of the criterion, or minus infinity beyond the limits."""
        limits, dt = self.problem.limits, self.problem.dt
        energy = min(limits.energy or math.inf, (limits.rms or math.inf) ** 2 * self.problem.horizon)
        steep = np.max(np.abs(np.diff(u, prepend=0.0))) > (limits.input_rate or math.inf) * dt
        motion = simulate(self.problem, u)
        signals = {"position": motion.x, "velocity": motion.v, "acceleration": np.diff(motion.v) / motion.t[1]}
        pairs = ((signal, limits.pair(name) or (-math.inf, math.inf)) for name, signal in signals.items())
        within = all(np.all((signal >= low) & (signal <= high)) for signal, (low, high) in pairs)
        if steep or u @ u * dt > energy or not within or not np.any(motion.v):
            return -math.inf
        return float(self.rule.log_value(self.information(motion)))

    def improve(self, u: Floats, rng: np.random.Generator, sweeps: int, progress: Progress | None) -> Floats:
        """Return a better input by exchanges of values, or the input itself."""
        best = self.value(u)
        for sweep in range(sweeps):
            before = best
            for k in rng.permutation(u.size).tolist():
                for tried in self._exchanges(u, k, int(rng.integers(u.size))):
                    value = self.value(tried)
                    if value > best:
                        best, u = value, tried
            if progress:
                progress(sweep + 1, sweeps, math.exp(best))
            if best - before < ASCENT_TOLERANCE:
                break
        return u

    def _exchanges(self, u: Floats, k: int, other: int) -> Iterator[Floats]:
        """Yield inputs (K,) whose value at place k is the lowest or the highest one, or changes places with another."""
        for value in self.bounds:
            yield np.where(np.arange(u.size) == k, value, u)
        for place in (other, (k + 1) % u.size):
            tried = u.copy()
            tried[[k, place]] = u[[place, k]]
            yield tried

    def design(self, u: Floats) -> Design:
        """Return the motion and information of an input."""
        problem, motion = self.problem, simulate(self.problem, u)
        nodes, F = slice(None, None, problem.samples_per_interval), self.information(motion)
        fisher = eliminate(F / np.outer(problem.scale, problem.scale), self.rule.size)[0]
        return Design(
            problem, self.rule.name, problem.t, u, motion.x[nodes], motion.v[nodes], fisher, self.rule.value(F)
        )


def _standard_inputs(judge: _Judge, rng: np.random.Generator) -> Iterator[tuple[str, Floats]]:
    """Yield name and values (K,) of each standard input, as large as the limits allow."""
    low, high = judge.bounds
    for name, signal in standard_signals(judge.problem, rng):
        whole = (high + low) / 2 + (high - low) / 2 * signal
        for size in RANKING_SIZES:
            if math.isfinite(judge.value(size * whole)):
                yield name, size * whole
                break

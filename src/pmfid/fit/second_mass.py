"""The trial of a second mass, on a spring or across a gap, where a rigid axis does not explain the record."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pmfid.errors import NotIdentifiableError
from pmfid.fit.compare import ODDS
from pmfid.fit.driven import find_shaken_part
from pmfid.fit.elastic import ROWS, elastic_start, explains_all, play_start, resonance_of
from pmfid.fit.likelihood import noise_of
from pmfid.fit.machine import COULOMB, LOAD_COULOMB, LOAD_MASS, LOAD_VISCOUS, MASS, STIFFNESS, VISCOUS
from pmfid.fit.problem import FitProblem, ObservedStretch
from pmfid.fit.release import rounding_of
from pmfid.fit.shooting import settle
from pmfid.fit.solve import Optimum, inverse
from pmfid.fit.tuning import TUNING
from pmfid.types import Floats

#: Parameters of one mass, and those of the load that add to them.
SUMS = ((MASS, LOAD_MASS), (VISCOUS, LOAD_VISCOUS), (COULOMB, LOAD_COULOMB))


@dataclass(frozen=True)
class SecondMass:
    """Two masses that explain a record better than one: resonance [Hz], sums of the masses and of viscous and Coulomb
    friction, by the place among the body's parameters, and the log odds.

    Masses with play have the gap `play` and its standard error in place of a resonance.
    """

    resonance: float
    sums: Mapping[int, float]
    odds: float
    play: tuple[float, float] | None = None

    @property
    def change(self) -> dict[str, object]:
        """The keys of [model] that add the second mass."""
        return {"body": "two-mass"} | ({} if self.play is None else {"play": True})

    @property
    def remedy(self) -> str:
        also = "" if self.play is None else " and play = true"
        return f'set body = "two-mass"{also} in [model]'

    def describe(self, unit: str) -> str:
        """Return the second mass in words. `unit` is that of the travel."""
        if self.play is None:
            return f"a second mass on a spring, with a resonance at {self.resonance:.3g} Hz,"
        return f"a second mass across a gap of {self.play[0]:.3g} ± {self.play[1]:.2g} {unit}"


@dataclass(frozen=True, eq=False)
class FollowedPair:
    """A fit of two masses that explains every count of a part of a record. `whole` is True if the fit explains every
    count of the longest stretch."""

    problem: FitProblem
    end: Optimum
    whole: bool


@dataclass(frozen=True, eq=False)
class PairTrial:
    """The search for two masses in a `record`, which is the problem of one mass without candidates."""

    record: FitProblem

    @cached_property
    def pair(self) -> FollowedPair | None:
        """The two masses, or None if no pair explains every count of the part with the largest accelerations."""
        longest, part = _longest_and_shaken(self.record)
        with np.errstate(all="ignore"):
            pair = _explain(self.record, part, lambda plain: elastic_start(plain, True, longest))
            if pair is None:
                return None
            problem, end = pair
            whole = part is longest or explains_all(replace(problem, stretches=(longest,)), end.q)
        return FollowedPair(problem, end, whole)

    @property
    def play(self) -> tuple[FitProblem, Optimum] | None:
        """The fit of two masses with play to that part, or None if it leaves more than rounding."""
        with np.errstate(all="ignore"):
            return _explain(self.record, _longest_and_shaken(self.record)[1], _play)

    @property
    def explains(self) -> bool:
        """Whether two masses explain every count of the longest stretch."""
        return self.pair is not None and self.pair.whole


def try_second_mass(problem: FitProblem, q: Floats, trial: PairTrial) -> SecondMass | None:
    """Return the second mass if two masses explain every count of a part of the record, and one mass with the
    parameters q (p,) of a `problem` does not.

    Both models have the same part of the record, free start states, and noise of their own. Two masses that leave more
    than rounding may only imitate another force.
    """
    _, part = _longest_and_shaken(problem)
    one = _fit_one_mass(problem, q, part)
    if one[1].cost < rounding_of(one[0]):
        return None
    pair = trial.play if trial.pair is None else (trial.pair.problem, trial.pair.end)
    if pair is None:
        return None
    two = replace(pair[0], stretches=(part,)), pair[1]
    odds = _evidence(*two) - _evidence(*one) + ODDS
    odds -= 0.5 * (TUNING.further + pair[0].machine.plays) * math.log(part.y.size)
    return _read(*pair, odds) if odds > 0 else None


def find_second_mass(problem: FitProblem) -> SecondMass | None:
    """Return the second mass of a record that no motion of one mass follows, if that of two masses explains every
    count."""
    longest, part = _longest_and_shaken(problem)
    pair = _explain(problem, part, lambda plain: elastic_start(plain, guide=longest)) or _explain(problem, part, _play)
    return None if pair is None else _read(*pair, math.inf)


def _longest_and_shaken(problem: FitProblem) -> tuple[ObservedStretch, ObservedStretch]:
    """Return the longest stretch, and the part of it with the largest accelerations."""
    stretch = max(problem.stretches, key=lambda one: one.y.size)
    return stretch, find_shaken_part(stretch, problem.resolution)


def _play(problem: FitProblem) -> tuple[FitProblem, Optimum]:
    return play_start(problem, trial=True)


def _explain(
    problem: FitProblem, part: ObservedStretch, start: Callable[[FitProblem], tuple[FitProblem, Optimum]]
) -> tuple[FitProblem, Optimum] | None:
    """Return the fit of two masses to a part of the record by a start, or None if it leaves more than rounding."""
    if part.y.size < TUNING.fewest:
        return None
    with suppress(NotIdentifiableError):
        pair, end = start(replace(problem, stretches=(part,), candidates=()))
        if end.cost < rounding_of(pair):
            return pair, end
    return None


def _read(pair: FitProblem, end: Optimum, odds: float) -> SecondMass | None:
    """Return the second mass of a fit, or None if the record shows no resonance and no gap."""
    std = np.sqrt(np.diag(inverse(end.normal.A)))
    theta, masses, stiffness = pair.theta(end.q), [ROWS.index(MASS), ROWS.index(LOAD_MASS)], ROWS.index(STIFFNESS)
    sums = {row: float(theta[ROWS.index(row)] + theta[ROWS.index(load)]) for row, load in SUMS}
    if not np.all(std[masses] < TUNING.vague):
        return None
    if pair.machine.plays and std[len(ROWS)] < TUNING.vague * theta[len(ROWS)]:
        return SecondMass(math.inf, sums, odds, (float(theta[len(ROWS)]), float(std[len(ROWS)])))
    return SecondMass(resonance_of(theta) / (2 * math.pi), sums, odds) if std[stiffness] < TUNING.vague else None


def _fit_one_mass(problem: FitProblem, q: Floats, part: ObservedStretch) -> tuple[FitProblem, Optimum]:
    """Return the fit of one mass and its forces to a part of the record, from parameters q (p,)."""
    problem = replace(problem, stretches=(part,))
    prior = np.isin(range(q.size), problem.places).astype(np.float64)
    return problem, settle(problem, q, problem.first_starts(), prior, 15)


def _evidence(problem: FitProblem, end: Optimum) -> float:
    """Return the log likelihood of the residuals in their most likely noise."""
    errors = problem.residuals(end.q, end.starts)
    return noise_of(problem.stretches, errors, 0.0).evidence(errors)[0]

"""The trial of a second mass, on a spring or across a gap, where a rigid axis does not explain the record."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pmfid.errors import NotIdentifiableError
from pmfid.fit.build import PIECES
from pmfid.fit.compare import ODDS
from pmfid.fit.driven import find_shaken_part
from pmfid.fit.elastic import ROWS, follow_guesses, play_start, prior_of, resonance_of
from pmfid.fit.likelihood import Gaussian, noise_of
from pmfid.fit.machine import COULOMB, LOAD_COULOMB, LOAD_MASS, LOAD_VISCOUS, MASS, STIFFNESS, VISCOUS
from pmfid.fit.problem import FitProblem, ObservedStretch
from pmfid.fit.release import follow, rounding_of
from pmfid.fit.search import ROUNDS
from pmfid.fit.shooting import settle
from pmfid.fit.solve import Optimum, inverse, solve
from pmfid.fit.tuning import TUNING
from pmfid.types import Floats

#: Parameters of one mass, and those of the load that add to them.
SUMS = ((MASS, LOAD_MASS), (VISCOUS, LOAD_VISCOUS), (COULOMB, LOAD_COULOMB))


@dataclass(frozen=True)
class SecondMass:
    """Two masses that explain a record better than one: sums of the masses and of viscous and Coulomb friction, by the
    place among the body's parameters, and the log odds.

    Masses on a spring have a `resonance` [Hz] if they explain every count, because other masses show it only roughly.
    Masses with play have the gap `play` and its standard error.
    """

    sums: Mapping[int, float]
    odds: float
    resonance: float | None = None
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
        if self.play is not None:
            return f"a second mass across a gap of {self.play[0]:.3g} ± {self.play[1]:.2g} {unit}"
        shown = f", with a resonance at {self.resonance:.3g} Hz," if self.resonance else ""
        return f"a second mass on a spring{shown}"


@dataclass(frozen=True, eq=False)
class FollowedPair:
    """A fit of two masses to a part of a record."""

    problem: FitProblem
    end: Optimum

    @property
    def explained(self) -> bool:
        """Whether the fit explains every count of that part."""
        return self.end.cost < rounding_of(self.problem)


@dataclass(frozen=True, eq=False)
class PairTrial:
    """The search for two masses in a `record`, which is the problem of one mass without candidates."""

    record: FitProblem

    @property
    def longest(self) -> ObservedStretch:
        """The longest stretch."""
        return max(self.record.stretches, key=lambda stretch: stretch.y.size)

    @cached_property
    def part(self) -> ObservedStretch:
        """The part of the longest stretch with the largest accelerations."""
        return find_shaken_part(self.longest, self.record.resolution)

    @cached_property
    def spring(self) -> FollowedPair | None:
        """The two masses on a spring by that part, or None if nothing suggests them."""
        if self.part.y.size < TUNING.fewest:
            return None
        with suppress(NotIdentifiableError), np.errstate(all="ignore"):
            pair, _, ends = follow_guesses(replace(self.record, stretches=(self.part,)), self.longest)
            return FollowedPair(pair, min(ends, key=lambda end: end.cost)) if ends else None
        return None

    @cached_property
    def explains(self) -> bool:
        """Whether two masses on a spring explain every count of the longest stretch."""
        if self.spring is None or not self.spring.explained or self.part is self.longest:
            return self.spring is not None and self.spring.explained
        whole = replace(self.spring.problem, stretches=(self.longest,))
        return follow(whole, [self.spring.end.q], prior_of(whole)).cost < rounding_of(whole)

    @property
    def likeliest(self) -> FollowedPair | None:
        """The two masses on a spring, or those with play if they alone explain every count of the part. Masses with
        play that leave more may imitate another force."""
        if self.part.y.size < TUNING.fewest or (self.spring is not None and self.spring.explained):
            return self.spring
        with suppress(NotIdentifiableError), np.errstate(all="ignore"):
            play = FollowedPair(*play_start(replace(self.record, stretches=(self.part,)), trial=True))
            return play if play.explained else self.spring
        return self.spring


def try_second_mass(problem: FitProblem, q: Floats, trial: PairTrial) -> SecondMass | None:
    """Return the second mass if two masses are likelier on a part of the record than one mass with the forces of a
    `problem`, from its parameters q (p,).

    Both models have the same part of the record, free start states, and noise of their own. Where two masses do not
    explain every count either, both are wrong, and the gain of likelihood is no surer than its scatter over pieces of
    the record shows (Vuong 1989).
    """
    part = PairTrial(problem).part  # with the columns of the forces
    one = _fit_one_mass(problem, q, part)
    if one[1].cost < rounding_of(one[0]):
        return None
    pair = trial.likeliest
    return None if pair is None else _read(pair, _weigh(pair, part, _likelihoods(*one)))


def find_second_mass(problem: FitProblem) -> SecondMass | None:
    """Return the second mass of a record that no motion of one mass follows, if two masses explain every count, or are
    likelier than an axis at rest with a disturbance."""
    pair, part = (trial := PairTrial(problem)).likeliest, trial.part
    if pair is None:
        return None
    still = (part.y[0] - part.y) / problem.resolution
    return _read(pair, _weigh(pair, part, _split(part, still, noise_of((part,), [still], 0.0))))


def _read(followed: FollowedPair, odds: float) -> SecondMass | None:
    """Return the second mass of a fit, or None if it has no odds, or if the record shows no resonance and no gap."""
    pair, end = followed.problem, followed.end
    std = np.sqrt(np.diag(inverse(end.normal.A)))
    theta, masses, stiffness = pair.theta(end.q), [ROWS.index(MASS), ROWS.index(LOAD_MASS)], ROWS.index(STIFFNESS)
    sums = {row: float(theta[ROWS.index(row)] + theta[ROWS.index(load)]) for row, load in SUMS}
    if not (odds > 0 and np.all(std[masses] < TUNING.vague)):
        return None
    if pair.machine.plays and std[len(ROWS)] < TUNING.vague * theta[len(ROWS)]:
        return SecondMass(sums, odds, play=(float(theta[len(ROWS)]), float(std[len(ROWS)])))
    if std[stiffness] < TUNING.vague:
        return SecondMass(sums, odds, resonance_of(theta) / (2 * math.pi) if followed.explained else None)
    return None


def _fit_one_mass(problem: FitProblem, q: Floats, part: ObservedStretch) -> tuple[FitProblem, Optimum]:
    """Return the fit of one mass and its forces to a part of the record, from parameters q (p,)."""
    problem = replace(problem, stretches=(part,))
    prior = np.isin(range(q.size), problem.places).astype(np.float64)
    return problem, settle(problem, q, problem.first_starts(), prior, 15)


def _weigh(pair: FollowedPair, part: ObservedStretch, other: Floats) -> float:
    """Return the log odds of two masses to another model with log likelihoods of pieces (PIECES,)."""
    gains = _likelihoods(replace(pair.problem, stretches=(part,)), pair.end) - other
    odds = float(np.sum(gains))
    if not pair.explained:
        odds = min(odds, 0.5 * odds * abs(odds) / (PIECES * float(np.var(gains, ddof=1))))
    return odds + ODDS - 0.5 * (TUNING.further + pair.problem.machine.plays) * math.log(part.y.size)


def _likelihoods(problem: FitProblem, end: Optimum) -> Floats:
    """Return the log likelihoods of pieces (PIECES,) in the most likely noise, at the optimum in that noise."""
    prior = np.isin(range(end.q.size), problem.places).astype(np.float64)
    for _ in range(ROUNDS):
        noise = noise_of(problem.stretches, problem.residuals(end.q, end.starts), 0.0)
        end = solve(problem, noise, end.q, end.starts, prior, 10)
    return _split(problem.stretches[0], problem.residuals(end.q, end.starts)[0], noise)


def _split(stretch: ObservedStretch, errors: Floats, noise: Gaussian) -> Floats:
    """Return what each piece of a stretch adds (PIECES,) to the log likelihood of residuals (k,)."""
    beginnings = [stretch.part(0, stretch.drive.u.size * k // PIECES) for k in range(1, PIECES + 1)]
    values = [replace(noise, stretches=(one,)).evidence([errors[: one.y.size]])[0] for one in beginnings]
    return np.diff(values, prepend=0.0)

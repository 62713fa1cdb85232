"""The search for the forces that explain a record: blind start, comparison of forces, noise, and explained counts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from pmfid.errors import NotIdentifiableError
from pmfid.fit.compare import ODDS, Quadratic
from pmfid.fit.elastic import elastic_start, play_start
from pmfid.fit.likelihood import ROUNDING, Gaussian, Intervals, noise_of
from pmfid.fit.machine import COULOMB, DELAY, DIRECTIONAL, LAGGING, MASS, OFFSET, VISCOUS, BodyForce, BodyModel
from pmfid.fit.problem import FitProblem
from pmfid.fit.solve import Likelihood, Optimum, inverse, normal_of, random_step, solve
from pmfid.fit.starts import blind_start, sizes_of
from pmfid.fit.terms import TABLE, WAVES, ExtraForce, Sizes, free_constants, waves
from pmfid.fit.tuning import MOTION
from pmfid.fit.within import reach_counts, start_precision
from pmfid.types import Floats

#: Spreads of a white error in addition to rounding [counts], in falling order.
SPREADS = (0.3, 0.1, 0.03, 0.01, 0.003)
#: Spread down to which the intervals must narrow for the model to explain every count.
EXPLAINED = SPREADS[-1]
#: Mean square of residuals [counts^2] up to which a model may explain every count, tries to find that motion, and their
#: distance in standard errors of least squares.
MOST_SQUARES, TRIES, NEARBY = 0.15, 3, 2.0
#: Largest mean square of residuals within half a count [counts^2]. Least squares has no larger one.
WITHIN = 0.5**2
#: Kinds of a disturbance that wanders.
WANDERING = ("force", "position")
#: First size of a force that is never negative, in standard deviations of its prior.
FIRST = 0.3
#: Rounds of fit and noise, which settle in two to four.
ROUNDS = 5
#: Largest distance of the mass from the blind start, as a logarithm. A fit that goes further follows noise.
FAR = 3.0
#: Gain of log likelihood below which a step of the search ends: an eighth of a standard error. The conclusion goes on.
GAIN = 0.01
#: Advice if no motion follows.
FOLLOW = (
    "check input_gain, sign and scale of input and output, and [encoder] bits; an input that acts many samples late "
    'needs dead_time = "estimate"'
)
#: Start values of an unknown speed of Stribeck friction, as shares of the highest speed. The search ends in the
#: right optimum from starts up to four times above or below the true speed.
SPEEDS = (0.05, 0.2, 0.5)
#: Largest change of the mass between rounds that counts as settled, relative.
SETTLED = 1e-4


def candidates_of(machine: BodyModel, sizes: Sizes) -> list[ExtraForce]:
    """Return the rows of the table that the machine does not have already."""
    has = {row for row in (OFFSET, DIRECTIONAL, DELAY, LAGGING) if np.any(machine.lift[row] != 0)}
    kinds = {(force.kind, force.p if force.kind == "power" else 0.0) for force in machine.forces}
    rows = [one for row in TABLE for one in row(sizes)]
    if machine.elastic:
        kept = [one for one in rows if one.base != LAGGING and one.name != "spring"]
        rows = [placed for one in kept for placed in one.place_on_masses()]
    return [
        one
        for one in rows
        if one.base not in has
        and one.name not in machine.within
        and (one.force is None or (one.force.kind, one.force.p if one.force.kind == "power" else 0.0) not in kinds)
    ]


def with_columns(problem: FitProblem, candidates: Sequence[ExtraForce]) -> tuple[FitProblem, list[ExtraForce]]:
    """Return the problem with the candidates' columns, and the candidates with the numbers of their columns."""
    first = problem.stretches[0].drive.columns.shape[0]
    makers = [make for one in candidates for make in one.columns]
    u, t = (np.concatenate([getattr(one.drive, name) for one in problem.stretches]) for name in ("u", "step"))
    rows = np.array([make(u, np.cumsum(t)) for make in makers]).reshape(len(makers), u.size)
    ends = np.cumsum([one.drive.u.size for one in problem.stretches])[:-1]
    stretches = []
    for stretch, added in zip(problem.stretches, np.split(rows, ends, axis=1), strict=True):
        stretches.append(stretch.with_columns(added))
    numbers = first + np.cumsum([0, *(len(one.columns) for one in candidates)])
    placed = [one.place_column(int(number)) for one, number in zip(candidates, numbers, strict=False)]
    return replace(problem, stretches=tuple(stretches)), placed


def first_theta(machine: BodyModel, start: Floats, sizes: Sizes, share: float) -> Floats:
    """Return the machine's parameters (p,) at the blind start (mass, viscous, Coulomb, load), or at that of two masses.

    An unknown speed of Stribeck friction starts at a `share` of the highest speed.
    """
    body = np.zeros(len(machine.rest))
    if machine.elastic:
        body[: machine.base] = start
    else:
        body[[MASS, VISCOUS, COULOMB, OFFSET]] = start[:4]
        body[[DELAY, LAGGING]] = 0.5 * sizes.step
    for j, force in enumerate(machine.forces):
        body[machine.base + j] = 0.2 * sizes.coulomb if force.free else _first_size(force, start, sizes.turn)
    body[machine.base + len(machine.forces) :] = share * sizes.speed
    rows = np.any(machine.lift != 0, axis=1)
    return np.asarray(np.linalg.lstsq(machine.lift[rows], body[rows], rcond=None)[0])


def _first_size(force: BodyForce, start: Floats, turn: float) -> float:
    """Return the size of a force at the blind start. That of two masses has no force on the load."""
    if force.load:
        return 0.0
    if force.kind == "spring":
        return float(start[4])
    if force.kind == "wave" and turn and force.p == turn:
        return float(start[5 if force.q == 0 else 6])
    return 0.0


class FitSearch:
    """The state of a fit: the table of candidates, the chosen ones, the noise and the solution."""

    #: Kinds of disturbances that may wander.
    wandering: ClassVar[Sequence[str]] = WANDERING
    #: Effects that repeat along the travel and are sought, kinds of `WAVES`.
    waves: Sequence[str] = tuple(WAVES)

    def __init__(self, problem: FitProblem) -> None:
        machine = problem.machine
        start, solution = self.find_start(problem)
        self.sizes = sizes_of(problem, start, solution)
        self.columns = problem.stretches[0].drive.columns.shape[0]  # without those of the table
        self.plain, self.table = with_columns(problem, candidates_of(problem.machine, self.sizes))
        self.first, self.begin = start.theta(solution.q), problem.first_starts()
        logs = solution.q[start.machine.logs[:2]]  # of each mass
        if machine.elastic:
            self.first = start.machine.body(self.first)
        self.begin[[one is start.stretches[0] for one in problem.stretches]] = solution.starts[0]
        bounds = (float(np.min(logs)) - FAR, float(np.max(logs)) + FAR)
        self.plain = replace(self.plain, mass=bounds, rate=start.rate)
        self.spread = 0.0  # of the errors of the encoder's lines [counts]
        self.chosen: list[int] = []
        self.restart(self.chosen)

    def find_start(self, problem: FitProblem) -> tuple[FitProblem, Optimum]:
        """Return the first fit of a record, to its liveliest stretch."""
        machine = problem.machine
        if machine.elastic:
            return (play_start if machine.plays else elastic_start)(problem)
        return blind_start(problem.stretches, problem.resolution, machine.turn)

    def first_theta(self, share: float) -> Floats:
        """Return the machine's parameters (p,) at the first fit. `share` is that of `first_theta`."""
        return first_theta(self.plain.machine, self.first, self.sizes, share)

    @property
    def count(self) -> int:
        """Number of the machine's parameters, which stand before the candidates."""
        return len(self.plain.machine.names)

    def restart(self, chosen: Sequence[int], share: float = SPEEDS[0]) -> None:
        """Return to the blind start, with a set of candidates that may have the load of the start. `share` is that of
        `first_theta`."""
        self.chosen = list(chosen)
        self.problem = self._chosen_problem()
        self.q = self.problem.start(self.first_theta(share))
        self.starts = self.begin
        for k, candidate in self.problem.place_candidates():
            self.q[k] = self._first_size(candidate)
        self.noise = Gaussian(self.plain.stretches)

    def remember(self) -> dict[str, object]:
        """Return the state. A step of the search replaces its parts, and changes none of them."""
        return dict(vars(self))

    def return_to(self, state: dict[str, object]) -> None:
        """Return to a state of `remember`."""
        vars(self).update(state)

    def move_constants(self) -> None:
        """Move the constants of columns to their fitted values, about which the columns are linear."""
        table, places = list(self.table), list[int]()
        for i, (k, one) in zip(self.chosen, self.problem.place_candidates(), strict=True):
            if one.with_constant is not None:
                places += [k + 1] if one.free else []
                table[i] = one.with_constant(one.constant * float(self.q[places[-1]]))
        if not places:
            return
        own = (replace(one.drive, columns=one.drive.columns[: self.columns]) for one in self.plain.stretches)
        pairs = zip(self.plain.stretches, own, strict=True)
        bare = replace(self.plain, stretches=tuple(replace(one, drive=drive) for one, drive in pairs))
        self.plain, self.table = with_columns(bare, table)
        self.problem = replace(self._chosen_problem(), parts=self.problem.parts)
        self.q = self.q.copy()
        self.q[places] = 1.0

    def _first_size(self, candidate: ExtraForce) -> float:
        """Return the size of a candidate at the blind start, in standard deviations of its prior."""
        if candidate.base == OFFSET:
            return self._first_load() / candidate.sd
        if candidate.lowest == 0 or candidate.base == DELAY or candidate.free:  # at zero, it may look smaller than zero
            return FIRST
        force = candidate.force
        return 0.0 if force is None else _first_size(force, self.first, self.sizes.turn) / candidate.sd

    def _first_load(self) -> float:
        """Return the load at the blind start, whose spring acts from the first count on."""
        springs = [one.force for one in self.problem.candidates if one.force is not None and one.force.kind == "spring"]
        return float(self.first[3] + sum(self.first[4] * one.q for one in springs))

    def _chosen_problem(self) -> FitProblem:
        candidates = free_constants(self.table, self.chosen)
        return self.plain.with_candidates([candidates[i] for i in self.chosen])

    def prior(self, problem: FitProblem) -> Floats:
        """Return the prior precisions (p,): those of the machine, and 1 for the size of a candidate."""
        prior, precision = np.zeros(problem.size), problem.machine.precision
        if precision is not None:
            prior[: precision.size] = precision
        prior[problem.places] = 1.0
        return prior

    def solve(self, likelihood: Likelihood, steps: int = 30) -> Optimum:
        optimum = solve(self.problem, likelihood, self.q, self.starts, self.prior(self.problem), steps, GAIN)
        self.q, self.starts = optimum.q, optimum.starts
        return optimum

    def approach(self, steps: int) -> float:
        """Solve with forces of the position at the measured positions, and return the cost; infinite without any."""
        held = self.problem.hold_position()
        if held is self.problem:
            return math.inf
        optimum = solve(held, self.noise, self.q, self.starts, self.prior(held), steps, GAIN)
        self.q, self.starts = optimum.q, optimum.starts
        return optimum.cost

    def refine(self) -> None:
        """Double the parts of an interval until the error of the simulated motion moves no parameter by much of its
        standard error."""
        prior, left = np.diag(self.prior(self.problem)), math.sqrt(mean_square(self))
        blocks = self.problem.linearise(self.q, self.starts)
        while self.problem.integrates and self.problem.parts < MOTION.parts:
            finer = replace(self.problem, parts=2 * self.problem.parts)
            after = finer.linearise(self.q, self.starts)
            change = [replace(one, e=other.e - one.e) for one, other in zip(blocks, after, strict=True)]
            normal = normal_of(change, np.zeros_like(self.starts))
            if float(normal.g @ inverse(normal.A + prior) @ normal.g) < (MOTION.refined * left) ** 2:
                break
            self.problem, blocks = finer, after
        self.plain = replace(self.plain, parts=self.problem.parts)

    def forget_input(self) -> bool:
        """Leave out the observations that depend on the input before the record, by a dead time or a lag, and return
        whether there are any."""
        if self.plain.machine.elastic:
            return False
        body, _, _ = self.problem._body(self.q)
        time = max(0.0, float(body[DELAY])) + MOTION.lags * max(0.0, float(body[LAGGING]))
        kept = [one.times >= min(time, float(one.times[-1]) / 2) for one in self.plain.stretches]
        if all(np.all(rows) for rows in kept):
            return False
        self.plain, self.problem = self.plain.keep(kept), self.problem.keep(kept)
        self.noise = Gaussian(self.plain.stretches)
        return True

    @property
    def rate(self) -> float:
        body, _, _ = self.problem._body(self.q)
        return max(0.0, float(body[VISCOUS] / body[MASS]))

    def make_waves(self, kind: str, wavenumber: float) -> list[ExtraForce]:
        """Return the waves of one kind of `WAVES` with a wavenumber [1/unit]."""
        size = 0.3 * self.sizes.coulomb if kind else 3 * self.problem.resolution
        return waves(kind, 1 / wavenumber, size, "rad" if self.problem.machine.turn else "m")

    def reaches_bound(self, q: Floats) -> bool:
        """Return whether the mass of q (p,) is at a bound, where no motion of the model follows the record."""
        return bool(min(np.abs(q[self.plain.machine.lead] - np.array(self.plain.mass))) < SETTLED)

    def estimate_noise(self, kinds: Sequence[str]) -> Gaussian:
        """Return the noise of the residuals, with the rests of the simulated motion."""
        motion = self.problem.motion(self.q, self.starts)
        stretches = tuple(one.resting(v == 0) for one, (_, v) in zip(self.plain.stretches, motion, strict=True))
        return noise_of(stretches, errors_of(self), self.rate, kinds, self.spread)

    def check_followed(self, noise: Gaussian) -> None:
        """Raise NotIdentifiableError if a motion without any input, but with a disturbance, explains the record as
        well."""
        still = [(one.y[0] - one.y) / self.plain.resolution for one in self.plain.stretches]
        alone = noise_of(noise.stretches, still, self.rate)
        errors = errors_of(self)
        likely = max(one.evidence(errors)[0] for one in (noise, noise_of(noise.stretches, errors, self.rate)))
        gain = likely - alone.evidence(still)[0]
        free = np.count_nonzero(self.prior(self.problem) == 0)
        if not gain > (free + len(self.chosen)) * math.log(self.plain.rows):
            raise NotIdentifiableError(f"the motion does not follow the input; {FOLLOW}")

    @property
    def explains(self) -> bool:
        """Whether a motion that explains every count ends the search."""
        return any(bool(np.any(one.counted)) for one in self.plain.stretches)

    def explain(self, tries: int = TRIES) -> Intervals | None:
        """Return the likelihood of the intervals if a motion explains every count."""
        return explain(self, tries) if self.explains else None

    def choose(self, chosen: Sequence[int]) -> None:
        """Take a set of candidates, with the sizes of those that were in before."""
        sizes = self._sizes()
        self.chosen = sorted(chosen)
        self.problem = self._chosen_problem()
        theta = self.q[: self.count]
        self.q = self.problem.start(self.plain.theta(theta))
        for i, (k, candidate) in zip(self.chosen, self.problem.place_candidates(), strict=True):
            # a force of size 0 shows nothing of its constant, and a lag of 0 moves the body as a dead time does
            self.q[k], constant = sizes.get(i, (0.3 if candidate.base in (DELAY, LAGGING) else 0.02, 1.0))
            if candidate.free:
                self.q[k + 1] = constant

    def choose_best(self, sets: Sequence[Sequence[int]]) -> None:
        """Take the set of candidates whose motion fits best in the present noise."""
        at, ends = (self.chosen, self.problem, self.q, self.starts), []
        for chosen in sets:
            self.chosen, self.problem, self.q, self.starts = at
            self.choose(chosen)
            if len(sets) > 1:
                ends.append((self.solve(self.noise, 10).cost, self.chosen, self.problem, self.q, self.starts))
        if ends:
            _, self.chosen, self.problem, self.q, self.starts = min(ends, key=lambda end: end[0])

    def _odds(self) -> Floats:
        """Return the log odds of each candidate. The candidates of one name share those of their row."""
        names = [one.name for one in self.table]
        return np.array([ODDS - math.log(names.count(name)) for name in names])

    def _sizes(self) -> dict[int, tuple[float, float]]:
        """Return the size of each chosen candidate, and its constant in units of the first one."""
        places = zip(self.chosen, self.problem.place_candidates(), strict=True)
        return {i: (float(self.q[k]), float(self.q[k + 1]) if one.free else 1.0) for i, (k, one) in places}

    def local(self, likelihood: Likelihood) -> Quadratic:
        """Return the quadratic log likelihood by the machine's parameters and by all candidates of the table, about
        size 0 of each candidate."""
        sizes = self._sizes()
        every = self.plain.with_candidates(free_constants(self.table, self.chosen))
        q, at = every.start(self.plain.theta(self.q[: self.count])), np.zeros(len(self.table))
        for i, (k, candidate) in enumerate(every.place_candidates()):
            at[i] = q[k] = sizes.get(i, (0.0, 1.0))[0]
            if candidate.free:
                q[k + 1] = sizes[i][1]
        kept = [*range(self.count), *every.places]
        normal = normal_of(likelihood(every.linearise(q, self.starts))[1], self.starts)
        A, g = normal.A[np.ix_(kept, kept)], normal.g[kept]
        own = self.prior(every)[: self.count]
        A[range(self.count), range(self.count)] += own
        g[: self.count] += own * q[: self.count]
        lowest = np.array([one.lowest for one in self.table])
        return Quadratic(A, g - A[:, self.count :] @ at, self.count, self._odds(), lowest)


def errors_of(search: FitSearch) -> list[Floats]:
    return search.problem.residuals(search.q, search.starts)


def explain(search: FitSearch, tries: int = TRIES) -> Intervals | None:
    """Return the likelihood of the intervals if a motion explains every count, and move the search to its optimum.

    Stops and starts of the axis make the likelihood rough. Where the residuals are as small as rounding, further tries
    begin at random places around the optimum of least squares.
    """
    before = search.remember()
    if mean_square(search) > WITHIN:
        search.solve(Gaussian(search.plain.stretches), 10)
    if mean_square(search) > WITHIN:
        search.return_to(before)
        return None
    rng, likelihood = np.random.default_rng(1), narrow(search)
    for _ in range(tries if is_near_rounding(search) else 0):
        if likelihood is not None:
            break
        search.return_to(before)
        search.q, search.starts = _nearby(search, rng), _nearby_starts(search, rng)
        likelihood = narrow(search, 10)
    if likelihood is None:
        search.return_to(before)
    return likelihood


def narrow(search: FitSearch, steps: int = 30) -> Intervals | None:
    """Move into every count, and return the likelihood of the intervals; None if the motion does not get there.

    The way is the shortest one, from least squares if the residuals are larger than rounding. Where stops bend that
    way, intervals that narrow lead there.
    """
    before = search.remember()
    search.move_constants()
    if mean_square(search) > ROUNDING:
        search.solve(Gaussian(search.plain.stretches), steps)
    if _reach(search):
        return Intervals(search.plain.stretches, EXPLAINED)
    search.return_to(before)
    likelihood = narrow_most(search)
    return likelihood if likelihood.spread <= EXPLAINED else None


def _reach(search: FitSearch) -> bool:
    """Move into every count, if linear programs lead there."""
    precision = np.append(search.prior(search.problem), start_precision(search.starts))
    inside = reach_counts(search.problem, search.q, search.starts, precision, EXPLAINED)
    if inside is not None:
        search.q, search.starts = inside
    return inside is not None


def narrow_most(search: FitSearch) -> Intervals:
    """Narrow the intervals as long as that pays, and return the likelihood of the narrowest."""
    before, best = -math.inf, None
    beyond = max(float(np.max(np.abs(e))) for e in errors_of(search)) - 0.5
    for spread in [one for one in SPREADS if one <= max(beyond, EXPLAINED)]:
        search.move_constants()
        likelihood = Intervals(search.plain.stretches, spread)
        value = -search.solve(likelihood, 15).cost
        if value <= before:
            break
        before, best = value, (likelihood, search.remember())
    assert best is not None
    likelihood, state = best
    search.return_to(state)
    return likelihood


def mean_square(search: FitSearch) -> float:
    return float(np.mean(np.concatenate(errors_of(search)) ** 2))


def is_near_rounding(search: FitSearch) -> bool:
    """Return whether a motion next to the present one may explain every count."""
    return mean_square(search) < MOST_SQUARES


def _nearby(search: FitSearch, rng: np.random.Generator) -> Floats:
    """Return parameters a few standard errors of least squares away."""
    noise = Gaussian(search.plain.stretches)
    normal = normal_of(noise(search.problem.linearise(search.q, search.starts))[1], search.starts)
    A = normal.A + np.diag(search.prior(search.problem))
    return search.problem.clip_to_bounds(search.q + NEARBY * random_step(A, rng))


def _nearby_starts(search: FitSearch, rng: np.random.Generator) -> Floats:
    """Return start states near those that the first counts show. An axis at rest shows nothing of its speed."""
    starts = search.plain.first_starts()
    starts[:, 0] += 0.3 * rng.standard_normal(len(starts))
    starts[:, 1] += (0.3 + 0.3 * np.abs(starts[:, 1])) * rng.standard_normal(len(starts))
    return starts

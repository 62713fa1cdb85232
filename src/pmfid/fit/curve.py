"""Friction over speed as columns of the fit, with a smoothness prior.

The friction is a jump, a line, and bends at fixed speeds. A bend in both directions is a column s(|v| - v_k), and its
difference by direction a column |v| - v_k, for |v| > v_k. The size of a bend is a second difference of the curve, and
has a Gaussian prior. The posterior weight of each strength of the prior has a closed form (MacKay 1992), so that the
curve and its covariance are means over the strengths.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np

from pmfid._body import BASE
from pmfid.errors import NotIdentifiableError
from pmfid.fit.build import build, prune, settle
from pmfid.fit.fit import Fitted, conclude, estimate_variance, soften
from pmfid.fit.likelihood import Gaussian, Intervals
from pmfid.fit.machine import COULOMB, DIRECTIONAL, OFFSET, VISCOUS, BodyForce, BodyModel
from pmfid.fit.openings import begin
from pmfid.fit.problem import FitProblem
from pmfid.fit.search import ROUNDS, TRIES, WANDERING, FitSearch, explain
from pmfid.fit.solve import covariance_of, inverse, normal_of
from pmfid.types import Floats

#: Ends of the bends in parts of the highest speed.
SPEEDS = np.r_[0.0, np.geomspace(0.01, 1.0, 19)]
Strengths = tuple[float, float, float, float]
KINDS = ("bend", "bend_even")
#: Strengths of the prior, in parts of the friction at the highest speed: those of bends like a random walk of the slope
#: over the speed; those of bends like one over the logarithm of the speed, and the part of the highest speed below
#: which these are; and the part of a bend that differs by direction.
GRID: tuple[Strengths, ...] = tuple(
    product(
        (1e-4, 3e-3, 0.03, 0.3, 3.0),
        (1e-4, 3e-3, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0),
        (0.015, 0.03, 0.1, 0.3, 1e3),
        (0.01, 0.1, 1.0),
    )
)
#: Forces of the table that bends replace.
REPLACED = ("stribeck", "quadratic")


@dataclass(frozen=True, eq=False)
class CurveFit:
    """A friction curve at velocities (k,): `force` (k,), and the half length `half` (k,) of its 95 % intervals.

    `mass` and `mass_half` are those of the same fit. `fitted` is the fit, whose machine has the bends.
    """

    fitted: Fitted
    velocity: Floats
    force: Floats
    half: Floats
    mass: float
    mass_half: float


def friction_rows(machine: BodyModel, velocity: Floats) -> Floats:
    """Return the derivatives (k, p) of the friction at velocities (k,) by the machine's parameters."""
    speed, side = np.abs(velocity), np.where(velocity < 0, -1.0, 1.0)
    body = np.zeros((velocity.size, len(machine.rest)))
    body[:, [VISCOUS, COULOMB, OFFSET, DIRECTIONAL]] = np.column_stack([velocity, side, np.ones_like(speed), speed])
    for j, force in enumerate(machine.forces):
        if force.kind in KINDS:
            along = np.clip((speed - force.p) / (force.q - force.p), 0.0, 1.0)
            height = np.where(along < 1, 0.5 * along * (speed - force.p), speed - 0.5 * (force.p + force.q))
            body[:, BASE + j] = height * (side if force.kind == "bend" else 1.0)
    return np.asarray(body @ machine.lift)


def with_bends(machine: BodyModel, speed: float) -> BodyModel:
    """Return the machine with the bends as further parameters: changes of the slope [N s/m] times the highest speed."""
    ends = list(pairwise((speed * SPEEDS).tolist()))
    bends = [BodyForce(kind, *end) for kind in KINDS for end in ends]
    own, first = len(machine.names), BASE + len(machine.forces)
    lift = np.zeros((len(machine.rest) + len(bends), own + len(bends)))
    lift[np.ix_([*range(first), *range(first + len(bends), len(lift))], range(own))] = machine.lift
    lift[range(first, first + len(bends)), range(own, own + len(bends))] = 1 / speed
    names = (*machine.names, *(f"bend {i}" for i in range(len(bends))))
    rest = np.insert(machine.rest, first, np.zeros(len(bends)))
    sloping = np.any(machine.lift[[VISCOUS, DIRECTIONAL]] != 0, axis=0)
    lowest = np.append(np.where(sloping, -np.inf, machine.lowest), np.full(len(bends), -np.inf))
    return replace(machine, names=names, forces=(*machine.forces, *bends), rest=rest, lift=lift, lowest=lowest)


def bend_precision(own: int, force: float, strengths: Strengths) -> Floats:
    """Return the prior precisions (p,) of a machine with `own` parameters and bends, for a friction `force` [N] at the
    highest speed."""
    smooth, sharp, below, part = strengths
    top, width = SPEEDS[1:], np.diff(SPEEDS)
    variance = force**2 * width * (smooth**2 + sharp**2 / top**3 * np.exp(-top / below))
    return np.concatenate([np.zeros(own), 1 / variance, 1 / (part**2 * variance)])


class CurveSearch(FitSearch):
    """A search for a machine with bends, which begins with the friction of the table in their place."""

    def __init__(self, problem: FitProblem) -> None:
        super().__init__(problem)
        self.straight, self.force = problem.machine, 0.0
        self.strengths: Strengths = (0.3, 0.1, 1e3, 0.1)  # loose, before the record has been weighed

    def explain(self, tries: int = 0) -> Intervals | None:
        """Return the likelihood of the intervals if a motion explains every count. The friction of the table always has
        all `TRIES`, and bends have none."""
        return explain(self, TRIES if self.force == 0 else 0)

    def add_bends(self) -> None:
        """Continue with bends, in place of friction by the table."""
        kept, replaced = [i for i, one in enumerate(self.table) if one.name not in REPLACED], self._sum_replaced()
        self.choose([i for i in self.chosen if i in kept])
        self.chosen, self.table = [kept.index(i) for i in self.chosen], [self.table[i] for i in kept]
        theta, speed = self.plain.theta(self.q[: self.count]), self.sizes.speed
        ends = friction_rows(self.straight, np.array([speed, -speed])) @ theta
        self.force = float(np.max(np.abs(ends)))
        old, bends = self.count, len(KINDS) * (SPEEDS.size - 1)
        self.q = np.insert(self.q, self.count, np.zeros(bends))
        self.plain = replace(self.plain, machine=with_bends(self.straight, speed))
        self.set_strengths(self.strengths)
        v = speed * np.r_[-SPEEDS[:0:-1], SPEEDS[1:]]
        rows = friction_rows(self.plain.machine, v)
        scale = np.where(rows.any(axis=0), self.force / np.maximum(np.abs(rows).max(axis=0), 1e-300), 0.0)
        scale[old:] = 1 / np.sqrt(self.precision(self.strengths)[old:])
        self.q[: self.count] += scale * np.linalg.lstsq(rows * scale, np.sign(v) * replaced(np.abs(v)), rcond=None)[0]

    def _sum_replaced(self) -> Callable[[Floats], Floats]:
        """Return the friction over the speed by the chosen forces that bends replace."""
        parts = []
        for k, one in self.problem.place_candidates():
            if one.name in REPLACED and one.force is not None:
                constant = self.q[k + 1] * one.constant if one.free else one.force.p
                parts.append((one.name, self.q[k] * one.sd, constant, one.force.q))

        def evaluate(speed: Floats) -> Floats:
            total = np.zeros_like(speed)
            for name, size, p, q in parts:
                total += size * (np.exp(-((speed / p) ** 2)) if name == "stribeck" else (speed / q) ** p)
            return total

        return evaluate

    def set_strengths(self, strengths: Strengths) -> None:
        self.strengths = strengths
        self.plain = replace(self.plain, machine=replace(self.plain.machine, precision=self.precision(strengths)))
        self.problem = self._chosen_problem()

    def precision(self, strengths: Strengths) -> Floats:
        return bend_precision(len(self.straight.names), self.force, strengths)

    def data(self, likelihood: Gaussian | Intervals) -> tuple[Floats, Floats, Floats]:
        """Return information A (r, r) and gradient g (r,) of the record alone, and the prior precisions (r,)."""
        normal = normal_of(likelihood(self.problem.linearise(self.q, self.starts))[1], self.starts)
        return normal.A, normal.g, self.prior(self.problem)

    def follow(self, first: bool) -> Gaussian | Intervals:
        """Return to the optimum under the present strengths, and return its likelihood."""
        self.solve(self.noise)
        self.refine()
        explained = self.explain()
        if explained is not None:
            return prune(self, explained)
        if first:
            return build(self)
        settle(self, WANDERING)
        return self.noise


@dataclass(frozen=True, eq=False)
class StrengthPosterior:
    """Posterior weights (m,) of the strengths of the prior, and the mean steps (m, r) and covariances (m, r, r) of the
    parameters under each."""

    weights: Floats
    steps: Floats
    covariances: Floats

    @property
    def best(self) -> int:
        return int(np.argmax(self.weights))

    def mean(self, rows: Floats, variance: Floats) -> tuple[Floats, Floats]:
        """Return the change (k,) of the products of `rows` (k, r) and the parameters from the best strengths to the
        mean of all, and their variance (k,), which is `variance` (k,) under the best strengths."""
        each = np.sum((rows @ self.covariances) * rows, axis=2)
        shifts = (self.steps - self.steps[self.best]) @ rows.T
        mean = self.weights @ shifts
        wider = self.weights @ each / np.maximum(each[self.best], 1e-300)
        return mean, variance * wider + self.weights @ (shifts - mean) ** 2


def weigh_strengths(search: CurveSearch, likelihood: Gaussian | Intervals) -> StrengthPosterior:
    A, g, prior = search.data(soften(likelihood))
    values, steps, covariances = [], [], []
    own = search.count
    for strengths in GRID:
        precision = prior.copy()
        precision[:own] = search.precision(strengths)
        pull = g + precision * search.q
        covariance = inverse(A + np.diag(precision))
        step = -covariance @ pull
        logs = np.sum(np.log(precision[precision > 0])) + np.linalg.slogdet(covariance)[1]
        values.append(0.5 * (logs - float(step @ pull) * 1.0 - float(precision @ search.q**2)))
        steps.append(step)
        covariances.append(covariance)
    weights = np.exp(np.array(values) - max(values))
    return StrengthPosterior(weights / np.sum(weights), np.array(steps), np.array(covariances))


def fit_curve(problem: FitProblem) -> CurveFit:
    """Fit a machine with directional friction, and with bends of its friction.

    Raises NotIdentifiableError if the axis does not move in both directions, or if no motion of the machine follows it.
    """
    search = CurveSearch(problem)
    if begin(search) is None:
        build(search)
    search.add_bends()
    likelihood = search.follow(first=True)
    for _ in range(ROUNDS):
        posterior = weigh_strengths(search, likelihood)
        if GRID[posterior.best] == search.strengths:
            break
        search.set_strengths(GRID[posterior.best])
        likelihood = search.follow(first=False)
    return _conclude(search, likelihood)


def _conclude(search: CurveSearch, likelihood: Gaussian | Intervals) -> CurveFit:
    fitted = conclude(search, likelihood)
    own, lead, mass = search.count, search.plain.machine.lead, fitted.theta[search.plain.machine.lead]
    velocity = velocities(search)
    rows = np.vstack([np.eye(own)[lead], friction_rows(search.plain.machine, velocity)])
    wide = np.hstack([rows, np.zeros((len(rows), search.q.size - own))])
    change, variance = weigh_strengths(search, likelihood).mean(wide, _variance(search, likelihood, wide))
    local = search.local(soften(likelihood))
    half, _ = local.half_length(search.chosen, range(len(search.table)), variance, rows)
    force = rows[1:] @ fitted.theta + change[1:]
    return CurveFit(fitted, velocity, force, half[1:], float(mass * np.exp(change[0])), float(mass * half[0]))


def _variance(search: CurveSearch, likelihood: Gaussian | Intervals, rows: Floats) -> Floats:
    """Return the variances (k,) of the products of `rows` (k, r) and the parameters under the present strengths."""
    noise = likelihood if isinstance(likelihood, Gaussian) else Gaussian(search.plain.stretches)
    normal = normal_of(noise(search.problem.linearise(search.q, search.starts))[1], search.starts)
    return estimate_variance(covariance_of(normal, search.prior(search.problem)), normal, rows)


def velocities(search: CurveSearch, pieces: int = 8) -> Floats:
    """Return the velocities (k,) of the curve: `pieces` in each bend, up to the fastest motion in each direction."""
    v = np.concatenate([v for _, v in search.problem.motion(search.q, search.starts)])
    ends = search.sizes.speed * SPEEDS[1:]
    speeds = np.interp(np.arange(0, ends.size - 1 + 0.5 / pieces, 1 / pieces), np.arange(ends.size), ends)
    sides = []
    for side, name in ((-1.0, "backward"), (1.0, "forward")):
        fastest = float(np.max(side * v))
        if not fastest > speeds[1]:
            raise NotIdentifiableError(f"the axis moves too little {name}: record a motion in both directions")
        sides.append(side * np.append(speeds[speeds < fastest], fastest))
    return np.concatenate([sides[0][::-1], sides[1]])

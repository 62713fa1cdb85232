"""The search for the model of a servo: starts, terms and noise, on the fit of machines (`pmfid.fit`)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from pmfid._body import BASE
from pmfid.actuators.body import ServoBody, body_of, excite
from pmfid.actuators.bounded import BoundedQuadratic
from pmfid.actuators.logs import JointLog
from pmfid.actuators.servo import Servo
from pmfid.actuators.terms import LOOP_FRICTION, odds_of, table_of
from pmfid.actuators.tuning import TUNING
from pmfid.errors import NotIdentifiableError
from pmfid.fit.compare import ODDS, Quadratic
from pmfid.fit.likelihood import Gaussian
from pmfid.fit.machine import COULOMB, DELAY, MASS, VISCOUS
from pmfid.fit.problem import FitProblem, ObservedStretch
from pmfid.fit.search import FitSearch, build, errors_of
from pmfid.fit.solve import Likelihood, Optimum, solve
from pmfid.fit.terms import Sizes
from pmfid.types import Floats

#: Terms that each have starts of their own.
EXTRAS = ("torque_limit", "ki")
#: Effects that repeat along the travel, which are sought in whole logs.
WAVES = ("wave", "rub")


@dataclass(frozen=True, eq=False)
class ServoTask:
    """Logs of one servo, and what is known of it. Each name in `per_log` is a parameter of each log, and each one in
    `extra` is a term in addition to what is known."""

    servo: Servo
    logs: Sequence[JointLog]
    per_log: tuple[str, ...] = ()
    extra: tuple[str, ...] = ()

    @property
    def lag(self) -> float:
        """Typical distance of the position from the goal [rad]."""
        apart = [log.goal - log.position for log in self.logs]
        return max(float(np.std(np.concatenate(apart))), self.servo.resolution)

    @property
    def period(self) -> float:
        return float(np.median(np.concatenate([np.diff(log.t) for log in self.logs])))

    @property
    def load(self) -> float:
        """Inertia of the pendulum that the logs state [kg m2], or 0."""
        return min(float(log.stated.get("pendulum", 0.0)) for log in self.logs)

    @property
    def model(self) -> Servo:
        """What is known, with the extra terms, with the delay of the loop, and with the friction by the back-EMF if the
        torque of a log is off in between."""
        switched = any(log.on is not None for log in self.logs)
        more = ["loop_delay", *(["back_emf"] if switched else [])]
        terms = [*self.servo.terms, *self.extra, *(name for name in more if not self.servo.has(name))]
        return replace(self.servo, terms=terms)

    @property
    def priors(self) -> dict[str, tuple[float, float]]:
        """Mean and standard deviation of what the logs hardly show."""
        half = 0.5 * self.servo.loop_period
        return {"loop_delay": (half, half), "velocity_filter": (half, TUNING.filter)}

    def body(self) -> ServoBody:
        """Return the body, in which the delay of the loop is uncertain unless it is given."""
        return body_of(self.model, dict.fromkeys(self.per_log, len(self.logs)), self.priors, self.load)

    def problem(self, tick: float = TUNING.tick) -> FitProblem:
        """Return the logs as a problem, with a start state after each gap."""
        body = self.body()
        stretches = tuple(one for k, log in enumerate(self.logs) for one in _stretches(log, body.names, k, tick))
        return FitProblem(body, stretches, self.servo.resolution)


def _stretches(log: JointLog, names: Sequence[str], number: int, tick: float) -> list[ObservedStretch]:
    suffixes = [name.partition(".")[2] for name in names]
    acts = np.array([not suffix or suffix == str(number + 1) for suffix in suffixes], float)
    breaks = np.flatnonzero(np.diff(log.t) > max(TUNING.gap, 5 * float(np.median(np.diff(log.t))))) + 1
    found = []
    for first, last in zip([0, *breaks], [*breaks, log.t.size], strict=True):
        if last - first < 10:
            continue
        part = slice(first, last)
        force, on = (None if own is None else own[part] for own in (log.force, log.on))
        drive = excite(log.t[part], log.goal[part], tick, force, on)
        flags = np.ones(last - first, bool)
        found.append(
            ObservedStretch(drive, log.position[part], np.full(last - first, 1 / 12), flags, ~flags, first, None, acts)
        )
    return found


def head_of(problem: FitProblem) -> FitProblem:
    """Return the first part of the motion of the liveliest stretches."""
    lively = sorted(problem.stretches, key=lambda one: -float(np.sum(np.abs(np.diff(one.y)))))[: TUNING.most_heads]
    heads = []
    for one in lively:
        moving = np.flatnonzero(np.abs(one.y - one.y[0]) > 3 * problem.resolution)
        first = max(0.0, float(one.times[moving[0]]) - 0.5) if moving.size else 0.0
        whole = one.times[-1] <= TUNING.head
        heads.append(one if whole else one.cut(first, first + TUNING.head))
    return replace(problem, stretches=tuple(heads))


class ServoSearch(FitSearch):
    """The search of a servo, from parameters q (p,) of the problem on."""

    wandering: ClassVar[Sequence[str]] = ("position",)
    waves: Sequence[str] = ()

    def __init__(self, task: ServoTask, problem: FitProblem, q: Floats, starts: Floats, search: bool) -> None:
        self.task = task
        lead = problem.machine.lead
        self.plain = replace(problem, mass=(q[lead] - TUNING.far, q[lead] + TUNING.far))
        self.sizes = _sizes_of(task, problem, q, starts)
        self.table = table_of(task.model, self._gain(problem, q), self.sizes) if search else []
        if task.servo.known_force:
            self.table = [one for one in self.table if one.name != "gravity"]
        self.kept = tuple(i for i, one in enumerate(self.table) if one.name == LOOP_FRICTION)
        self.solution = None
        self.take(problem, q, starts, [])
        self.choose(self.kept)

    def take(self, problem: FitProblem, q: Floats, starts: Floats, chosen: Sequence[int]) -> None:
        """Go to parameters and start states of a problem."""
        self.plain = replace(problem, mass=self.plain.mass, candidates=())
        self.chosen = list(chosen)
        self.problem = self._chosen_problem()
        self.q, self.starts, self.noise = q, starts, Gaussian(problem.stretches)

    def _gain(self, problem: FitProblem, q: Floats) -> float:
        return float(problem._body(q, problem.stretches[0].acts)[0][-problem.machine.loops])

    def explain(self) -> None:
        """The loop of a servo counts, so that no smooth motion explains every count."""
        return

    def check_followed(self, noise: Gaussian) -> None:
        """A position under control may follow the goal with any disturbance."""

    def _plain_prior(self) -> Floats:
        return np.array([float(name in self.task.priors) for name in self.plain.machine.names])

    def prior(self, problem: FitProblem) -> Floats:
        prior = super().prior(problem)
        prior[: self.count] = self._plain_prior()
        return prior

    def _odds(self) -> Floats:
        return np.array(odds_of(self.table))

    def local(self, likelihood: Likelihood) -> Quadratic:
        local = super().local(likelihood)
        prior = self._plain_prior()
        A, g = local.A.copy(), local.g.copy()
        A[range(self.count), range(self.count)] += prior
        g[: self.count] += prior * self.q[: self.count]
        pair = tuple(i for i, one in enumerate(self.table) if one.name == "gravity")
        return BoundedQuadratic(A, g, local.plain, local.odds, local.lowest, pair, self.kept)

    def value(self) -> float:
        """Return the log evidence of the present model in its own noise, with the cost of its parameters."""
        noise = self.estimate_noise(self.wandering)
        return (
            noise.evidence(errors_of(self))[0]
            - 0.5 * self.q.size * math.log(self.plain.rows)
            + len(self.task.extra) * ODDS
        )


def _sizes_of(task: ServoTask, problem: FitProblem, q: Floats, starts: Floats) -> Sizes:
    body, _, _ = problem._body(q, problem.stretches[0].acts)
    speeds = np.abs(np.concatenate([v for _, v in problem.motion(q, starts)]))
    speed = float(np.quantile(speeds[np.isfinite(speeds)], 0.98)) or problem.resolution / task.period
    force = float(body[-problem.machine.loops]) * task.lag
    y = np.concatenate([one.y for one in problem.stretches])
    return Sizes(
        force,
        force,
        speed,
        max(float(body[COULOMB]), 0.05 * force),
        max(float(body[VISCOUS]), 0.05 * force / speed),
        float(np.ptp(y)) / 2,
        task.period,
        sum(float(one.times[-1]) for one in problem.stretches),
        True,
        2 * math.pi,
        0.0,
    )


def find_search(task: ServoTask, search: bool) -> ServoSearch:
    """Return the search at the best model of the logs, with a limit of the torque and gravity or without."""
    found = list(_start_searches(task, search))
    best = max(found, key=_settled_value)
    best = max([best, *_with_load_friction(best)], key=lambda one: one.value())
    _check_explains(best)
    if search:
        build(best)
    best = _extend(_drop_limit(best))
    best.waves = WAVES if search else ()
    if search:
        build(best)
    return _drop_limit(best)


def _drop_limit(search: ServoSearch) -> ServoSearch:
    """Return the search without a limit of the torque that nobody named and that never acts."""
    if "torque_limit" not in search.task.extra or limited_part(search.problem, search.q, search.starts) > 0:
        return search
    place = search.plain.machine.names.index("torque_limit")
    task = replace(search.task, extra=())
    problem = replace(search.plain, machine=task.body())
    kept = np.arange(len(search.plain.machine.names)) != place
    acts = [replace(one, acts=None if one.acts is None else one.acts[kept]) for one in problem.stretches]
    noise, q = search.noise, np.delete(search.q, place)
    search.task = task
    search.take(replace(problem, stretches=tuple(acts)), q, search.starts, search.chosen)
    search.noise = replace(noise, stretches=search.plain.stretches)
    return search


def _start_searches(task: ServoTask, search: bool) -> Iterator[ServoSearch]:
    """Yield searches at the best starts: plain, with a limit of the torque or with an integral gain, each with gravity
    and without. The motion of a servo is far from that of one without these."""
    extras = [(), *((name,) for name in EXTRAS if search and not task.servo.has(name))]
    for extra in extras:
        own = replace(task, extra=extra)
        problem = head_of(own.problem())
        q, starts = find_start(own, problem)
        if "torque_limit" in extra and not limited_part(problem, q, starts) > 0:
            q = np.delete(q, problem.machine.names.index("torque_limit"))
            own, problem = task, head_of(task.problem())
        at = ServoSearch(own, problem, q, starts, search)
        yield _move_to_terms(at, "ki") if "ki" in extra else at
        yield from _with_load(at, own, problem, q, starts, search)


def _move_to_terms(at: ServoSearch, name: str) -> ServoSearch:
    """Return the search with a parameter of the model as a term of the table, which has odds and may go again."""
    place = at.plain.machine.names.index(name)
    size, task = float(at.q[place]), replace(at.task, extra=())
    kept = np.arange(at.count) != place
    parts = tuple(replace(one, acts=None if one.acts is None else one.acts[kept]) for one in at.plain.stretches)
    plain = replace(at.plain, machine=task.body(), stretches=parts)
    other = ServoSearch(task, plain, np.delete(at.q[: at.count], place), at.starts, search=True)
    term = next(i for i, one in enumerate(other.table) if one.name == name)
    other.choose([*other.chosen, term])
    other.q[other.problem.places[other.chosen.index(term)]] = size / other.table[term].sd
    return other


def _with_load_friction(at: ServoSearch) -> list[ServoSearch]:
    """Return the settled search with friction in proportion to the load, which other terms hide if they come first."""
    loads = [i for i, one in enumerate(at.table) if one.name == "load_friction"]
    if not loads:
        return []
    other = copy(at)
    other.choose([*at.chosen, *loads])
    _settled_value(other)
    return [other]


def limited_part(problem: FitProblem, q: Floats, starts: Floats) -> float:
    """Return the part of the time at which the controller's torque is at its limit."""
    parts = []
    for stretch, (y, v) in zip(problem.stretches, problem.motion(q, starts), strict=True):
        body, forces, _ = problem._body(q, stretch.acts)
        gain, limit = body[-problem.machine.loops], body[1 - problem.machine.loops]
        late = np.searchsorted(stretch.times, stretch.times - body[DELAY], side="right") - 1
        goal = stretch.drive.u[np.minimum(stretch.drive.row[np.maximum(late, 0)], stretch.drive.u.size - 1)]
        torque = gain * (goal - y)
        for force, size in zip(forces, body[BASE:], strict=False):
            torque = torque - size * v * (force.kind in ("loop_velocity", "loop_filtered"))
        parts.append(np.abs(torque) >= limit)
    return float(np.mean(np.concatenate(parts)))


def _with_load(
    at: ServoSearch, task: ServoTask, head: FitProblem, q: Floats, starts: Floats, search: bool
) -> list[ServoSearch]:
    """Return the search with the candidates of gravity, if the servo has none yet."""
    loads = [i for i, one in enumerate(at.table) if one.name == "gravity"]
    if not loads:
        return []
    other = ServoSearch(task, head, q, starts, search)
    other.choose([*other.kept, *loads])
    return [other]


def _settled_value(search: ServoSearch) -> float:
    search.solve(search.noise)
    search.noise = search.estimate_noise(search.wandering)
    search.solve(search.noise, 15)
    return search.value()


def _check_explains(search: ServoSearch) -> None:
    """Raise NotIdentifiableError if the motion leaves more than half of the variance of the position."""
    left = sum(float(e @ e) for e in errors_of(search)) * search.plain.resolution**2
    total = sum(float(np.sum((one.y - np.mean(one.y)) ** 2)) for one in search.plain.stretches)
    if not left < 0.5 * total:
        raise NotIdentifiableError(
            "no servo model explains the motion: check that goal and position have the same joint, unit and sign"
        )


def _extend(search: ServoSearch) -> ServoSearch:
    """Go from the first parts of the logs to the whole logs, in parts of an interval that are short enough."""
    body, _, _ = search.problem._body(search.q, search.plain.stretches[0].acts)
    frequency = math.sqrt(max(float(body[-search.plain.machine.loops] / body[MASS]), 1.0))
    tick = float(np.clip(TUNING.angle / frequency, 2e-4, TUNING.tick))
    whole = search.task.problem(tick)
    starts = whole.first_starts()
    search.take(whole, search.q, starts, search.chosen)
    search.solve(search.noise, 15)
    for _ in range(2):
        search.noise = search.estimate_noise(search.wandering)
        search.solve(search.noise, 15)
    return search


# --- starts -----------------------------------------------------------------------------------------------------------


def find_start(task: ServoTask, head: FitProblem) -> tuple[Floats, Floats]:
    """Return parameters (p,) and start states (m, 2) of the best local minimum from random servos.

    The servos are the same in each call. The best servos of one log are starts of all logs as well.
    """
    rng = np.random.default_rng(0)
    drawn = [head.clip_to_bounds(head.start(_draw(task, head.machine.names, rng))) for _ in range(TUNING.draws)]
    if len(head.stretches) > 1:
        alone = [replace(head, stretches=(one,)) for one in head.stretches]
        drawn += [end.q for one in alone for end in _refine(task, one, drawn)[:2]]
    best = _refine(task, head, drawn)[0]
    return best.q, best.starts


def _refine(task: ServoTask, head: FitProblem, drawn: Sequence[Floats]) -> list[Optimum]:
    """Return the two best local minima from some servos q (p,), the best one first."""
    starts = head.first_starts()
    costs = [_cost(head, q, starts) for q in drawn]
    prior = np.array([float(name in task.priors) for name in head.machine.names])
    soft = Gaussian(head.stretches, scale=9.0)
    chosen = np.argsort(costs)[: TUNING.refined]
    ends = sorted((solve(head, soft, drawn[i], starts, prior, 12, 1.0) for i in chosen), key=lambda end: end.cost)
    last = [solve(head, soft, end.q, end.starts, prior, 40, 0.01) for end in ends[:2]]
    return sorted(last, key=lambda end: end.cost)


def _cost(head: FitProblem, q: Floats, starts: Floats) -> float:
    moved = head.motion(q, starts)
    apart = np.concatenate([y - one.y for (y, _), one in zip(moved, head.stretches, strict=True)])
    return float(np.mean(np.square(np.nan_to_num(np.clip(apart, -1e6, 1e6), nan=1e6))))


def _draw_positive(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a number with a uniform logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _gain(task: ServoTask, rng: np.random.Generator, frequency: float) -> float:
    """Draw a gain [N m/rad] that agrees with what is given."""
    given = task.servo.given
    if task.servo.relative or "kp" in given:
        return given.get("kp", 1.0)
    if "inertia" in given:
        return given["inertia"] * frequency**2
    known = [float(np.abs(log.force).max()) for log in task.logs if log.force is not None]
    torque = next((given[name] for name in ("gravity", "torque_limit", "coulomb", "kd") if given.get(name)), None)
    return (torque or max(known, default=1.0)) / task.lag * _draw_positive(rng, 0.03, 30.0)


def _draw(task: ServoTask, names: Sequence[str], rng: np.random.Generator) -> Floats:
    """Draw one servo, (p,)."""
    frequency, damping = _draw_positive(rng, *TUNING.frequencies), _draw_positive(rng, *TUNING.dampings)
    gain = _gain(task, rng, frequency)
    inertia = task.servo.given.get("inertia", gain / frequency**2)
    torque = gain * task.lag
    speed = max(float(np.std(np.diff(log.position) / np.diff(log.t))) for log in task.logs) + 1e-9
    largest = max(float(np.max(np.abs(log.goal - log.position))) for log in task.logs)
    pair = "gravity" in names and "gravity_angle" in names
    drawn = {
        "inertia": max(inertia - task.load, 0.03 * inertia),
        "viscous": 2 * damping * frequency * inertia,
        "coulomb": torque * _draw_positive(rng, *TUNING.frictions),
        "kp": gain,
        "back_emf": 2 * damping * frequency * inertia * rng.uniform(0.0, 1.0),
        "kd": damping * frequency * inertia,
        "ki": gain * _draw_positive(rng, 0.1, 10.0),
        "torque_limit": gain * largest * _draw_positive(rng, 0.1, 1.5),
        "delay": max(rng.uniform(0.0, TUNING.delays) * task.period, 1e-6),
        "gravity": torque * _draw_positive(rng, 0.1, 10.0),
        "gravity_angle": torque * rng.uniform(-1.0, 1.0) if pair else rng.uniform(-math.pi, math.pi),
        "stribeck": torque * _draw_positive(rng, *TUNING.frictions),
        "stribeck_speed": speed * _draw_positive(rng, 0.03, 1.0),
        "load_friction": _draw_positive(rng, 0.01, 0.3),
        "load_stribeck": _draw_positive(rng, 0.01, 0.3),
        "load_stribeck_speed": speed * _draw_positive(rng, 0.03, 1.0),
        "quadratic": inertia * _draw_positive(rng, 0.01, 1.0),
    }
    return np.array([drawn.get(name.partition(".")[0], 0.0) for name in names])

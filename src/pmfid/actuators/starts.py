"""The start of a servo's fit: random servos with and without the terms that move it far, and the search from them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from pmfid.actuators.lags import choose_lag
from pmfid.actuators.search import ServoSearch, ServoTask, head_of, limited_part
from pmfid.actuators.servo import UNITS
from pmfid.actuators.tuning import TUNING
from pmfid.errors import NotIdentifiableError
from pmfid.fit.build import build
from pmfid.fit.likelihood import Gaussian
from pmfid.fit.machine import MASS
from pmfid.fit.problem import FitProblem
from pmfid.fit.search import SETTLED, errors_of
from pmfid.fit.solve import Optimum, solve
from pmfid.types import Floats

#: Terms that each have starts of their own, because the motion with them is far from that without.
EXTRAS = ((), ("torque_limit",), ("ki",), ("torque_limit", "ki"), ("load_friction",), ("motor_friction",))
#: Factors of all torques from which the best servo starts again where a known torque, such as gravity, gives the scale.
SCALES = (0.25, 0.5, 2.0, 4.0)
#: Effects that repeat along the travel, which are sought in whole logs.
WAVES = ("wave", "rub")
FOLLOW = "no servo model explains the motion: check that goal and position have the same joint, unit and sign"


def find_search(task: ServoTask, search: bool) -> ServoSearch:
    """Return the search at the best model of the logs, with a limit of the torque and gravity or without."""
    found = list(_start_searches(task, search))
    best = max(found, key=_settled_value)
    _check_explains(best)
    best = choose_lag(best)
    if search:
        build(best)
    best = choose_lag(_extend(_drop_limit(best), 2 * TUNING.angle))
    if search:
        best = _build_waves(best)
    best = _extend(_drop_limit(best), TUNING.angle)
    free = _drop_limit(copy(best), always=True)
    return best if free.task is best.task else max((best, free), key=_settled_value)


def _build_waves(search: ServoSearch) -> ServoSearch:
    """Return the search with effects that repeat along the travel, or as it was if they leave no inertia: a long wave
    of torque then follows a disturbance in place of the motor."""
    other = copy(search)
    other.waves, other.table = WAVES, list(search.table)
    build(other)
    bounds = np.array(other.plain.mass)
    return search if np.min(np.abs(other.q[other.plain.machine.lead] - bounds)) < SETTLED else other


def _drop_limit(search: ServoSearch, always: bool = False) -> ServoSearch:
    """Return the search without a limit of the torque that nobody named and that never acts, or without any such."""
    if "torque_limit" not in search.task.extra:
        return search
    if not always and limited_part(search.problem, search.q, search.starts) > 0:
        return search
    noise = search.noise
    search.task, problem, q = _leave_out(search, "torque_limit")
    search.take(problem, q, search.starts, search.chosen)
    search.noise = replace(noise, stretches=search.plain.stretches)
    return search


def _leave_out(search: ServoSearch, name: str) -> tuple[ServoTask, FitProblem, Floats]:
    """Return task, problem and coordinates without an extra parameter of the model."""
    place = search.plain.machine.names.index(name)
    task = replace(search.task, extra=tuple(one for one in search.task.extra if one != name))
    kept = np.arange(search.count) != place
    parts = (replace(one, acts=None if one.acts is None else one.acts[kept]) for one in search.plain.stretches)
    return task, replace(search.plain, machine=task.body(), stretches=tuple(parts)), np.delete(search.q, place)


def _start_searches(task: ServoTask, search: bool) -> Iterator[ServoSearch]:
    """Yield searches at the best starts with extra terms, each with gravity and without."""
    for extra in EXTRAS if search else EXTRAS[:1]:
        if any(task.servo.has(name) for name in extra):
            continue
        own = replace(task, extra=extra)
        problem = head_of(own.problem())
        q, starts = find_start(own, problem)
        at = _drop_limit(ServoSearch(own, problem, q, starts, search))
        if extra[:1] == ("torque_limit",) != at.task.extra[:1]:
            continue  # the same model is among the others
        for name in extra:
            at = at if name == "torque_limit" else _move_to_terms(at, name)
        yield at
        loads = [i for i, one in enumerate(at.table) if one.name == "gravity"]
        if loads:
            other = copy(at)
            other.choose([*at.chosen, *loads])
            yield other


def _move_to_terms(at: ServoSearch, name: str) -> ServoSearch:
    """Return the search with a parameter of the model as a term of the table, which has odds and may go again."""
    size = float(at.q[at.plain.machine.names.index(name)])
    task, plain, q = _leave_out(at, name)
    other = ServoSearch(task, plain, q[: len(plain.machine.names)], at.starts, search=True)
    term = next(i for i, one in enumerate(other.table) if one.name == name)
    other.choose([*other.chosen, term])
    other.q[other.problem.places[other.chosen.index(term)]] = size / other.table[term].sd
    return other


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
        raise NotIdentifiableError(FOLLOW)


def _extend(search: ServoSearch, angle: float) -> ServoSearch:
    """Go to the whole logs, in parts of an interval in which the natural frequency turns by an angle [rad]."""
    body, _, _ = search.problem._body(search.q, search.plain.stretches[0].acts)
    frequency = math.sqrt(max(float(body[-search.plain.machine.loops] / body[MASS]), 1.0))
    whole = search.task.problem(float(np.clip(angle / frequency, 2e-4, TUNING.tick)))
    starts = search.starts if whole.rows == search.plain.rows else whole.first_starts()
    noise = replace(search.noise, stretches=whole.stretches)
    search.take(whole, search.q, starts, search.chosen)
    search.solve(noise, 15)
    for _ in range(2):
        search.noise = search.estimate_noise(search.wandering)
        search.solve(search.noise, 15)
    return search


# --- starts -----------------------------------------------------------------------------------------------------------


def find_start(task: ServoTask, head: FitProblem) -> tuple[Floats, Floats]:
    """Return parameters (p,) and start states (m, 2) of the best local minimum from random servos.

    The servos are the same in each call. The best servos of one log are starts of all logs as well.
    """
    draw = ServoDraw(task, head.machine.names, np.random.default_rng(0))
    drawn = [head.clip_to_bounds(head.start(draw())) for _ in range(TUNING.draws)]
    first = replace(head, stretches=tuple(one.cut(0.0, TUNING.sprint) for one in head.stretches))
    early = _costs(first, drawn)
    if len(head.stretches) > 1:
        for k, one in enumerate(head.stretches):
            alone = replace(head, stretches=(one,))
            drawn += [end.q for end in _refine(task, alone, _select(drawn, early[:, k]))[:2]]
    best = _refine(task, head, [*_select(drawn, early.mean(axis=1)), *drawn[TUNING.draws :]])[:2]
    prior, soft = _prior_of(task, head), Gaussian(head.stretches, scale=9.0)
    last = [solve(head, soft, end.q, end.starts, prior, 40, 0.01) for end in best]
    end = min(last, key=lambda end: end.cost)
    for scale in SCALES if "kp" in head.machine.names else ():
        q = head.clip_to_bounds(head.start(_scale(head.machine.names, head.theta(end.q), scale)))
        last.append(solve(head, soft, q, end.starts, prior, 12, 1.0))
    better = min(last, key=lambda end: end.cost)
    if better is not end:
        end = solve(head, soft, better.q, better.starts, prior, 40, 0.01)
    return end.q, end.starts


def _scale(names: Sequence[str], theta: Floats, scale: float) -> Floats:
    """Return parameters (p,) with all torques that are not known larger by a factor. A known load alone tells it."""
    torque = [UNITS[name.partition(".")[0]][0].startswith(("N m", "kg")) for name in names]
    loads = [name.partition(".")[0] in ("gravity", "gravity_angle", "offset") for name in names]
    return np.where(np.array(torque) & ~np.array(loads), theta * scale, theta)


def _select(drawn: Sequence[Floats], costs: Floats) -> list[Floats]:
    """Return the servos with the least costs (n,) of the first n."""
    return [drawn[i] for i in np.argsort(costs)[: TUNING.selected]]


def _prior_of(task: ServoTask, head: FitProblem) -> Floats:
    return np.array([float(name in task.priors) for name in head.machine.names])


def _refine(task: ServoTask, head: FitProblem, drawn: Sequence[Floats]) -> list[Optimum]:
    """Return what a few steps make of the best of some servos q (p,), the best one first."""
    starts, prior = head.first_starts(), _prior_of(task, head)
    soft = Gaussian(head.stretches, scale=9.0)
    chosen = np.argsort(_costs(head, drawn).mean(axis=1))[: TUNING.refined]
    return sorted((solve(head, soft, drawn[i], starts, prior, 12, 1.0) for i in chosen), key=lambda end: end.cost)


def _costs(head: FitProblem, drawn: Sequence[Floats]) -> Floats:
    """Return the squares (n, m) that n servos leave of each of m stretches, relative to the mean of all stretches."""
    starts, rows = head.first_starts(), np.array([one.y.size for one in head.stretches])
    squares = np.empty((len(drawn), rows.size))
    for i, q in enumerate(drawn):
        for k, ((y, _), one) in enumerate(zip(head.motion(q, starts), head.stretches, strict=True)):
            apart = np.nan_to_num(np.clip(y - one.y, -1e6, 1e6), nan=1e6)
            squares[i, k] = apart @ apart
    return np.asarray(squares / np.mean(rows))


def _draw_positive(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a number with a uniform logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


class ServoDraw:
    """A random servo (p,) for each call, in the ranges of `TUNING` and with what is given."""

    def __init__(self, task: ServoTask, names: Sequence[str], rng: np.random.Generator) -> None:
        self.task, self.names, self.rng, self.lag, self.period = task, names, rng, task.lag, task.period
        self.speed = max(float(np.std(np.diff(log.position) / np.diff(log.t))) for log in task.logs) + 1e-9
        self.largest = max(float(np.max(np.abs(log.goal - log.position))) for log in task.logs)
        self.force = max((float(np.abs(log.force).max()) for log in task.logs if log.force is not None), default=1.0)

    def _draw_gain(self, frequency: float) -> float:
        """Draw a gain [N m/rad] that agrees with what is given."""
        given = self.task.servo.given
        if self.task.servo.relative or "kp" in given:
            return given.get("kp", 1.0)
        if "inertia" in given:
            return given["inertia"] * frequency**2
        torque = next((given[name] for name in ("gravity", "torque_limit", "coulomb", "kd") if given.get(name)), None)
        return (torque or self.force) / self.lag * _draw_positive(self.rng, 0.03, 30.0)

    def __call__(self) -> Floats:
        rng, task, lag, speed = self.rng, self.task, self.lag, self.speed
        frequency, damping = _draw_positive(rng, *TUNING.frequencies), _draw_positive(rng, *TUNING.dampings)
        gain = self._draw_gain(frequency)
        inertia = task.servo.given.get("inertia", gain / frequency**2)
        torque = gain * lag
        pair = "gravity" in self.names and "gravity_angle" in self.names
        drawn = {
            "inertia": max(inertia - task.load, 0.03 * inertia),
            "viscous": 2 * damping * frequency * inertia,
            "coulomb": torque * _draw_positive(rng, *TUNING.frictions),
            "kp": gain,
            "back_emf": 2 * damping * frequency * inertia * rng.uniform(0.0, 1.0),
            "kd": damping * frequency * inertia,
            "ki": gain * _draw_positive(rng, 0.1, 10.0),
            "torque_limit": gain * self.largest * _draw_positive(rng, 0.1, 1.5),
            "delay": task.lead + max(rng.uniform(0.0, TUNING.delays) * self.period, 1e-6),
            "gravity": torque * _draw_positive(rng, 0.1, 10.0),
            "gravity_angle": torque * rng.uniform(-1.0, 1.0) if pair else rng.uniform(-math.pi, math.pi),
            "stribeck": torque * _draw_positive(rng, *TUNING.frictions),
            "stribeck_speed": speed * _draw_positive(rng, 0.03, 1.0),
            "load_friction": _draw_positive(rng, 0.01, 0.3),
            "load_stribeck": _draw_positive(rng, 0.01, 0.3),
            "load_stribeck_speed": speed * _draw_positive(rng, 0.03, 1.0),
            "motor_friction": _draw_positive(rng, 0.01, 0.3),
            "motor_stribeck": _draw_positive(rng, 0.01, 0.3),
            "motor_stribeck_speed": speed * _draw_positive(rng, 0.03, 1.0),
            "quadratic": inertia * _draw_positive(rng, 0.01, 1.0),
        }
        return np.array([drawn.get(name.partition(".")[0], 0.0) for name in self.names])

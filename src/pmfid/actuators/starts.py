"""The start of a servo's fit: random servos with and without the terms that move it far, and the search from them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from pmfid.actuators.lags import take_lag
from pmfid.actuators.search import ServoSearch, ServoTask, head_of, limited_part
from pmfid.actuators.tuning import TUNING
from pmfid.errors import NotIdentifiableError
from pmfid.fit.build import build, settle
from pmfid.fit.likelihood import Gaussian
from pmfid.fit.problem import FitProblem
from pmfid.fit.search import SETTLED, errors_of
from pmfid.fit.solve import Optimum, solve
from pmfid.types import Floats

#: Terms that the search begins with as well, because their motion is far from that without them.
TERMS = ("ki", "limit_slope", "load_friction", "motor_friction")
#: Effects that repeat along the travel, which are sought in whole logs.
WAVES = ("wave", "rub")
FOLLOW = "no servo model explains the motion: check that goal and position have the same joint, unit and sign"


def find_search(task: ServoTask, search: bool) -> ServoSearch:
    """Return the search at the best model of the logs, with a limit of the torque and gravity or without."""
    starts = list(_start_searches(task, search))
    best = max(starts, key=ServoSearch.value)
    for name in TERMS:
        best = max((best, *_add_term(best, name)), key=ServoSearch.value)
    _check_explains(best)
    best.ticked = True
    for lags in (TUNING.lags[1::2], TUNING.lags):
        best = take_lag(best, lags)
        best = _build_waves(best) if search else best
        if starts[0].task.limited and not best.task.limited:  # terms that came later may show the limit
            place = starts[0].plain.machine.names.index("torque_limit")
            best = max((best, _settle(_with_limit(best, float(starts[0].q[place])))), key=ServoSearch.value)
        best = _extend(_drop_limit(best))
    return max((best, _settle(_with_limit(best, None))), key=ServoSearch.value) if best.task.limited else best


def _build_waves(search: ServoSearch) -> ServoSearch:
    """Return the search with effects that repeat along the travel, or as it was if they leave no inertia: a long wave
    of torque then follows a disturbance in place of the motor."""
    other = copy(search)
    other.waves, other.table = WAVES, list(search.table)
    build(other)
    bounds = np.array(other.plain.mass)
    return search if np.min(np.abs(other.q[other.plain.machine.lead] - bounds)) < SETTLED else other


def _with_limit(search: ServoSearch, limit: float | None) -> ServoSearch:
    """Return the search with a limit of the torque in the coordinates of the fit, or without any for None."""
    other, noise = copy(search), search.noise
    other.task = replace(search.task, limited=limit is not None)
    machine = other.task.body()
    place = (search.plain.machine if limit is None else machine).names.index("torque_limit")

    def change(values: Floats, new: float) -> Floats:
        return np.delete(values, place) if limit is None else np.insert(values, place, new)

    plain, noisy = (
        tuple(replace(one, acts=None if one.acts is None else change(one.acts, 1.0)) for one in stretches)
        for stretches in (search.plain.stretches, noise.stretches)
    )
    problem = replace(search.plain, machine=machine, stretches=plain)
    other.take(problem, change(search.q, limit or 0.0), search.starts, search.chosen)
    other.noise = replace(noise, stretches=noisy)
    return other


def _drop_limit(search: ServoSearch) -> ServoSearch:
    """Return the search without a limit of the torque that nobody named and that never acts."""
    acts = not search.task.limited or limited_part(search.problem, search.q, search.starts) > 0
    return search if acts else _with_limit(search, None)


def _start_searches(task: ServoTask, search: bool) -> Iterator[ServoSearch]:
    """Yield settled searches at the best start with a limit of the torque and without, each with gravity or without."""
    own = replace(task, limited=search and not task.servo.has("torque_limit"))
    problem, thin = head_of(own.problem()), [log.cut(slice(None, None, own.every)) for log in own.logs]
    q = find_start(replace(own, logs=thin))
    start = ServoSearch(own, problem, q, problem.first_starts(), search)
    ends = [_drop_limit(start)]
    for at in [*ends, *(_with_limit(one, None) for one in ends if one.task.limited)]:
        at.solve(at.noise)  # in no noise but rounding, because a poor fit hides in the noise of its own residuals
        yield _settle(at)
        yield from _add_term(at, "gravity")


def _add_term(search: ServoSearch, name: str) -> Iterator[ServoSearch]:
    """Yield the settled search with a term, if the table has this term. Rows of one effect come together."""
    words = {one.words for one in search.table if one.name == name}
    rows = [i for i, one in enumerate(search.table) if one.words in words]
    if rows:
        other = copy(search)
        other.choose([*search.chosen, *rows])
        yield _settle(other)


def _settle(search: ServoSearch) -> ServoSearch:
    settle(search, search.wandering)
    return search


def _check_explains(search: ServoSearch) -> None:
    """Raise NotIdentifiableError if the motion leaves more than half of the variance of the position."""
    left = sum(float(e @ e) for e in errors_of(search)) * search.plain.resolution**2
    total = sum(float(np.sum((one.y - np.mean(one.y)) ** 2)) for one in search.plain.stretches)
    if not left < 0.5 * total:
        raise NotIdentifiableError(FOLLOW)


def _extend(search: ServoSearch) -> ServoSearch:
    """Go to the whole logs, in parts of an interval that fit the natural frequency."""
    whole = search.task.problem(float(np.clip(TUNING.angle / search.frequency, 2e-4, TUNING.tick)))
    same, noise = whole.rows == search.plain.rows, search.noise
    search.take(whole, search.q, search.starts if same else whole.first_starts(), search.chosen)
    search.solve(noise if same else replace(noise, stretches=whole.stretches))
    return _settle(search)


# --- starts -----------------------------------------------------------------------------------------------------------


def find_start(task: ServoTask) -> Floats:
    """Return the parameters q (p,) at the best local minimum from random servos.

    The servos are the same in each call.
    """
    head = head_of(task.problem())
    if "inertia" in head.machine.names and "kp" not in head.machine.names and not task.load:
        least = task.servo.given.get("kp", 1.0) / TUNING.frequencies[1] ** 2  # a delay replaces a smaller inertia
        head = replace(head, mass=(math.log(least), math.inf))
    rng, names = np.random.default_rng(0), head.machine.names
    drawn = [head.clip_to_bounds(head.start(draw_servo(task, names, rng))) for _ in range(TUNING.draws)]
    for time, kept in ((TUNING.sprint, TUNING.selected), (TUNING.head / len(head.stretches), TUNING.refined)):
        part = replace(head, stretches=tuple(one.cut(0.0, time) for one in head.stretches))
        drawn = [drawn[i] for i in np.argsort(_costs(part, drawn))[:kept]]
    ends = [_descend(part, q, part.first_starts(), 12, 1.0) for q in drawn]
    best = sorted(ends, key=lambda end: end.cost)[:2]
    return min((_descend(head, end.q, end.starts, 40, 0.01) for end in best), key=lambda end: end.cost).q


def _descend(head: FitProblem, q: Floats, starts: Floats, steps: int, small: float) -> Optimum:
    assert head.machine.precision is not None
    return solve(head, Gaussian(head.stretches, scale=9.0), q, starts, head.machine.precision, steps, small)


def _costs(head: FitProblem, drawn: Sequence[Floats]) -> list[float]:
    """Return the squares (n,) that n servos leave [counts^2]."""
    starts = head.first_starts()
    return [sum(float(e @ e) for e in head.residuals(q, starts)) for q in drawn]


def _draw_positive(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a number with a uniform logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _draw_gain(task: ServoTask, frequency: float, rng: np.random.Generator) -> float:
    """Draw a gain [N m/rad] that agrees with what is given."""
    given = task.servo.given
    if task.servo.relative or "kp" in given:
        return given.get("kp", 1.0)
    if "inertia" in given:
        return given["inertia"] * frequency**2
    known = (given[name] for name in ("gravity", "torque_limit", "coulomb", "kd") if given.get(name))
    forces = (float(np.abs(log.force).max()) for log in task.logs if log.force is not None)
    torque = next(known, None) or max(forces, default=1.0)
    return torque / task.lag * _draw_positive(rng, 0.03, 30.0)


def draw_servo(task: ServoTask, names: Sequence[str], rng: np.random.Generator) -> Floats:
    """Draw a random servo (p,) in the ranges of `TUNING` and with what is given."""
    speed = max(float(np.std(np.diff(log.position) / np.diff(log.t))) for log in task.logs) + 1e-9
    frequency, damping = _draw_positive(rng, *TUNING.frequencies), _draw_positive(rng, *TUNING.dampings)
    gain = _draw_gain(task, frequency, rng)
    inertia = task.servo.given.get("inertia", gain / frequency**2)
    torque, largest = gain * task.lag, max(float(np.max(np.abs(log.goal - log.position))) for log in task.logs)
    pair = "gravity" in names and "gravity_angle" in names
    drawn = {
        "inertia": max(inertia - task.load, 0.03 * inertia),
        "viscous": 2 * damping * frequency * inertia,
        "coulomb": torque * _draw_positive(rng, *TUNING.frictions),
        "kp": gain,
        **dict.fromkeys(("back_emf", "limit_slope"), 2 * damping * frequency * inertia * rng.uniform(0.0, 1.0)),
        "kd": damping * frequency * inertia,
        "ki": gain * _draw_positive(rng, 0.1, 10.0),
        "torque_limit": gain * largest * _draw_positive(rng, 0.1, 1.5),
        "delay": task.lead + max(rng.uniform(0.0, TUNING.delays) * task.period, 1e-6),
        "gravity": torque * _draw_positive(rng, 0.1, 10.0),
        "gravity_angle": torque * rng.uniform(-1.0, 1.0) if pair else rng.uniform(-math.pi, math.pi),
        "stribeck": torque * _draw_positive(rng, *TUNING.frictions),
        "quadratic": inertia * _draw_positive(rng, 0.01, 1.0),
    }
    shares = ("load_friction", "load_stribeck", "motor_friction", "motor_stribeck")
    drawn |= {name: _draw_positive(rng, 0.01, 0.3) for name in shares}
    speeds = ("stribeck_speed", "load_stribeck_speed", "motor_stribeck_speed")
    drawn |= {name: speed * _draw_positive(rng, 0.03, 1.0) for name in speeds}
    return np.array([drawn.get(name.partition(".")[0], 0.0) for name in names])

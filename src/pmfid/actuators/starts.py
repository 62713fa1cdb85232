"""Starts of a fit: random servos, the best of which are refined."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pmfid.actuators.problem import ServoProblem
from pmfid.actuators.tuning import TUNING
from pmfid.types import Floats


def _draw(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a number with a uniform logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _gain(problem: ServoProblem, rng: np.random.Generator, frequency: float) -> float:
    """Draw a proportional gain [N m/rad] that agrees with what is given."""
    given = problem.servo.given
    if problem.servo.relative or "kp" in given:
        return given.get("kp", 1.0)
    if "inertia" in given:
        return given["inertia"] * frequency**2
    force = 1.0 if problem.force is None else float(np.abs(problem.force).max())
    torque = next((given[name] for name in ("gravity", "torque_limit", "coulomb", "kd") if given.get(name)), force)
    return torque / max(problem.lag, problem.servo.resolution) * _draw(rng, 0.03, 30.0)


def _draw_servo(problem: ServoProblem, rng: np.random.Generator, period: float) -> Floats:
    """Draw one servo, (p,)."""
    frequency, damping = _draw(rng, *TUNING.frequencies), _draw(rng, *TUNING.dampings)
    gain = _gain(problem, rng, frequency)
    inertia = problem.servo.given.get("inertia", gain / frequency**2)
    torque = gain * max(problem.lag, problem.servo.resolution)
    drawn = {
        "inertia": inertia,
        "viscous": 2 * damping * frequency * inertia,
        "coulomb": torque * _draw(rng, *TUNING.frictions),
        "kp": gain,
        "kd": damping * frequency * inertia,
        "torque_limit": gain * float(np.max(np.abs(problem.goal - problem.position))) * _draw(rng, 0.1, 1.5),
        "delay": max(rng.uniform(0.0, TUNING.delays) * period, 1e-6),
        "loop_delay": rng.uniform(0.1, 1.0) * problem.servo.loop_period,
        "gravity": torque * _draw(rng, 0.1, 10.0),
        "gravity_angle": rng.uniform(-np.pi, np.pi),
        "offset": 0.0,
        "stribeck": torque * _draw(rng, *TUNING.frictions),
        "stribeck_speed": problem.speed * _draw(rng, 0.03, 1.0),
        "load_friction": _draw(rng, 0.01, 0.3),
        "quadratic": inertia * _draw(rng, 0.01, 1.0),
    }
    return np.array([drawn[name] for name in problem.servo.unknown])


def find_start(problem: ServoProblem) -> Floats:
    """Coordinates (p + 2,) of the best local minimum from random starts, on the first part of the motion.

    The starts are the same in each call. Few starts are enough if their minimum leaves no more than rounding, or if
    two of them find it.
    """
    head, rng = problem.head(), np.random.default_rng(0)
    enough = (TUNING.explained * problem.servo.resolution) ** 2 * head.t.size
    for starts, refined in TUNING.rounds:
        (z, cost), *others = _search(head, rng, starts, refined, enough)
        if cost < enough or others[0][1] < TUNING.same_minimum * cost:
            break
    return problem.place_start(z, head)


def _search(
    head: ServoProblem, rng: np.random.Generator, starts: int, refined: int, enough: float
) -> list[tuple[Floats, float]]:
    """Return the best local minima from `starts` random servos, of which `refined` are refined, the best one first.

    A minimum below `enough` is returned alone.
    """
    period = float(np.median(np.diff(head.t)))
    trials = [head.coordinates(_draw_servo(head, rng, period)) for _ in range(starts)]
    quick = replace(head, servo=replace(head.servo, loop_period=TUNING.quick_ticks * head.servo.loop_period))
    costs = [float(np.square(quick.residual(z)).mean()) for z in trials]
    rough: list[tuple[Floats, float]] = []
    for index in np.argsort(costs)[:refined]:
        rough.append(head.refine(trials[index], rough=True))
        if rough[-1][1] < enough:
            return [rough[-1]]
    best = sorted(rough, key=lambda found: found[1])[: TUNING.finished]
    return sorted((head.refine(z) for z, _ in best), key=lambda found: found[1])

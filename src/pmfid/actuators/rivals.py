"""Servos with another friction that explain a log as well.

A friction in proportion to the load takes the same part of the torque wherever the motor drives. All other torques and
the inertia, smaller by this part, then give the same motion. The curvature of the likelihood does not show how long
this valley is, so that other values of the friction are fitted.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pmfid.actuators.problem import ServoProblem
from pmfid.actuators.rounding import measure_cost, measure_independence, sharpen
from pmfid.actuators.servo import TORQUES
from pmfid.actuators.tuning import TUNING
from pmfid.types import Floats

LOAD_FRICTION = "load_friction"


def choose_likeliest(problem: ServoProblem, z: Floats) -> Floats:
    """Return the coordinates (p + 2,) of the likeliest servo among an estimate and its rivals."""
    if problem.is_contradicted(z):
        return z
    found = [(measure_cost(problem, z), z)]
    for theta, rest, cost in _fit_rivals(problem, z):
        if cost < found[0][0] - TUNING.newton_gain:
            start = np.append(problem.coordinates(theta)[: -TUNING.nuisance], rest)
            found.append((cost, sharpen(problem, start)))
    return min(found, key=lambda pair: pair[0])[1]


def measure_load_gain(problem: ServoProblem, z: Floats) -> float:
    """Return how much likelier a friction in proportion to the load makes the log, in independent samples."""
    if problem.servo.has(LOAD_FRICTION) or problem.is_contradicted(z):
        return 0.0
    gain = measure_cost(problem, z) - _fit_rival(problem, z, {LOAD_FRICTION: TUNING.rival_step})[2]
    return gain * measure_independence(problem.residual(z))


def compute_rival_changes(problem: ServoProblem, z: Floats) -> list[Floats]:
    """Return the changes (p,) of the parameters to other servos, each smaller the less likely this servo is.

    A servo with another load-dependent friction is divided by its distance in standard errors, at least 1. A servo with
    a friction that the model does not have counts with the root of its likelihood over that of the model. A model that
    the residual contradicts has no rivals, because its status says so.
    """
    if problem.is_contradicted(z):
        return []
    theta, cost = problem.theta(z), measure_cost(problem, z)
    worth = 0.5 * measure_independence(problem.residual(z))
    changes = [(found - theta) / np.sqrt(max(2 * (more - cost), 1.0)) for found, _, more in _fit_rivals(problem, z)]
    for given in _list_absent(problem, z):
        found, _, more = _fit_rival(problem, z, given)
        changes.append((found - theta) * np.exp(-worth * max(more - cost, 0.0)))
    return changes


def _list_absent(problem: ServoProblem, z: Floats) -> list[dict[str, float]]:
    """Return typical values of each friction that the model does not have."""
    coulomb = problem.list_values(z).get("coulomb", problem.servo.given.get("coulomb", 0.0))
    frictions: list[dict[str, float]] = [{LOAD_FRICTION: TUNING.rival_step}]
    for share, speed in TUNING.rival_stribecks:
        frictions.append({"stribeck": share * coulomb, "stribeck_speed": speed * problem.speed})
    return [given for given in frictions if not any(problem.servo.has(name) for name in given)]


def _fit_rivals(problem: ServoProblem, z: Floats) -> list[tuple[Floats, Floats, float]]:
    """Return the parameters (p,), the start (2,) and the cost of servos with another load-dependent friction."""
    now = problem.list_values(z).get(LOAD_FRICTION)
    if now is None:
        return []
    steps = [now * part if part < 1 else now + max(now, TUNING.rival_step) for part in TUNING.rival_parts]
    return [_fit_rival(problem, z, {LOAD_FRICTION: friction}) for friction in steps if friction < TUNING.most_load]


def _fit_rival(problem: ServoProblem, z: Floats, given: dict[str, float]) -> tuple[Floats, Floats, float]:
    """Return the parameters (p,) and the start (2,) with a given friction, and their cost."""
    servo, now = problem.servo, problem.list_values(z)
    terms = tuple(name for name in servo.terms if name not in given)
    narrow = replace(problem, servo=replace(servo, given={**servo.given, **given}, terms=terms))
    part = 1.0
    if LOAD_FRICTION in given:
        part = (1 - given[LOAD_FRICTION]) / max(1 - now.get(LOAD_FRICTION, 0.0), 1 - TUNING.most_load)
    start = np.array([now[name] * (part if name in TORQUES else 1.0) for name in narrow.servo.unknown])
    found = sharpen(narrow, np.append(narrow.coordinates(start)[: -TUNING.nuisance], z[-TUNING.nuisance :]))
    values = {**narrow.list_values(found), **given}
    theta = np.array([values[name] for name in servo.unknown])
    return theta, found[-TUNING.nuisance :], measure_cost(narrow, found)

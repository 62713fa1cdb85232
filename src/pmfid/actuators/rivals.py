"""Servos with another load-dependent friction that explain a log as well.

A friction in proportion to the load takes the same part of the torque wherever the motor drives. All other torques and
the inertia, smaller by this part, then give the same motion. The curvature of the likelihood does not show how long
this valley is, so that other values of the friction are fitted.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pmfid.actuators.problem import ServoProblem
from pmfid.actuators.rounding import measure_cost, sharpen
from pmfid.actuators.servo import TORQUES
from pmfid.actuators.tuning import TUNING
from pmfid.types import Floats

NAME = "load_friction"


def compute_rival_shifts(problem: ServoProblem, z: Floats) -> list[Floats]:
    """Return the changes (p + 2,) of the coordinates to other servos, each over its distance in standard errors.

    The distance is that of the likelihood, and at least 1.
    """
    if NAME not in problem.servo.unknown:
        return []
    theta, cost = problem.theta(z), measure_cost(problem, z)
    slope, index = np.where(problem.positive, theta, problem.scale), problem.servo.unknown.index(NAME)
    shifts = []
    for part in TUNING.rival_parts:
        other = theta[index] * part if part < 1 else theta[index] + max(theta[index], TUNING.rival_step)
        if other >= TUNING.most_load:
            continue
        found, more = _fit_rival(problem, z, float(other))
        change = np.append((found - theta) / slope, np.zeros(TUNING.nuisance))
        shifts.append(change / np.sqrt(max(2 * (more - cost), 1.0)))
    return shifts


def _fit_rival(problem: ServoProblem, z: Floats, friction: float) -> tuple[Floats, float]:
    """Return the parameters (p,) with a given load-dependent friction, and their cost."""
    servo, now = problem.servo, problem.list_values(z)
    terms = tuple(name for name in servo.terms if name != NAME)
    narrow = replace(problem, servo=replace(servo, given={**servo.given, NAME: friction}, terms=terms))
    part = (1 - friction) / max(1 - now[NAME], 1 - TUNING.most_load)
    start = np.array([now[name] * (part if name in TORQUES else 1.0) for name in narrow.servo.unknown])
    found = sharpen(narrow, np.append(narrow.coordinates(start)[: -TUNING.nuisance], z[-TUNING.nuisance :]))
    values = {**narrow.list_values(found), NAME: friction}
    return np.array([values[name] for name in servo.unknown]), measure_cost(narrow, found)

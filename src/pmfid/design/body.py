"""The body of a problem: its motion with stiction, and the derivatives of the motion (csrc/fit/body.h)."""

from __future__ import annotations

import numpy as np

from pmfid.design.problem import Problem
from pmfid.fit.machine import BodyModel, Excitation, machine_of
from pmfid.types import Floats


def body_of(problem: Problem) -> BodyModel:
    """Return the body of the equation of a problem."""
    return machine_of(problem.drive.equation)


def excite(problem: Problem, u: Floats, step: float, observations: int) -> Excitation:
    """Return the forces of an input u (n,), held for `step` [s] each, with a number of evenly spread observations."""
    row = np.linspace(0, u.size, observations).round().astype(np.int32)
    force = np.ascontiguousarray(u * problem.drive.equation.input_gain)
    return Excitation(np.full(u.size, step), force, row, np.zeros((0, u.size)))

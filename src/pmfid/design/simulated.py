"""A second opinion on the Fisher information: the drive simulated with true stiction, and difference quotients.

The sensitivities of `fisher` belong to a linear equation with a known sign of the friction. If the axis comes to rest,
these sensitivities go on, but the axis does not. Here nothing is linear: each parameter is changed a little in both
directions, the motion is solved event by event, and the difference of the positions gives the sensitivity."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from pmfid.design.problem import Problem
from pmfid.design.tuning import TUNING
from pmfid.errors import UsageError
from pmfid.simulation.drive import DriveParameters, Motion, simulate_drive
from pmfid.types import Floats

__all__ = ["both_ways", "drive_of", "simulate", "simulated_information"]


def simulate(problem: Problem, u: ArrayLike, parameters: Mapping[str, float] | None = None) -> Motion:
    """Motion under the input u (n,) at the position samples, solved with stiction, from `problem.start`.

    `parameters`: true values, missing ones nominal. The arrays of the motion hold n * samples_per_interval + 1 samples,
    the first at time 0; input, direction and moving of the last one belong to no interval.
    Raises UsageError for directional friction, which is not simulated, and if u has not one value per interval.
    """
    u = np.asarray(u, float)
    if u.shape != (problem.intervals,):
        raise UsageError(f"u must have shape ({problem.intervals},), one value per interval, got {u.shape}")
    x0, v0 = problem.start
    held = np.r_[np.repeat(u, problem.samples_per_interval), 0.0]
    dt = problem.dt / problem.samples_per_interval
    return simulate_drive(drive_of(problem, parameters or {}), held, dt, x0, v0)


def simulated_information(
    problem: Problem, u: ArrayLike, *, side: int = 0, step: float = TUNING.simulated_step
) -> Floats:
    """Fisher information (p, p) of one run over unknown + nuisance, in their own units, without the prior.

    u: (n,); step: change of each parameter as a part of its nominal value, > 0; side: 1 to change them upwards, -1
    downwards, 0 both ways. If the axis just stops, or just fails to stop, the two sides differ.
    Raises UsageError as `simulate` does.
    """
    columns = []
    for name in problem.names:
        nominal = problem.nominal[name]
        low, high = both_ways(name, nominal, step)
        low, high = (nominal if side > 0 else low), (nominal if side < 0 and low < nominal else high)
        apart = simulate(problem, u, {name: high}).x[1:] - simulate(problem, u, {name: low}).x[1:]
        columns.append(apart / (high - low))
    sensitivity = np.column_stack(columns)
    return np.asarray(sensitivity.T @ sensitivity / problem.variance)


def both_ways(name: str, nominal: float, step: float = TUNING.simulated_step) -> tuple[float, float]:
    """The values below and above the nominal one for a difference quotient; friction stays at 0 or above."""
    change = step * (abs(nominal) or 1.0)
    return (nominal - change if name == "offset" else max(nominal - change, 0.0)), nominal + change


def drive_of(problem: Problem, changed: Mapping[str, float]) -> DriveParameters:
    """The drive of a problem for the simulation; `changed` values go before the nominal ones. Raises UsageError."""
    if problem.drive.friction != "symmetric":
        raise UsageError("the simulation with stiction has symmetric friction only; use friction = 'symmetric'")
    values = {**problem.nominal, **changed}
    return DriveParameters(
        values["mass"],
        values["viscous_friction"],
        values["coulomb_friction"],
        problem.drive.equation.input_gain,
        values.get("offset", 0.0),
    )

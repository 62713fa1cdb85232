"""A second opinion on the Fisher information, from a simulated drive with true stiction and difference quotients.

The sensitivities of `fisher` belong to a linear equation with a known sign of the friction. If the axis comes to rest,
the linear sensitivities continue, although the axis rests. The simulation here is not linear. For the derivatives, each
parameter changes a little in both directions, and the motion is solved event by event. The difference of the positions
is the sensitivity.
"""

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
    """Simulate the motion from `problem.start` under the input u (n,) with stiction, at the position samples.

    `parameters` has true values. Missing values are nominal. The arrays of the motion hold n * samples_per_interval + 1
    samples, the first at time 0. In the last sample, the entries of input, direction and moving belong to no interval.
    Raises UsageError for directional friction, which is not simulated, and for a wrong length of u.
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
    """Return the Fisher information (p, p) of one run on unknown and nuisance parameters, without the prior.

    The parameters have their own units. `u` is (n,). `step` > 0 is the change of each parameter as a part of its
    nominal value. A `side` of 1 changes the parameters upwards, -1 downwards, and 0 both ways. If the axis just stops,
    or just fails to stop, the two sides differ. Raises the errors of `simulate`.
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
    """Return the values below and above the nominal value for a difference quotient. Friction stays at 0 or above."""
    change = step * (abs(nominal) or 1.0)
    return (nominal - change if name == "offset" else max(nominal - change, 0.0)), nominal + change


def drive_of(problem: Problem, changed: Mapping[str, float]) -> DriveParameters:
    """Return the drive of a problem for the simulation, with `changed` values instead of nominal ones.

    Raises UsageError for directional friction.
    """
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

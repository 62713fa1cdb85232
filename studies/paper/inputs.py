"""The inputs of figures 2 and 5: designs and standard inputs for the same move (paper section IV-A)."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from scipy.optimize import brentq

from pmfid.design.ascent import Climber
from pmfid.design.body import simulate, simulated_information
from pmfid.design.oracle import Oracle
from pmfid.design.problem import InfeasibleError, Limits, Problem
from pmfid.design.solver import SOLVER_REACHED, setting, solve
from pmfid.design.standard import standard_inputs
from pmfid.models.drive import Drive
from pmfid.simulation import CART, CART_DT, CART_RESOLUTION
from pmfid.types import Floats

HORIZON, INTERVALS, STROKE, LARGEST = 2.0, 40, 0.4, 3.0  # [s], -, [m], [V]
#: Least speed [m/s]. For v >= 0, as in the paper, the optimum parks at standstill, where friction hides the
#: information.
LEAST_SPEED = 0.01
STARTS = 20


def problem(mass: float = CART.mass) -> Problem:
    """Return the move of the cart from rest at 0 to rest at 0.4 m in 2 s with unknown mass; `mass` is assumed [kg]."""
    nominal = {"viscous_friction": CART.viscous_friction, "coulomb_friction": CART.coulomb_friction, "mass": mass}
    return Problem(
        Drive(CART.input_gain),
        nominal,
        ("mass",),
        HORIZON,
        INTERVALS,
        Limits(input=LARGEST, position=(0.0, STROKE), min_speed=LEAST_SPEED),
        resolution=CART_RESOLUTION,
        end=(STROKE, 0.0),
        samples_per_interval=round(HORIZON / INTERVALS / CART_DT),
        scaled=False,
    )


@cache
def designed(mass: float = CART.mass) -> Floats:
    """Return the input (INTERVALS,) [V] with the most information on the mass, for an assumed mass [kg].

    The optimum is flat: the pulse may come an interval earlier or later for some millionths of the information. Local
    optima within 0.1 % of the best are ties, as for `Design.reached`. The tie goes to the input nearest to the design
    for the nominal mass.
    """
    ready = setting(problem(mass), "trace")
    climber = Climber(ready.maps, ready.rule, Oracle(ready.inputs))
    seeds = np.random.SeedSequence(0).spawn(STARTS)
    optima = [climber.start(np.random.default_rng(seed)) for seed in seeds]
    if mass == CART.mass:
        return max(optima, key=lambda optimum: optimum[0])[1]
    best = max(value for value, _ in optima)
    ties = [u for value, u in optima if value > best + np.log1p(-SOLVER_REACHED)]
    return min(ties, key=lambda u: float(np.sum((u - designed()) ** 2)))


@cache
def designed_with_rest() -> Floats:
    """Return the best input (INTERVALS,) [V] that may rest at the end, as a pulse does."""
    best, value = designed(), 0.0
    for rest in range(INTERVALS):
        directions = (1,) * (INTERVALS - rest) + (0,) * rest
        try:
            design = solve(replace(problem(), directions=directions), "trace", starts=4, seed=0)
        except InfeasibleError:
            break
        if design.value > value:
            best, value = np.r_[design.u[: INTERVALS - rest], np.zeros(rest)], design.value
    return best


@cache
def designed_with_friction() -> Floats:
    """Return the input (INTERVALS,) [V] with the most information on the mass if friction is unknown as well."""
    joint = replace(problem(), nuisance=("viscous_friction", "coulomb_friction"))
    return solve(joint, "D", starts=STARTS, seed=0).u


@cache
def pulse() -> Floats:
    """Return one pulse of the largest voltage, which takes the cart to 0.4 m, then zero; (INTERVALS,) [V].

    The pulse ends inside an interval, which has a fraction of the voltage.
    """

    def lasting(intervals: float) -> Floats:
        return np.asarray(LARGEST * np.clip(intervals - np.arange(INTERVALS), 0.0, 1.0))

    def beyond(intervals: float) -> float:
        return float(simulate(problem(), lasting(intervals)).x[-1]) - STROKE

    return lasting(brentq(beyond, 1.0, INTERVALS, xtol=1e-12))


@cache
def experiments() -> dict[str, Floats]:
    """Return the input of one stroke (INTERVALS,) [V] by name; all of them keep the same limits and duration."""
    return {
        "one pulse": pulse(),
        "four pulses": standard_inputs(problem(), names=("pulses",))["pulses"].u,
        "design (5)": designed(),
        "design (5) with rest": designed_with_rest(),
        "design, friction unknown": designed_with_friction(),
    }


def information(u: Floats) -> tuple[float, float]:
    """Return the Fisher information of one stroke on the cart's mass [1/kg^2], with stiction.

    The first value is for known friction (paper eq. 40), the second for unknown friction, as the estimators have it.
    """
    joint = replace(problem(), nuisance=("viscous_friction", "coulomb_friction"))
    fisher = simulated_information(joint, u)
    return float(fisher[0, 0]), float(1 / np.linalg.inv(fisher)[0, 0])


def miss_end(u: Floats) -> float:
    """Return the distance by which the cart misses the end under an input [m]."""
    return float(simulate(problem(), u).x[-1]) - STROKE

"""Inputs for any linear plant (paper eq. 5): sensitivities, the drive as a special case, limits, errors."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

import pmfid
from pmfid.design import Limits, PlantProblem, Problem, evaluate_plant_input, solve, solve_plant

NOMINAL = {"gain": 2.0, "pole": 1.5, "damping": 0.4, "frequency": 6.0, "start": 0.3}


def third_order(p):
    """A lag in series with a resonance; the first state starts at a parameter."""
    w, d = p["frequency"], p["damping"]
    A = [[-p["pole"], 0, 0], [0, 0, 1], [w * w, -w * w, -2 * d * w]]
    return A, [p["gain"], 0, 0], [0, 1, 0], [p["start"], 0, 0]


def problem_of(**changes) -> PlantProblem:
    fields = {"horizon": 2.0, "intervals": 24, "noise_variance": 1e-6, "input": (-1.0, 1.0)}
    return PlantProblem(third_order, NOMINAL, ("pole", "damping", "start"), **(fields | changes))


def test_sensitivities_are_the_derivatives_of_the_simulated_output() -> None:
    problem, rng = problem_of(), np.random.default_rng(0)
    u = rng.uniform(-1, 1, problem.intervals)

    def output(values):
        A, b, c, x0 = (np.asarray(part, float) for part in third_order(values))
        A, b, *_ = cont2discrete((A, b[:, None], c[None], np.zeros((1, 1))), problem.dt)
        x, y = x0, []
        for value in u:
            x = A @ x + b[:, 0] * value
            y.append(c @ x)
        return np.array(y)

    design = evaluate_plant_input(problem, u)
    for column, name in zip(design.sensitivity.T, problem.unknown, strict=True):
        step = 1e-5 * NOMINAL[name]
        quotient = (output(NOMINAL | {name: NOMINAL[name] + step}) - output(NOMINAL | {name: NOMINAL[name] - step})) / 2
        assert column == pytest.approx(quotient / step, rel=1e-6, abs=1e-8)
    assert design.fisher == pytest.approx(design.sensitivity.T @ design.sensitivity / 1e-6)
    assert design.predicted_std["pole"] == pytest.approx(np.sqrt(np.linalg.inv(design.fisher)[0, 0]))


def test_the_drive_of_the_paper_is_one_of_these_plants() -> None:
    """The same information, and the same best value, as the design of drives (paper eq. 39, 40)."""
    values = {"mass": 1.07, "viscous_friction": 12.8, "coulomb_friction": 0.8}

    def cart(p):
        A = [[0, 1, 0], [0, -p["viscous_friction"] / p["mass"], -p["coulomb_friction"] / p["mass"]], [0, 0, 0]]
        return A, [0, 2.0 / p["mass"], 0], [1, 0, 0], [0, 0, 1]

    plant = PlantProblem(
        *(cart, values, ("mass",), 2.0, 20, 1e-10, (-3.0, 3.0)), states={1: (0.01, np.inf)}, end={0: 0.4}
    )
    limits = Limits(input=3.0, min_speed=0.01)
    drive = Problem(
        *(pmfid.Drive(2.0), values, ("mass",), 2.0, 20, limits), noise_variance=1e-10, end=(0.4, None), scaled=False
    )
    ours, theirs = solve_plant(plant), solve(drive, "trace")
    assert ours.value == pytest.approx(theirs.value, rel=1e-3)
    assert evaluate_plant_input(plant, theirs.u).value == pytest.approx(theirs.value, rel=1e-6)
    assert ours.x[0, -1] == pytest.approx(0.4, abs=1e-9)
    assert ours.x[1, 1:].min() > 0.01 - 1e-9


def test_the_best_input_of_few_intervals_is_the_best_vertex() -> None:
    """Without limits of the state, the trace is largest at a vertex of the box, and all vertices can be tried."""
    problem = problem_of(intervals=9)
    vertices = (evaluate_plant_input(problem, u).value for u in product((-1.0, 1.0), repeat=9))
    assert solve_plant(problem).value == pytest.approx(max(vertices))


def test_more_information_than_a_random_input_and_within_the_limits() -> None:
    problem = problem_of(states={1: (-0.4, 0.4)}, end={0: 0.0, 1: 0.0, 2: 0.0})
    for criterion in ("trace", "D", "A"):
        design = solve_plant(problem, criterion, starts=4)
        assert np.abs(design.u).max() <= 1 + 1e-9
        assert np.abs(design.x[1]).max() <= 0.4 + 1e-9
        assert np.abs(design.x[:, -1]).max() < 1e-8
    random = evaluate_plant_input(problem, np.random.default_rng(1).choice([-0.2, 0.2], 24), "A")
    assert design.value > random.value


def test_an_estimate_reaches_the_predicted_scatter() -> None:
    """Least squares on the simulated output of a lag scatter by the predicted standard deviation."""

    def lag(p):
        return [[-p["pole"]]], [p["pole"]], [1.0], [0.0]

    problem = PlantProblem(lag, {"pole": 3.0}, ("pole",), 2.0, 40, 1e-6, (-1.0, 1.0))
    design, rng = solve_plant(problem), np.random.default_rng(2)

    def simulate(pole):
        a = np.exp(-pole * problem.dt)
        return lfilter([0, 1 - a], [1, -a], np.append(design.u, 0.0))[1:]

    slope = (simulate(3.0 + 1e-5) - simulate(3.0 - 1e-5)) / 2e-5
    errors = [slope @ (1e-3 * rng.standard_normal(40)) / (slope @ slope) for _ in range(400)]
    assert np.std(errors) == pytest.approx(design.predicted_std["pole"], rel=0.15)

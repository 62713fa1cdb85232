"""Designs keep all limits and equal the best known ones, and their bounds hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import pmfid
from pmfid.design.bounds import upper_bound
from pmfid.design.fisher import motion
from pmfid.design.oracle import Oracle
from pmfid.design.polytope import input_set, nearest
from pmfid.design.problem import InfeasibleError, Limits, Problem
from pmfid.design.solver import evaluate, relaxations, setting, solve
from tests.refusals import refused

NOMINAL = {"mass": 1.5, "viscous_friction": 6.0, "coulomb_friction": 0.6}
NAMES = tuple(NOMINAL)
LIMITS = Limits(input=3.0, position=(0.0, 0.4), min_speed=0.01)


def case(unknown: int = 1, intervals: int = 40, **limits: object) -> Problem:
    """Return the case of the paper, section IV-A, with a least speed."""
    bounds = replace(LIMITS, **limits)  # type: ignore[arg-type]
    return Problem(pmfid.Drive(2.0), NOMINAL, NAMES[:unknown], 2.0, intervals, bounds, resolution=91e-6, end=(0.4, 0.0))


#: Best values that 1000 starts found (criterion, parameters), relative to a variance of 1 m^2.
BEST = {("trace", 1): 0.200554, ("D", 2): 0.765926, ("A", 2): 0.299415, ("D", 3): 0.212999, ("A", 3): 0.0689922}


@pytest.mark.parametrize(("criterion", "unknown"), list(BEST))
def test_nearly_every_start_reaches_the_best(criterion: str, unknown: int) -> None:
    problem = case(unknown)
    found = solve(problem, criterion, starts=20, seed=5)
    assert found.feasible
    assert not found.warnings
    assert found.reached >= 0.95
    assert found.value * problem.variance == pytest.approx(BEST[criterion, unknown], rel=1e-3)


@settings(max_examples=20)
@given(
    st.floats(0.3, 5.0),
    st.floats(0.5, 20.0),
    st.floats(0.01, 2.0),
    st.floats(0.05, 0.5),
    st.sampled_from(["velocity", "acceleration", "jerk", "input_rate", "rms", "energy"]),
    st.integers(0, 100),
)
def test_vertices_keep_every_limit(m: float, d: float, F: float, end: float, tight: str, seed: int) -> None:
    nominal = dict(zip(NAMES, (m, d, F), strict=True))
    wide = Limits(input=12.0, position=(0.0, 1.0), min_speed=0.001)
    problem = Problem(pmfid.Drive(2.0), nominal, NAMES, 2.0, 24, wide, resolution=1e-4, end=(end, 0.0))
    problem = replace(problem, limits=replace(wide, **{tight: 2.0 * _needed(problem, tight)}))
    oracle = Oracle(input_set(problem))
    assert oracle.feasible()
    oracle.start()
    u = oracle.maximise(np.random.default_rng(seed).standard_normal(24))
    assert evaluate(problem, u).warnings == ()
    x, v = motion(problem, u)
    assert x[-1] == pytest.approx(end, abs=1e-6)
    assert v[1:-1].min() >= 0.001 - 1e-6
    assert _needed(problem, tight, u) <= 2.0 * _needed(problem, tight) * (1 + 1e-6)


def _needed(problem: Problem, name: str, u: np.ndarray | None = None) -> float:
    """Return the need of an input for a limit; without an input, the need of a motion at constant speed."""
    if u is None:
        m, d, F = problem.nominal.values()
        speed = (problem.end[0] or 0.0) / problem.horizon
        rest = {"velocity": 1.5 * speed, "acceleration": 12 * speed, "jerk": 200 * speed}
        force = (d * 2 * speed + F + m * 10 * speed) / 2.0
        rest |= {"input_rate": force * 12, "rms": force, "energy": force**2 * problem.horizon}
        return rest[name]
    _, v = motion(problem, u)
    a = np.r_[0.0, np.diff(v) / problem.dt, 0.0]
    asked = {
        "velocity": np.abs(v).max(),
        "acceleration": np.abs(a).max(),
        "jerk": np.abs(np.diff(a)).max() / problem.dt,
        "input_rate": np.abs(np.diff(u, prepend=0.0)).max() / problem.dt,
        "rms": np.sqrt(np.mean(u**2)),
        "energy": np.sum(u**2) * problem.dt,
    }
    return float(asked[name])


def test_bounds_are_proved_and_hold() -> None:
    found = solve(case(1, 20), "trace", certify=20.0, gap=0.01)
    assert found.gap is not None
    assert found.gap <= 0.0101
    rule = setting(case(1, 20), "trace").rule
    least_energy = nearest(input_set(case(1, 20)), np.zeros(20))
    bound = upper_bound(case(1, 20), rule, least_energy, gap=0.0, seconds=1.0)
    assert bound is not None
    assert bound >= found.value
    assert solve(case(2, 12), "ME", starts=2, certify=1.0).bound is None, "roundness is not concave"


@pytest.mark.parametrize(("criterion", "unknown"), [("D", 2), ("A", 2), ("E", 2), ("D", 3)])
def test_every_concave_criterion_has_a_bound(criterion: str, unknown: int) -> None:
    found = solve(case(unknown, 12), criterion, certify=60.0, gap=0.1)
    assert found.gap is not None
    assert found.gap <= 0.1001
    many = solve(case(unknown, 12), criterion, starts=50, seed=77)
    assert many.value <= (found.bound or 0.0)


def test_a_robust_design_keeps_the_limits_in_every_scenario() -> None:
    scenarios = tuple({"mass": 1.5 * part} for part in (0.8, 1.2))
    found = solve(replace(case(1), scenarios=scenarios, end_tolerance=(0.01, 0.01)), "trace", starts=5)
    assert found.feasible
    for scenario in scenarios:
        x, v = motion(found.problem, found.u, scenario)
        assert x.max() <= 0.4 + 1e-6
        assert v[1:-1].min() >= 0.01 - 1e-6
        assert abs(x[-1] - 0.4) <= 0.01 + 1e-6


@pytest.mark.parametrize(
    ("limits", "name"),
    [({name: value}, name) for name, value in {"velocity": 0.15, "energy": 1.0, "jerk": 0.3, "rms": 0.5}.items()],
)
def test_the_limit_to_relax_is_named_with_what_it_needs(limits: dict[str, float], name: str) -> None:
    ways = {way.name: way for way in relaxations(case(**limits))}
    assert ways[name].value == limits[name]
    solve(case(**{name: ways[name].needed * 1.0001}), starts=1)
    refused((f"{name} .* -> ", lambda: solve(case(**limits), starts=1)), kind=InfeasibleError)

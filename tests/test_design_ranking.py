"""Inputs for two masses, springs and late inputs: what they show, within the limits, and what the fit then finds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pmfid
from pmfid.design import Design, Limits, Problem, calibrate, rank, simulated_experiment, solve
from pmfid.design.ranking import find_hidden
from pmfid.pipeline.designs import load_spec, make_problem
from pmfid.simulation import quantize
from tests.oracles.two_mass import TwoMasses, simulate_two_masses
from tests.refusals import refused

BELT = make_problem(load_spec(Path(__file__).parents[1] / "examples" / "belt_design.toml"))
ROWS = ("motor_mass", "viscous_friction", "coulomb_friction")
ROWS += ("load_mass", "load_viscous_friction", "load_coulomb_friction", "stiffness", "damping")
CART = {"mass": 1.5, "viscous_friction": 6.0, "coulomb_friction": 0.6}


@pytest.fixture(scope="module")
def ranking() -> dict[str, Design]:
    return rank(BELT, sweeps=1)


def test_the_best_input_is_within_the_limits_and_better_than_every_standard_input(ranking: dict[str, Design]) -> None:
    values = [one.value for one in ranking.values()]
    assert values[0] > 1.5 * values[1]
    assert values == sorted(values, reverse=True)
    for one in ranking.values():
        assert np.abs(one.u).max() <= 0.15
        assert np.abs(one.x).max() <= 3.0
        assert np.abs(one.v).max() <= 30.0
    stiffness = {name: one.predicted_std["stiffness"] for name, one in ranking.items()}
    assert stiffness["chirp to 5 Hz"] > 20 * stiffness["design"], "the resonance is at 31 Hz"


def test_a_fit_of_the_designed_run_is_better_than_predicted(ranking: dict[str, Design]) -> None:
    u = np.repeat(ranking["design"].u, BELT.samples_per_interval)
    truth = simulate_two_masses(TwoMasses(*(BELT.nominal[name] for name in ROWS)), u, 0.001, np.zeros(4))[:-1, 0]
    drive, step = pmfid.Drive(1.0, axis="rotary", body="two-mass"), float(BELT.resolution or 0.0)
    found = pmfid.identify(u, quantize(truth, step), model=drive, dt=0.001, encoder=pmfid.Encoder(step))
    std = dict(zip((name.replace("inertia", "mass") for name in found.names), found.theta_std, strict=True))
    ratio = [std[name] / ranking["design"].predicted_std[name] for name in BELT.unknown]
    assert 0.05 < min(ratio) < max(ratio) < 1.0, ratio


def test_what_no_input_shows_is_named() -> None:
    slow = replace(BELT, intervals=4, samples_per_interval=500, limits=Limits(input=0.03), resolution=0.2)
    assert "damping" in find_hidden(rank(slow))


#: A spring, whose rest position is unknown, and late inputs.
FURTHER = {"stiffness": {"offset": 0.0, "stiffness": 30.0}, "dead_time": {"dead_time": 0.013}, "lag": {"lag": 0.02}}
DRIVES = {"stiffness": pmfid.Drive(2.0, spring=True), "lag": pmfid.Drive(2.0, lag="estimate")}
DRIVES["dead_time"] = pmfid.Drive(2.0, dead_time="estimate")


@pytest.mark.parametrize("kind", FURTHER)
def test_a_designed_run_gives_a_spring_or_a_late_input(kind: str) -> None:
    nominal, unknown = CART | FURTHER[kind], (*CART, kind)
    nuisance = tuple(set(nominal) - set(unknown))
    fixed = (DRIVES[kind], nominal, unknown, 2.0, 40, Limits(input=3.0), 1e-4)
    problem = Problem(*fixed, nuisance=nuisance, samples_per_interval=5)
    truth = {name: 1.05 * value for name, value in nominal.items()}
    design = rank(problem, sweeps=1)["design"]
    known = calibrate(problem, [simulated_experiment(problem, truth, np.random.default_rng(0))(design)])
    std = known.std(problem.names)
    assert not known.unmodelled
    for name in unknown:
        assert std[name] < 3 * design.predicted_std[name]
        assert known.parameters[name] == pytest.approx(truth[name], abs=4 * std[name])


def test_what_a_ranking_does_not_know_is_refused() -> None:
    refused(
        ("knows no end of the motion", lambda: rank(replace(BELT, end=(1.0, None)))),
        ("needs a limit of the input", lambda: rank(replace(BELT, limits=Limits()))),
        ("pmfid.design.rank", lambda: solve(BELT)),
        ("run pmfid identify", lambda: calibrate(BELT, [object()])),  # type: ignore[list-item]
        (
            "add offset",
            lambda: Problem(
                pmfid.Drive(2.0, spring=True),
                CART | {"offset": 0.0, "stiffness": 1.0},
                ("mass",),
                1.0,
                9,
                Limits(),
                1.0,
            ),
        ),
    )

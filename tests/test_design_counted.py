"""`pmfid design SPEC RECORD` with counts: true deviations, inputs that serve the command, and due doubts."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest

from pmfid.design.appraisal import USUAL, choose
from pmfid.design.calibration import DesignedRun, calibrate
from pmfid.design.encoder_error import encoder_covariance
from pmfid.design.polytope import input_set, violations
from pmfid.design.rounds import Commissioning, redesign, sequential, simulated_experiment
from pmfid.design.simulated import drive_of, simulate
from pmfid.design.solver import evaluate
from pmfid.design.standard import standard_inputs
from pmfid.design.tuning import TUNING
from pmfid.simulation.drive import Machine, drive_machine
from studies.design_machines import MACHINES, NAMES, Claims, claims
from tests.conftest import long_unless

FEW = 8


@cache
def usual_claims(name: str) -> Claims:
    problem = MACHINES[name]
    return claims(problem, standard_inputs(problem, names=(USUAL,))[USUAL].u, FEW)


@pytest.mark.parametrize("name", ["40 kg", "rotary"])
@pytest.mark.long
def test_errors_are_as_large_as_claimed(name: str) -> None:
    found = usual_claims(name)
    ratio = np.abs(found.errors / found.stds)
    assert ratio.max() < 4.0
    assert 0.4 < np.sqrt(np.mean(ratio**2)) < 1.6  # few runs give parameters with common errors
    assert found.inside.mean() >= 0.85
    assert not found.unexplained.any()


@pytest.mark.long
def test_the_expected_deviation_is_that_of_the_estimates() -> None:
    problem = MACHINES["rotary"]
    covariance = encoder_covariance(problem, standard_inputs(problem, names=(USUAL,))[USUAL].u)
    assert covariance is not None
    expected = np.sqrt(covariance.diagonal()) / problem.scale
    assert usual_claims("rotary").stds.mean(axis=0) == pytest.approx(expected, rel=0.3)


def machine_run(resolution: float, **lacks: float) -> tuple[Commissioning, float]:
    """Simulate one trapezoid of the 1 kg axis with unmodelled effects; ask for a tenth of the mass's deviation."""
    problem = replace(MACHINES["1 kg"], resolution=resolution)
    u = np.r_[np.repeat(standard_inputs(problem, names=(USUAL,))[USUAL].u, problem.samples_per_interval), 0.0]
    dt = problem.dt / problem.samples_per_interval
    done = drive_machine(Machine(drive_of(problem, {}), **lacks), u, dt, resolution, phase=0.3 * resolution)
    run = DesignedRun(done.u, np.asarray(done.counts * resolution, float), dt)
    state = redesign(problem, [run], {"mass": 0.1}, starts=1)
    return state, state.rounds[0].known.parameters["mass"]


@pytest.mark.parametrize(
    "lacks",
    [
        {"stribeck": 0.2},
        pytest.param({"quadratic": 4.0}, marks=pytest.mark.long),
        pytest.param({"dead_time": 0.004}, marks=pytest.mark.long),
    ],
    ids=lambda d: str(d),
)
def test_a_model_that_misses_counts_is_doubted_and_reaches_nothing(lacks: dict[str, float]) -> None:
    state, _ = machine_run(22.75e-6, **lacks)
    assert state.rounds[0].known.unexplained > 0.5
    assert not state.reached
    assert "misses a count" in state.doubts[0]
    assert state.to_json()["doubts"] == list(state.doubts)


def test_the_right_model_is_not_doubted() -> None:
    state, mass = machine_run(22.75e-6)
    assert mass == pytest.approx(1.0, rel=1e-3)
    assert state.reached
    assert state.doubts == ()
    assert state.choice is None


@pytest.mark.parametrize("seed", [0, 1])
def test_an_axis_without_one_of_the_frictions_is_not_refused(seed: int) -> None:
    problem = MACHINES["8 kg, 2 mm"]  # least squares ends at the bound 0
    experiment = simulated_experiment(problem, {"coulomb_friction": 0.0}, np.random.default_rng(seed))
    run = experiment(evaluate(problem, standard_inputs(problem, names=(USUAL,))[USUAL].u))
    known = calibrate(problem, [run])
    assert known.interval["coulomb_friction"][0] >= 0.0
    assert known.parameters["coulomb_friction"] < 4.0 * known.std(problem.names)["coulomb_friction"]
    assert known.parameters["mass"] == pytest.approx(8.0, rel=0.01)


def test_an_input_is_chosen_that_leaves_no_parameter_worse_than_the_trapezoid() -> None:
    # 0.01 m/s are exactly 10 counts per sample, so that the encoder's error repeats at the creep speed of the design
    problem = replace(MACHINES["40 kg"], resolution=50e-6, samples_per_interval=1)
    state = redesign(problem, [], {}, starts=4)
    assert state.choice is not None
    assert all(state.choice.std[name] <= state.choice.usual[name] for name in problem.unknown)
    assert not violations(input_set(problem), state.choice.design.u)
    assert state.to_json()["next"]["expected_std"] == dict(state.choice.std)


@pytest.mark.parametrize("name", long_unless("rotary".__eq__, ["40 kg", "150 kg, slow", "rotary"]))
def test_a_motion_that_stops_on_a_machine_near_by_is_not_chosen(name: str) -> None:
    """Designs at the least speed once stopped on one machine in ten, with 0.30 of the trapezoid's information."""
    problem = MACHINES[name]
    choice = choose(evaluate(problem, standard_inputs(problem, names=(USUAL,))[USUAL].u), starts=4)
    assert choice.name != USUAL
    assert all(choice.std[each] <= TUNING.appraisal_surely * choice.usual[each] for each in problem.unknown)
    for signs in product((-1, 1), repeat=3):
        truth = {each: (1 + 0.1 * sign) * problem.nominal[each] for each, sign in zip(NAMES, signs, strict=True)}
        moving = simulate(problem, choice.design.u, truth).moving[: -2 * problem.samples_per_interval]
        assert moving.mean() > 0.95


def test_rounds_run_what_was_chosen() -> None:
    problem = MACHINES["rotary"]
    state = sequential(problem, simulated_experiment(problem, {}, np.random.default_rng(1)), {"mass": 1e-5}, starts=2)
    assert state.reached
    assert len(state.rounds) == 1
    first = state.rounds[0]
    assert first.design is not None
    assert np.array_equal(
        first.run.u[: problem.samples_per_interval], np.full(problem.samples_per_interval, first.design.u[0])
    )

"""Designs on simulated axes: stiction, encoder counts, and rounds of design, run and estimate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmfid.design.appraisal import USUAL, appraise
from pmfid.design.body import simulate, simulated_information
from pmfid.design.calibration import DesignedRun, calibrate
from pmfid.design.expected import expected_covariance
from pmfid.design.fisher import affine, information
from pmfid.design.polytope import input_set, violations
from pmfid.design.problem import Design, Limits, Problem
from pmfid.design.rounds import Commissioning, redesign, sequential, simulated_experiment
from pmfid.design.solver import evaluate, solve
from pmfid.design.standard import standard_inputs
from pmfid.errors import NotIdentifiableError
from pmfid.models.drive import Drive
from pmfid.simulation.drive import Machine, drive_machine
from studies.design_case import NOMINAL, case
from studies.design_machines import MACHINES, claims, drive_of
from tests.conftest import long_unless
from tests.refusals import refused

CASE = case("m, d, F_c")


@pytest.fixture(scope="module")
def best() -> Design:
    return solve(CASE, "D", starts=5)


#: The case with finer sampling, and a motion forth and back.
FINE = replace(CASE, samples_per_interval=4)
RETURN = replace(CASE, directions=(1,) * 18 + (0,) * 2 + (-1,) * 18 + (0,) * 2, end=(0.0, 0.0))


@pytest.mark.parametrize("problem", [CASE, FINE, RETURN], ids=["case", "fine", "return"])
def test_both_sensitivities_agree_where_the_axis_keeps_moving(problem: Problem) -> None:
    names = ("trapezoid",) if problem is RETURN else ("trapezoid", "minimum_time", "prbs")
    for each in standard_inputs(problem, names=names).values():
        body, linear = simulate(problem, each.u).slopes[1:], affine(problem).weigh_sensitivities(each.u)
        linear = linear.T * np.sqrt(problem.variance) / problem.scale
        assert body == pytest.approx(linear, rel=1e-6, abs=1e-8 * np.abs(linear).max())


def test_an_axis_that_sticks_tells_nothing() -> None:
    u = np.full(CASE.intervals, 0.2)  # 0.4 N against 0.6 N of friction
    assert not simulate(CASE, u).v.any()
    assert not simulated_information(CASE, u).any()
    assert np.trace(information(CASE, u)) > 0, "the linear equation believes that it slides backwards"


def test_a_design_with_a_least_speed_survives(best: Design) -> None:
    found = appraise(best)
    assert found.worths["design"].surviving == pytest.approx(1.0, abs=1e-3)
    assert found.warnings == ()
    assert found.recommended in ("design", "minimum_time"), "these two are the same here"
    assert found.gain["trapezoid"] > 4.5
    assert found.gain["minimum_time"] >= 1 - 1e-6


@pytest.mark.parametrize(
    ("unknown", "criterion"), [pytest.param("m", "trace", marks=pytest.mark.long), ("m, d, F_c", "D")]
)
def test_without_a_least_speed_there_is_a_warning_with_the_fraction(unknown: str, criterion: str) -> None:
    problem = case(unknown, min_speed=0.0)
    found = appraise(solve(problem, criterion, starts=5))
    surviving = found.worths["design"].surviving
    assert surviving is not None
    assert any(f"{100 * surviving:.0f} % of the claimed" in text for text in found.warnings)
    if criterion == "D":
        assert surviving < 0.5


#: An axis with normal noise of the position in place of counts.
NOISY = replace(CASE, resolution=None, noise_variance=CASE.variance)
U = standard_inputs(CASE, names=("minimum_time",))["minimum_time"].u


def run(truth: dict[str, float], noise: float = 0.0, seed: int = 0) -> DesignedRun:
    motion = simulate(CASE, U, truth)
    y = motion.x + 0.0123 + noise * np.random.default_rng(seed).standard_normal(motion.x.size)
    return DesignedRun(motion.u, y, CASE.dt)


@pytest.mark.long
def test_the_scatter_is_that_of_the_information() -> None:
    noise = np.sqrt(CASE.variance)
    errors = []
    for seed in range(30):
        found = calibrate(NOISY, [run({}, noise, seed)])
        root = np.linalg.cholesky(found.information)
        errors.append(root.T @ [found.parameters[name] - NOMINAL[name] for name in CASE.names])
    # 90 squares of standard normal variables, reduced by the inflation
    assert np.mean(np.square(errors)) == pytest.approx(0.9, abs=0.3)


@pytest.mark.parametrize("factor", [pytest.param(0.8, marks=pytest.mark.long), 1.2])
def test_the_second_round_mends_a_wrong_mass(factor: float) -> None:
    problem = case("m")
    start = replace(problem, nominal={**NOMINAL, "mass": factor * NOMINAL["mass"]})
    experiment = simulated_experiment(start, NOMINAL, np.random.default_rng(0))
    state = sequential(start, experiment, {"mass": 1e-9}, criterion="trace", rounds=2, starts=3)
    assert len(state.rounds) == 2
    assert not state.reached
    first, second = (each.run.y[-1] - each.run.y[0] for each in state.rounds)
    assert second == pytest.approx(0.4, rel=1e-3)
    assert abs(second - 0.4) < abs(first - 0.4)
    assert state.rounds[-1].known.parameters["mass"] == pytest.approx(1.5, rel=1e-4)


def test_what_cannot_be_used_or_wished_is_one_error() -> None:
    def wish(wanted: dict[str, float], rounds: int = 1) -> object:
        return sequential(CASE, lambda design: run({}), wanted, rounds=rounds)

    still, good = DesignedRun(np.full(41, 0.1), np.zeros(41), 0.05), run({})
    refused(
        ("at least one", lambda: calibrate(CASE, [])),
        ("same length", lambda: DesignedRun(np.zeros(3), np.zeros(4), 0.05)),
        ("finite", lambda: DesignedRun(np.zeros(2), np.array([0.0, np.nan]), 0.05)),
        ("offset is none of", lambda: wish({"offset": 1.0})),
        ("positive", lambda: wish({"mass": 0.0})),
        ("rounds", lambda: wish({"mass": 1.0}, 0)),
    )
    refused(
        ("does not move", lambda: calibrate(CASE, [still])),
        ("input_gain", lambda: calibrate(CASE, [DesignedRun(good.u, -good.y, good.dt)])),
        kind=NotIdentifiableError,
    )


COARSE = replace(MACHINES["40 kg"], resolution=5e-3)
HEAVY = {"mass": 41.0, "viscous_friction": 82.0, "coulomb_friction": 15.5}


def coarse_runs(problem: Problem) -> list[DesignedRun]:
    u = standard_inputs(problem, names=(USUAL,))[USUAL].u
    return [simulated_experiment(problem, HEAVY, np.random.default_rng(k))(evaluate(problem, u)) for k in range(2)]


def test_a_prior_has_the_weight_of_a_measurement() -> None:
    runs = coarse_runs(COARSE)
    alone = calibrate(COARSE, runs[:1])
    heavier = alone.parameters["mass"] + 0.05  # about a standard deviation of one run
    problem = replace(COARSE, nominal={**COARSE.nominal, "mass": heavier}, prior=np.diag([0.05**-2.0, 0.0, 0.0]))
    known = calibrate(problem, runs[:1])
    assert known.std(problem.names)["mass"] < 0.85 * alone.std(problem.names)["mass"]
    assert alone.parameters["mass"] < known.parameters["mass"] < heavier
    exact = calibrate(replace(problem, prior=np.diag([1e12, 0.0, 0.0])), runs[:1])
    assert exact.parameters["mass"] == pytest.approx(heavier, abs=1e-5)


def test_the_estimate_of_one_run_as_the_prior_of_the_next_one_is_that_of_both() -> None:
    first, second = coarse_runs(COARSE)
    both, after = calibrate(COARSE, [first, second]), calibrate(calibrate(COARSE, [first]).update(COARSE), [second])
    std = both.std(COARSE.names)
    for name in COARSE.names:
        assert after.parameters[name] == pytest.approx(both.parameters[name], abs=0.5 * std[name])
        # The counts of a run leave no normal error.
        assert after.std(COARSE.names)[name] == pytest.approx(std[name], rel=0.3)


@pytest.mark.parametrize("unknown", [("mass",), ("viscous_friction", "coulomb_friction"), ("coulomb_friction", "mass")])
def test_what_is_known_stays(unknown: tuple[str, ...]) -> None:
    problem = replace(MACHINES["40 kg"], unknown=unknown)
    truth = {name: 1.1 * problem.nominal[name] for name in unknown}
    u = standard_inputs(problem, names=(USUAL,))[USUAL].u
    known = calibrate(problem, [simulated_experiment(problem, truth, np.random.default_rng(0))(evaluate(problem, u))])
    assert known.parameters == pytest.approx({**problem.nominal, **truth}, rel=1e-4)
    assert all(known.interval[name][0] <= truth[name] <= known.interval[name][1] for name in unknown)


@pytest.mark.parametrize(
    ("increments", "mass", "name"),
    long_unless(
        lambda increments, *_: increments in (512, 2048),
        [(512, 1e-4, USUAL), (2048, 3e-3, "prbs"), (8192, 0.2, "s_curve"), (65536, 5.0, USUAL)],
    ),
)
def test_the_expected_deviations_are_those_of_the_fit(increments: int, mass: float, name: str) -> None:
    nominal = {"mass": mass, "viscous_friction": 2.0 * mass, "coulomb_friction": 8.0 * mass}
    limits, end = Limits(input=100.0 * mass, min_speed=0.2), (12.0, 0.0)
    step = 2 * np.pi / increments
    problem = Problem(Drive(1.0), nominal, CASE.names, 2.0, 40, limits, step, end=end, samples_per_interval=5)
    u = standard_inputs(problem, names=(name,))[name].u
    expected = expected_covariance(problem, u)
    assert expected is not None
    found = claims(problem, u, 6)
    ratio = np.sqrt(np.diag(expected) / np.mean(found.stds**2, axis=0)) / list(nominal.values())
    assert np.all((ratio > 0.6) & (ratio < 1.6)), ratio
    assert np.sqrt(np.mean((found.errors / found.stds) ** 2)) < 1.6, "few runs give parameters with common errors"
    assert found.inside.mean() >= 0.85
    assert not found.unmodelled.any()


def machine_run(resolution: float, **unmodelled: float) -> tuple[Commissioning, float]:
    """Simulate one trapezoid of the 1 kg axis with unmodelled effects; ask for a tenth of the mass's deviation."""
    problem = replace(MACHINES["1 kg"], resolution=resolution)
    u = np.r_[np.repeat(standard_inputs(problem, names=(USUAL,))[USUAL].u, problem.samples_per_interval), 0.0]
    dt = problem.dt / problem.samples_per_interval
    done = drive_machine(Machine(drive_of(problem), **unmodelled), u, dt, resolution, phase=0.3 * resolution)
    run = DesignedRun(done.u, np.asarray(done.counts * resolution, float), dt)
    state = redesign(problem, [run], {"mass": 0.1}, starts=1)
    return state, state.rounds[0].known.parameters["mass"]


@pytest.mark.parametrize(
    "unmodelled",
    long_unless(lambda effect: "stribeck" in effect, [{"stribeck": 0.2}, {"quadratic": 4.0}, {"dead_time": 0.004}]),
    ids=str,
)
def test_a_model_that_misses_counts_is_doubted_and_reaches_nothing(unmodelled: dict[str, float]) -> None:
    state, _ = machine_run(22.75e-6, **unmodelled)
    assert state.rounds[0].known.unmodelled
    assert not state.reached
    assert "run pmfid identify" in state.doubts[0]
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
    usual = expected_covariance(problem, standard_inputs(problem, names=(USUAL,))[USUAL].u)
    assert usual is not None
    assert np.all(list(state.choice.std.values()) <= np.sqrt(np.diag(usual)))
    assert not violations(input_set(problem), state.choice.design.u)

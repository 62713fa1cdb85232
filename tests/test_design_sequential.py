"""Estimates from designed runs, and rounds of design, run and estimate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmfid.design import evaluate
from pmfid.design.calibration import DesignedRun, calibrate, correlation_time
from pmfid.design.problem import InfeasibleError
from pmfid.design.rounds import redesign, sequential, simulated_experiment
from pmfid.design.simulated import simulate
from pmfid.design.standard import standard_inputs
from pmfid.errors import NotIdentifiableError
from studies.design_case import NOMINAL, case
from tests.refusals import refused

CASE = case("m, d, F_c")
#: An axis with normal noise of the position in place of counts.
NOISY = replace(CASE, resolution=None, noise_variance=CASE.variance)
TRUTH = {"mass": 1.2, "viscous_friction": 7.0, "coulomb_friction": 0.5}
U = standard_inputs(CASE, names=("minimum_time",))["minimum_time"].u


def run(truth: dict[str, float], noise: float = 0.0, seed: int = 0) -> DesignedRun:
    motion = simulate(CASE, U, truth)
    y = motion.x + 0.0123 + noise * np.random.default_rng(seed).standard_normal(motion.x.size)
    return DesignedRun(motion.u, y, CASE.dt)


def test_without_noise_the_truth_is_found_whatever_the_start_position() -> None:
    found = calibrate(NOISY, [run(TRUTH)])
    assert found.parameters == pytest.approx(TRUTH, rel=1e-6)
    assert found.inflation < 1e-6


def test_the_scatter_is_that_of_the_information() -> None:
    noise = np.sqrt(CASE.variance)
    errors = []
    for seed in range(60):
        found = calibrate(NOISY, [run({}, noise, seed)])
        root = np.linalg.cholesky(found.information)
        errors.append(root.T @ [found.parameters[name] - NOMINAL[name] for name in CASE.names])
    # 180 squares of standard normal variables, reduced by the inflation
    assert np.mean(np.square(errors)) == pytest.approx(0.9, abs=0.3)


def test_a_prior_pulls_as_much_as_it_knows() -> None:
    weak, strong = (replace(NOISY, prior=np.diag([weight, 0.0, 0.0])) for weight in (1e-3, 1e18))
    assert calibrate(weak, [run(TRUTH)]).parameters["mass"] == pytest.approx(1.2, rel=1e-6)
    assert calibrate(strong, [run({"mass": 1.5001})]).parameters["mass"] == pytest.approx(1.5, rel=1e-6)


def test_correlated_and_large_residuals_inflate() -> None:
    rng = np.random.default_rng(0)
    assert correlation_time([rng.standard_normal(400)]) == pytest.approx(1.0, abs=0.3)
    slow = np.repeat(rng.standard_normal(100), 8)
    assert 4 < correlation_time([slow, slow]) < 12
    calm, wild = (calibrate(NOISY, [run({}, factor * np.sqrt(CASE.variance))]) for factor in (1.0, 5.0))
    assert wild.inflation == pytest.approx(25 * calm.inflation, rel=0.05)
    ratio = wild.std(CASE.names)["mass"] / calm.std(CASE.names)["mass"]
    assert ratio == pytest.approx(np.sqrt(wild.inflation / max(1.0, calm.inflation)), rel=0.05)


def test_a_simulated_experiment_has_the_noise_of_the_case() -> None:
    design = evaluate(NOISY, U)
    found = simulated_experiment(NOISY, TRUTH, np.random.default_rng(0))(design)
    noise = found.y - simulate(NOISY, design.u, TRUTH).x
    assert np.std(noise) == pytest.approx(np.sqrt(NOISY.variance), rel=0.4)


@pytest.mark.parametrize("factor", [pytest.param(0.8, marks=pytest.mark.long), 1.2])
def test_the_second_round_mends_a_wrong_mass(factor: float) -> None:
    problem = case("m")
    start = replace(problem, nominal={**NOMINAL, "mass": factor * NOMINAL["mass"]})
    experiment = simulated_experiment(start, NOMINAL, np.random.default_rng(0))
    state = sequential(start, experiment, {"mass": 1e-9}, criterion="trace", rounds=2, starts=10)
    assert len(state.rounds) == 2
    assert not state.reached
    first, second = (each.run.y[-1] - each.run.y[0] for each in state.rounds)
    assert second == pytest.approx(0.4, rel=1e-3)
    assert abs(second - 0.4) < abs(first - 0.4)
    assert state.rounds[-1].known.parameters["mass"] == pytest.approx(1.5, rel=1e-4)


def test_a_later_design_is_for_what_is_known_by_then() -> None:
    state = redesign(NOISY, [run(TRUTH)], {}, starts=3)
    assert state.next is not None
    problem = state.next.problem
    assert problem.nominal == pytest.approx(TRUTH, rel=1e-6)
    assert problem.prior == pytest.approx(state.rounds[-1].known.information)
    before, after = (each["mass"] for each in (state.rounds[-1].known.std(CASE.names), state.next.predicted_std))
    assert after < before
    assert redesign(NOISY, [run(TRUTH)], {"mass": 1.0}).next is None
    tight = replace(NOISY, horizon=0.8)
    with pytest.raises(InfeasibleError, match=r"the runs give mass = 2\.2.*with these values no input"):
        redesign(tight, [run({"mass": 2.2})], {})
    first = redesign(NOISY, [], {}, starts=3)
    assert first.next is not None
    assert first.rounds == ()
    assert not first.reached


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
        ("mass", lambda: calibrate(CASE, [still])),
        ("input_gain", lambda: calibrate(CASE, [DesignedRun(good.u, -good.y, good.dt)])),
        kind=NotIdentifiableError,
    )

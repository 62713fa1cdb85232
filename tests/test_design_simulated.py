"""The second opinion on a design: the simulation with stiction, and its appraisal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmfid.design.appraisal import accumulate_value, appraise, worth_of
from pmfid.design.encoder_error import encoder_covariance, start_free
from pmfid.design.fisher import affine, criterion_of, information
from pmfid.design.problem import Design
from pmfid.design.simulated import both_ways, simulate, simulated_information
from pmfid.design.solver import setting, solve
from pmfid.design.standard import standard_inputs
from pmfid.models.drive import Drive
from studies.design_case import case, known
from tests.refusals import refused

CASE = case("m, d, F_c")


@pytest.fixture(scope="module")
def best() -> Design:
    return solve(CASE, "D", starts=5)


@pytest.mark.parametrize("samples", [1, 4])
def test_both_informations_agree_where_the_axis_keeps_moving(samples: int) -> None:
    problem = replace(CASE, samples_per_interval=samples)
    for each in standard_inputs(problem, names=("trapezoid", "minimum_time", "prbs")).values():
        exact = information(problem, each.u)
        assert simulated_information(problem, each.u) == pytest.approx(exact, rel=1e-4), each.name


def test_a_motion_with_reversal_agrees_as_well() -> None:
    problem = replace(CASE, directions=(1,) * 18 + (0,) * 2 + (-1,) * 18 + (0,) * 2, end=(0.0, 0.0))
    u = standard_inputs(problem, names=("trapezoid",))["trapezoid"].u
    assert simulated_information(problem, u) == pytest.approx(information(problem, u), rel=1e-3)


def test_an_axis_that_sticks_tells_nothing() -> None:
    u = np.full(CASE.intervals, 0.2)  # 0.4 N against 0.6 N of friction
    assert not simulate(CASE, u).moving.any()
    assert not simulated_information(CASE, u).any()
    assert np.trace(information(CASE, u)) > 0, "the linear equation believes that it slides backwards"


def test_friction_is_never_negative_in_a_difference() -> None:
    assert both_ways("coulomb_friction", 0.0) == (0.0, 1e-4)
    assert both_ways("offset", 0.0)[0] < 0
    free = replace(CASE, nominal={**CASE.nominal, "viscous_friction": 0.0}, scaled=False)
    u = standard_inputs(free, names=("trapezoid",))["trapezoid"].u
    assert simulated_information(free, u) == pytest.approx(information(free, u), rel=1e-3)


def test_simulate_wants_one_value_per_interval() -> None:
    refused(("one value per interval", lambda: simulate(CASE, np.zeros(3))))


def test_a_design_with_a_least_speed_survives(best: Design) -> None:
    found = appraise(best)
    assert found.worths["design"].surviving == pytest.approx(1.0, abs=1e-3)
    assert (
        appraise(replace(best, problem=known(CASE))).warnings == ()
    )  # the parameters that the counts allow show a better design
    assert "A slightly heavier axis comes to rest" in found.warnings[0]
    assert found.gain["trapezoid"] > 4.5
    assert found.gain["minimum_time"] >= 1 - 1e-6


@pytest.mark.parametrize(("unknown", "criterion"), [("m", "trace"), ("m, d, F_c", "D")])
def test_without_a_least_speed_there_is_a_warning_with_the_fraction(unknown: str, criterion: str) -> None:
    problem = case(unknown, min_speed=0.0)
    found = appraise(solve(problem, criterion, starts=5))
    surviving = found.worths["design"].surviving
    assert surviving is not None
    assert any(f"{100 * surviving:.0f} % of the claimed" in text for text in found.warnings)
    if criterion == "D":
        assert surviving < 0.5


def test_directional_friction_is_not_checked_and_says_so() -> None:
    nominal = {"mass": 1.5}
    nominal |= {f"viscous_friction_{side}": 6.0 for side in ("forward", "backward")}
    nominal |= {f"coulomb_friction_{side}": 0.6 for side in ("forward", "backward")}
    problem = replace(CASE, drive=Drive(2.0, friction="directional"), nominal=nominal, unknown=("mass",))
    found = appraise(solve(problem, "trace", starts=2))
    assert found.worths["design"].surviving is None
    assert "not checked with stiction" in found.warnings[0]


@pytest.mark.parametrize("criterion", ["trace", "D", "A", "E", "ME"])
def test_what_is_gathered_ends_at_the_value(best: Design, criterion: str) -> None:
    rule = criterion_of(CASE, criterion)
    t, value = accumulate_value(CASE, rule, best.u)
    assert t[[0, -1]] == pytest.approx([0.05, 2.0])
    assert value[-1] == pytest.approx(worth_of(setting(CASE, criterion), best.u).value)
    if criterion != "ME":
        assert np.diff(value).min() > -1e-6 * value[-1]


def test_an_unknown_start_costs_information(best: Design) -> None:
    s = affine(CASE).weigh_sensitivities(best.u)
    # a further parameter with a sensitivity of 1, and a sample at the start
    wide = np.vstack([np.c_[np.zeros(3), s], np.ones(s.shape[1] + 1)])
    covariance = np.linalg.inv(wide @ wide.T)[:3, :3]
    assert np.linalg.inv(start_free(s)) == pytest.approx(covariance, rel=1e-6)


@pytest.mark.long
def test_a_robust_design_says_what_that_costs_and_is_judged_over_its_scenarios() -> None:
    scenarios = ({"mass": 1.2}, {"mass": 1.8})
    robust = replace(case("m"), scenarios=scenarios, end_tolerance=(0.01, 0.01), average="worst")
    found = appraise(solve(robust, "trace", starts=5))
    assert found.price is not None
    assert 0.0 < found.price < 0.15
    assert found.worths["design"].value == pytest.approx(found.design.value)
    assert found.gain["trapezoid"] > 1.2
    assert appraise(solve(case("m"), "trace", starts=2)).price is None


def test_without_an_encoder_there_is_no_encoder_error() -> None:
    noisy = replace(CASE, resolution=None, noise_variance=1e-10)
    u = standard_inputs(noisy, names=("trapezoid",))["trapezoid"].u
    assert encoder_covariance(noisy, u) is None
    assert set(worth_of(setting(noisy, "D"), u).std_encoder.values()) == {np.inf}

"""Standard inputs have the shapes that their names promise, within the limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmfid.design.polytope import input_set, violation
from pmfid.design.problem import Limits
from pmfid.design.standard import STANDARD, standard_inputs
from studies.design_case import case

CASE = case("m, d, F_c")
WIDE = replace(CASE, limits=Limits(input=30.0, min_speed=0.001))
THERE_AND_BACK = replace(CASE, directions=(1,) * 18 + (0,) * 2 + (-1,) * 18 + (0,) * 2, end=(0.0, 0.0))
PROBLEMS = {
    "case": CASE,
    "200 intervals": replace(CASE, intervals=200),
    "there and back": THERE_AND_BACK,
    "free end": replace(CASE, end=(None, None)),
    "free end, rms": replace(CASE, end=(None, None), limits=replace(CASE.limits, rms=1.2)),
    "smooth": replace(CASE, limits=replace(CASE.limits, input_rate=20.0, acceleration=2.0, jerk=60.0, velocity=0.5)),
    "backward": replace(CASE, start=(0.4, 0.0), end=(0.0, 0.0), directions=(-1,) * 40),
}


@pytest.mark.parametrize("name", PROBLEMS)
def test_every_standard_input_keeps_the_limits(name: str) -> None:
    problem = PROBLEMS[name]
    inputs = input_set(problem)
    found = standard_inputs(problem)
    assert tuple(found) == STANDARD
    for each in found.values():
        assert violation(inputs, each.u) < 1e-7, each.name
        assert each.x.shape == each.v.shape == (problem.intervals + 1,)
        for reached, wanted in zip((each.x[-1], each.v[-1]), problem.end, strict=True):
            assert wanted is None or reached == pytest.approx(wanted, abs=1e-9), each.name


def test_profiles_have_their_shapes() -> None:
    found = standard_inputs(WIDE, names=("trapezoid", "s_curve"))
    assert not any(each.bent for each in found.values())
    # 0.4 m in 2 s: 1.5 and 1.875 times the mean velocity
    assert found["trapezoid"].v.max() == pytest.approx(0.3, rel=2e-3)
    assert found["s_curve"].v.max() == pytest.approx(0.375, rel=2e-3)
    acceleration = np.diff(found["trapezoid"].v)
    assert np.ptp(acceleration[:13]) < 1e-12
    assert np.abs(acceleration[14:26]).max() < 1e-12

"""SPEC.toml becomes the problem, and each fault in it becomes one clear line."""

from __future__ import annotations

from pathlib import Path

import pytest

from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.pipeline.designs import Spec, load_spec, make_problem, run_design
from studies.design_case import case
from tests.refusals import refused

EXAMPLE = Path(__file__).parents[1] / "examples" / "cart_design.toml"


def spec(**overrides: object) -> Spec:
    return load_spec(EXAMPLE, {key.replace("__", "."): value for key, value in overrides.items()})


def test_the_example_is_the_case_of_the_study() -> None:
    problem, expected = make_problem(spec()), case("m, d, F_c")
    for name in ("drive", "nominal", "unknown", "horizon", "intervals", "limits", "resolution", "start", "end"):
        assert getattr(problem, name) == getattr(expected, name), name
    assert problem.prior is None
    assert problem.scenarios == ()


def test_tolerances_become_every_corner() -> None:
    corners = make_problem(spec(robust__mass=0.2, robust__viscous_friction=0.5)).scenarios
    found = {(round(each["mass"], 9), each["viscous_friction"]) for each in corners}
    assert found == {(m, d) for m in (1.2, 1.8) for d in (3.0, 9.0)}


def test_parameters_that_no_input_tells_are_named() -> None:
    both = spec(drive__offset=0.2, experiment__unknown=["mass", "coulomb_friction", "offset"], search__starts=2)
    refused(("coulomb_friction from offset", lambda: run_design(both)), kind=NotIdentifiableError)
    # the prior knowledge separates the parameters
    prior = spec(
        drive__offset=0.2,
        experiment__unknown=["mass", "coulomb_friction", "offset"],
        search__starts=2,
        prior__offset=0.01,
    )
    std = run_design(prior).predicted_std
    assert std["offset"] == pytest.approx(0.01, rel=1e-3)
    assert std["coulomb_friction"] == pytest.approx(0.01, rel=0.1)


#: Keys of the file, and what the one line says.
WRONG: list[tuple[dict[str, object], str]] = [
    ({"experiment__criterion": "Q"}, "'trace', 'D', 'A'"),
    ({"motion__intervals": 0}, "[motion] intervals = 0 (given as an option): it should be greater than or equal to 1"),
    ({"motion__duration": -1.0}, "[motion] duration = -1.0"),
    ({"motion__intervals": 10.5}, "valid integer"),
    ({"limits__input": "3"}, "[limits] input = '3'"),
    ({"limits__positions": [0, 1]}, "did you mean 'position'"),
    ({"limits__viscous_friction": 1.0}, "it belongs in [drive]"),
    ({"limit__input": 3.0}, "did you mean 'limits'"),
    ({"drive__mass": float("nan")}, "[drive] mass = nan"),
    ({"experiment__unknown": []}, "[experiment] unknown = []"),
    ({"robust__mass": 1.0}, "[robust] mass = 1.0"),
    ({"search__starts": 0}, "[search] starts = 0"),
    ({"experiment__unknown": ["weight"]}, "'weight' is no parameter"),
    ({"experiment__unknown": ["mass", "mass"]}, "different"),
    ({"motion__end": 0.5}, "outside the position limit"),
    ({"robust__mass": 0.2, "motion__directions": [1] * 30 + [0] * 10}, "leave out the scenarios"),
    ({"motion__start_velocity": -0.1}, "start velocity -0.1 is against the direction 1"),
    ({"motion__end_velocity": -0.1}, "end velocity -0.1 is against the direction 1"),
    ({"motion__end": -0.1, "limits__position": [-1.0, 1.0]}, "directions never lead"),
    ({"limits__position": [0.4, 0.0]}, "lower < upper"),
    ({"motion__directions": [1, -1]}, "40 intervals"),
    ({"prior__offset": 1.0}, "[prior] offset is none of the unknown"),
    ({"drive__offset": 0.0, "experiment__unknown": ["mass", "offset"]}, "scaled"),
]


@pytest.mark.parametrize(("overrides", "said"), WRONG)
def test_what_is_wrong_is_one_line(overrides: dict[str, object], said: str) -> None:
    with pytest.raises(UsageError) as error:
        make_problem(spec(**overrides))
    assert said in str(error.value)
    assert "\n" not in str(error.value)

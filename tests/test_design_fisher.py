"""Information and criteria against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pmfid
from pmfid.design.fisher import (
    CRITERIA,
    Criterion,
    affine,
    check_identifiable,
    information,
)
from pmfid.design.problem import Limits, Problem
from tests.refusals import refused

NAMES = ("mass", "viscous_friction", "coulomb_friction")


def problem(mass: float = 1.5, viscous: float = 6.0, coulomb: float = 0.6, **changes: object) -> Problem:
    nominal = dict(zip(NAMES, (mass, viscous, coulomb), strict=True))
    fields = {"drive": pmfid.Drive(2.0), "nominal": nominal, "unknown": NAMES, "horizon": 2.0, "intervals": 20}
    fields |= {"limits": Limits(input=3.0), "resolution": 1e-4, **changes}
    return Problem(**fields)  # type: ignore[arg-type]


def test_information_of_a_free_mass_has_a_closed_form() -> None:
    """x = u t^2 gain / (2 m): F = sum (gain u t^2 / (2 m^2))^2 / variance."""
    case = problem(2.0, 0.0, 0.0, unknown=("mass",), noise_variance=1e-6)
    t = case.t[1:]
    expected = np.sum((2.0 * 0.7 * t**2 / (2 * 2.0**2)) ** 2) / 1e-6
    assert information(case, np.full(20, 0.7)) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("name", list(CRITERIA))
@pytest.mark.parametrize("size", [1, 2, 3])
def test_gradients_and_homogeneity(name: str, size: int) -> None:
    rng = np.random.default_rng(7)
    root = rng.standard_normal((3, 5))
    F, change = root @ root.T, rng.standard_normal((3, 3))
    change = change + change.T
    rule = Criterion(name, size, np.arange(1.0, size + 1))
    h = 1e-5
    quotient = (rule.log_value(F + h * change) - rule.log_value(F - h * change)) / (2 * h)
    assert np.sum(rule.gradient(F) * change) == pytest.approx(float(quotient), rel=1e-6, abs=1e-9)
    assert rule.value(3.0 * F) == pytest.approx(rule.value(F) * (1.0 if name == "ME" else 3.0))


def test_criteria_are_what_their_names_say() -> None:
    S = np.diag([1.0, 4.0])
    values = {name: Criterion(name, 2, np.array([1.0, 0.0])).value(S) for name in CRITERIA}
    assert values == pytest.approx({"trace": 5.0, "D": 2.0, "A": 1.6, "E": 1.0, "ME": 0.25, "c": 1.0})


def test_what_no_input_tells_is_named() -> None:
    drive = pmfid.Drive(2.0, offset=True)
    case = problem()
    nominal = {**case.nominal, "offset": 0.1}
    both = replace(case, drive=drive, nominal=nominal, unknown=("coulomb_friction", "offset"))
    known = replace(both, prior=np.diag([0.0, 100.0]))
    check_identifiable(known, affine(known))
    still = replace(case, directions=(0,) * 20)
    refused(
        ("coulomb_friction from offset", lambda: check_identifiable(both, affine(both))),
        ("does not depend on mass", lambda: check_identifiable(still, affine(still))),
        kind=pmfid.NotIdentifiableError,
    )


def test_bad_problems_and_limits_are_named() -> None:
    narrow = Limits(input=3.0, position=(0.0, 0.4))
    refused(
        ("intervals must be a whole number", lambda: problem(intervals=0)),
        ("horizon must be positive", lambda: problem(horizon=-1.0)),
        ("at least one unknown", lambda: problem(unknown=())),
        ("did you mean 'mass'", lambda: problem(unknown=("mas",))),
        ("must be given", lambda: problem(nominal={"mass": 1.0})),
        ("give resolution", lambda: problem(resolution=None)),
        ("prior must be", lambda: problem(prior=np.eye(2))),
        ("semidefinite", lambda: problem(prior=-np.eye(3))),
        ("interval of rest", lambda: problem(directions=(1,) * 10 + (-1,) * 10)),
        ("directions must hold", lambda: problem(directions=(1,))),
        ("directions never lead", lambda: problem(end=(-0.1, 0.0))),
        ("outside the position limit", lambda: problem(end=(9.0, 0.0), limits=narrow)),
        ("limit input must be", lambda: Limits(input=-1.0)),
        ("limit position must be", lambda: Limits(position=(1.0, 0.0))),
        ("limit jerk must be", lambda: Limits(jerk=0.0)),
        ("limit min_speed must be", lambda: Limits(min_speed=-0.1)),
    )

"""Model checks are quiet for a right model and clear for a wrong one, and the figures have labels."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest

import pmfid
from pmfid.config.axis import load_axis
from pmfid.diagnostics.balance import Balance, make_balance
from pmfid.estimators.registry import methods_for
from pmfid.findings import Finding, make_notes
from pmfid.models.equation import VISCOUS_FORWARD
from pmfid.pipeline.identify import identify
from pmfid.pipeline.result import DriveResult
from pmfid.records.record import Record, read_record
from pmfid.report import checks
from pmfid.report.result import write_result
from pmfid.simulation.scenarios import CART, CART_DT, resolution_of
from pmfid.simulation.signals import prbs
from tests.conftest import EMPS, TRUTH, cart_run, long_unless, needs_emps, unjudged

EXAMPLES = Path(__file__).parents[1] / "examples"
WARNING = "Warning:"
HEADINGS = (
    "Simulated from the input alone",
    "Residual over velocity and position",
    "Friction over velocity",
    "Correlation of the residual",
)
STEPS = 10

Friction = Callable[[float], float]


def balance_of(result: DriveResult) -> Balance | None:
    return make_balance(result.estimator, result.record.u, result.record.counts, result.theta)


def result_of(u: np.ndarray, counts: np.ndarray, resolution: float, method: str = "iv") -> DriveResult:
    """Identify without the status and sentences of `judge`, which the checks do not use."""
    record = Record(u, counts, CART_DT, resolution, (), "cart")
    axis = load_axis(EXAMPLES / "cart.toml", {"estimator.method": method, "estimator.forgetting": 1.0})
    with unjudged():
        return identify(record, axis)


@cache
def clean(method: str = "iv", increments: int = 4096, seed: int = 1) -> DriveResult:
    run = cart_run(seed, increments=increments)
    return result_of(run.u, run.counts, run.encoder.resolution, method)


def other_drive(friction: Friction, spring: float = 0.0, load: float = 0.0, seed: int = 3) -> DriveResult:
    """Simulate the cart with another friction [N] over speed, by Runge-Kutta; a step through rest ends at rest."""
    rng = np.random.default_rng(seed)
    u = prbs(3000, clock=20, amplitude=3.0, rng=rng) * rng.choice([0.5, 0.75, 1.0], 3000 // 20).repeat(20)
    x = v = 0.0
    positions, h = [], CART_DT / STEPS
    for force in (CART.input_gain * u - load).tolist():
        positions.append(x)
        for _ in range(STEPS):
            x, v = _step(x, v, force, h, friction, spring)
    resolution = resolution_of(4096)
    return result_of(u, pmfid.quantize(positions, resolution), resolution)


def _step(x: float, v: float, force: float, h: float, friction: Friction, spring: float) -> tuple[float, float]:
    if v == 0.0 and abs(force - spring * x) <= friction(0.0):
        return x, 0.0
    way = math.copysign(1.0, v if v != 0.0 else force - spring * x)

    def slope(x: float, v: float) -> float:
        return (force - spring * x - way * friction(max(way * v, 0.0))) / CART.mass

    a1 = slope(x, v)
    a2 = slope(x + h / 2 * v, v + h / 2 * a1)
    a3 = slope(x + h / 2 * v, v + h / 2 * a2)
    a4 = slope(x + h * v, v + h * a3)
    v_new = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    return x + h * (v + v_new) / 2, v_new if way * v_new > 0 else 0.0


def linear(speed: float) -> float:
    return CART.coulomb_friction + CART.viscous_friction * speed


def stribeck(speed: float) -> float:
    return linear(speed) + 1.0 * math.exp(-((speed / 0.08) ** 2))


def quadratic(speed: float) -> float:
    return CART.coulomb_friction + 4.0 * speed + 20.0 * speed**2


def sentences(result: DriveResult) -> dict[str, str]:
    return {section.heading.removeprefix("Model check: "): section.text for section in checks.model_checks(result)}


@pytest.mark.parametrize(
    ("increments", "seed"),
    long_unless(lambda increments, seed: (increments, seed) == (512, 1), product([4096, 512, 128], [1, 2, 3, 4])),
)
def test_the_right_model_is_left_in_peace(increments: int, seed: int) -> None:
    said = sentences(clean(increments=increments, seed=seed))
    assert tuple(said) == HEADINGS
    assert WARNING not in " ".join(said.values()), said


@pytest.mark.parametrize(
    "method",
    long_unless(lambda method: method in ("riv", "bcls", "fit"), sorted(set(methods_for(pmfid.Drive(1.0))) - {"iv"})),
)
def test_every_method_has_calm_checks_on_a_fine_encoder(method: str) -> None:
    said = sentences(clean(method, 16384))
    assert tuple(said) == HEADINGS
    assert WARNING not in " ".join(said.values()), said


OVER = "Residual over velocity and position"
#: A drive with what the model lacks, and what which check says of it.
LACKS: dict[str, tuple[Callable[[], DriveResult], dict[str, str]]] = {
    "stribeck": (lambda: other_drive(stribeck), {OVER: "Warning: the residual changes with velocity"}),
    "quadratic": (
        lambda: other_drive(quadratic),
        {
            OVER: "the residual changes with velocity",
            "Friction over velocity": r"friction is [\d.]+ N \w+ at .* m/s",
        },
    ),
    "spring": (
        lambda: other_drive(linear, spring=3.0),
        {OVER: "Warning: the residual changes with position", "Correlation of the residual": "Warning"},
    ),
    "load": (lambda: other_drive(linear, load=0.3), {OVER: "Set offset = true"}),
}


@pytest.mark.parametrize("lack", LACKS)
def test_what_the_model_lacks_is_seen(lack: str) -> None:
    make, expected = LACKS[lack]
    said = sentences(make())
    assert all(re.search(text, said[heading]) for heading, text in expected.items()), said
    assert ("changes with position" in said[OVER]) == (lack == "spring")


def test_wrong_parameters_do_not_follow() -> None:
    wrong = replace(clean(), theta=TRUTH * [1.0, 1.3, 1.0])
    said = sentences(wrong)
    assert "Warning: the model does not follow" in said["Simulated from the input alone"]
    assert "Warning" in said["Friction over velocity"]


def test_the_residual_is_that_of_the_estimator_and_the_velocities_lie_on_each_other() -> None:
    result = clean()
    balance = balance_of(result)
    assert balance is not None
    assert result.fit is not None
    np.testing.assert_allclose(balance.residual, result.fit.residual, atol=1e-6)
    assert 99.0 < balance.fit <= 100.0
    # the columns have the delay of the velocity: the viscous force is d times it
    viscous = balance.part(VISCOUS_FORWARD)
    np.testing.assert_allclose(viscous, result.theta[1] * balance.measured, atol=1e-9)


def test_with_a_coarse_encoder_the_velocity_is_that_of_the_model() -> None:
    fine, coarse = balance_of(clean()), balance_of(clean(increments=64))
    assert fine is not None
    assert coarse is not None
    assert fine.velocity is fine.measured
    assert coarse.velocity is coarse.simulated


def test_a_mass_below_zero_is_said_instead() -> None:
    wrong = replace(clean(), theta=TRUTH * [-1.0, 1.0, 1.0])
    assert list(sentences(wrong)) == ["Model checks"]


def test_every_axis_has_a_label_with_its_unit() -> None:
    balance = balance_of(clean())
    assert balance is not None
    draws = (
        checks.simulation_figure,
        checks.residual_figure,
        checks.friction_figure,
        checks.correlation_figure,
    )
    for draw in draws:
        labels = [label for axes in draw(balance).axes for label in (axes.get_xlabel(), axes.get_ylabel()) if label]
        assert len(labels) >= 2
        assert all(re.fullmatch(r"(?s).+ \[.+\]", label) for label in labels), labels


def test_a_coarse_encoder_in_the_loop_is_named_as_a_cause() -> None:
    result = clean(increments=128)
    remark = "Record an open-loop motion"
    assert remark not in sentences(result)["Residual over velocity and position"]
    looped = replace(result, findings=(Finding("feedback", "the input follows"),))
    assert remark in sentences(looped)["Residual over velocity and position"]


def test_with_forgetting_only_the_last_memories_are_judged() -> None:
    run = cart_run(1)
    record = Record(run.u, run.counts, CART_DT, run.encoder.resolution, (), "cart")
    result = identify(record, load_axis(EXAMPLES / "cart.toml", {"estimator.forgetting": 0.995}))
    balance = balance_of(result)
    assert balance is not None
    assert balance.t[-1] - balance.t[0] == pytest.approx(6.0, abs=0.02)
    assert "3 times the memory" in checks.model_checks(result)[0].text


def test_report_has_the_motion_first_and_the_other_checks_last(tmp_path: Path) -> None:
    result = replace(clean(), findings=tuple(make_notes("x", ["one", "two"])))
    write_result(tmp_path, result)
    page = (tmp_path / "report.html").read_text("utf-8")
    found = re.findall(r"<h2>(?:Model check: )?(.*)</h2>", page)
    assert [found[1], *found[-3:]] == list(HEADINGS)
    assert "<p>Note: one.</p>\n<p>Note: two.</p>" in page
    assert "input [N]" in page
    assert "unit of u" not in page


@needs_emps
@pytest.mark.long
def test_emps_report_has_the_checks(tmp_path: Path) -> None:
    axis = load_axis(EXAMPLES / "emps.toml", {"estimator.method": "iv"})
    result = identify(read_record(EMPS, axis), axis)
    said = sentences(result)
    assert tuple(said) == HEADINGS
    assert "The model follows the measured motion" in said["Simulated from the input alone"]
    assert "Warning: the residual changes with velocity" in said["Residual over velocity and position"]
    write_result(tmp_path, result)
    page = (tmp_path / "report.html").read_text("utf-8")
    assert all(f"Model check: {heading}" in page for heading in HEADINGS)
    assert len(page) < 2_000_000

"""The check of a model in a report: the motion that the input alone gives."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pmfid.config.axis import load_axis
from pmfid.estimators.registry import methods_for
from pmfid.findings import make_notes
from pmfid.models.drive import Drive
from pmfid.pipeline.identify import identify
from pmfid.pipeline.result import DriveResult
from pmfid.records.record import Record
from pmfid.report.result import write_result
from pmfid.simulation.scenarios import CART_DT
from tests.conftest import TRUTH, cart_run, long_unless, unjudged

EXAMPLES = Path(__file__).parents[1] / "examples"


def result_of(method: str, increments: int = 16384, forgetting: float = 1.0) -> DriveResult:
    """Identify the cart without the status and sentences of `judge`, which the check does not use."""
    run = cart_run(1, increments=increments)
    record = Record(run.u, run.counts, CART_DT, run.encoder.resolution, (), "cart")
    axis = load_axis(EXAMPLES / "cart.toml", {"estimator.method": method, "estimator.forgetting": forgetting})
    with unjudged():
        result = identify(record, axis)
    assert isinstance(result, DriveResult)
    return result


@pytest.mark.parametrize(
    "method", long_unless(lambda method: method in ("riv", "bcls", "fit"), sorted(methods_for(Drive(1.0))))
)
def test_the_right_model_follows(method: str) -> None:
    run = result_of(method).free_run()
    assert run.fit is not None
    assert run.fit > 99.0


def test_wrong_parameters_do_not_follow() -> None:
    run = replace(result_of("iv"), theta=TRUTH * [1.0, 1.3, 1.0]).free_run()
    assert run.fit is not None
    assert run.fit < 95.0


def test_with_forgetting_the_last_memories_are_judged() -> None:
    run = result_of("riv", 4096, 0.995).free_run()
    assert run.t[-1] - run.t[0] == pytest.approx(6.0, abs=0.02)
    assert np.max(np.abs(run.error)) < 0.01 * np.ptp(run.measured)


def test_the_report_has_the_check_second(tmp_path: Path) -> None:
    result = replace(result_of("iv"), findings=tuple(make_notes("x", ["one", "two"])))
    write_result(tmp_path, result)
    page = (tmp_path / "report.html").read_text("utf-8")
    assert re.findall(r"<h2>(.*?)</h2>", page)[1] == "Model check: simulated from the input alone"
    assert re.search(r"Fit: (99|100)\.\d\d %", page)
    assert "<p>Note: one.</p>\n<p>Note: two.</p>" in page
    assert "input [N]" in page
    assert "unit of u" not in page


def test_a_mass_below_zero_is_said_instead(tmp_path: Path) -> None:
    write_result(tmp_path, replace(result_of("iv"), theta=TRUTH * [-1.0, 1.0, 1.0]))
    assert "This check is not possible: mass = -" in (tmp_path / "report.html").read_text("utf-8")

"""Checks of logs with wrong columns: a set point as the input, unrelated columns, and the steps of a coarse sensor."""

from __future__ import annotations

import pytest

from pmfid.config.axis import Axis
from pmfid.findings import Finding
from pmfid.pipeline.checks import check_record
from pmfid.pipeline.checks.view import CheckedLog
from pmfid.records.record import record_of
from pmfid.types import Floats
from tests.first_guess.bench import simulate


def log_of(u: Floats, y: Floats, dt: float, kind: str, resolution: float, names: tuple[str, str]) -> CheckedLog:
    axis = Axis.model_validate(
        {
            "record": {"input": names[0], "output": names[1], "dt": dt, "output_kind": kind},
            "encoder": {"resolution": resolution},
            "model": {"input_gain": 1.0},
        }
    )
    return CheckedLog(record_of({names[0]: u, names[1]: y}, axis), axis)


def findings(log: CheckedLog) -> dict[str, Finding]:
    return {finding.code: finding for finding in check_record(log.record, log.axis)}


@pytest.mark.parametrize(
    ("names", "severity"), [(("n_set", "n"), "wrong"), (("r", "y"), "wrong"), (("input", "speed"), "doubt")]
)
def test_a_set_point_of_the_speed_is_no_force(names: tuple[str, str], severity: str) -> None:
    """Such a closed loop once gave a mass of 0.0231 kg without a doubt."""
    run = simulate("speed", 3)
    found = findings(log_of(run["goal_speed"][::5], run["velocity"][::5], 0.005, "velocity", 1e-6, names))
    assert found["command"].severity == severity
    assert "gain 1.0" in found["command"].sentence or "set point" in found["command"].sentence

"""`pmfid init` finds time, input and output in logs of four loggers, with names in English and German and without."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from pmfid.config.axis import load_axis
from pmfid.pipeline.guess.axis_file import guess
from pmfid.pipeline.guess.roles import role_of
from pmfid.pipeline.identify import identify, kind_of
from tests.conftest import unjudged
from tests.first_guess.logs import LOGS, Log
from tests.refusals import refused


@pytest.mark.parametrize(
    ("seed", "log"), list(enumerate(LOGS)), ids=[f"{log.logger} {', '.join(log.columns)}" for log in LOGS]
)
def test_the_columns_of_a_log_are_found(tmp_path: Path, seed: int, log: Log) -> None:
    path = log.write(tmp_path, seed)
    if log.answer is None:
        refused((r"no column|no two columns|grows evenly", lambda: guess(path)))
        return
    record = tomllib.loads(guess(path).text)["record"]
    assert (record.get("time", ""), record["input"], record["output"]) == log.answer


@pytest.mark.parametrize(
    ("columns", "sentence"),
    [
        ({"t": "t", "Sollposition": "goal", "Strom": "current"}, "Sollposition is a set point, Strom is an input"),
        ({"t": "t", "q_des": "goal", "q": "position"}, "no column holds the force that drives q; .* u = q_des - q"),
        ({"t": "t", "F": "force", "x": "status"}, r"no two columns|--output"),
        ({"t": "t", "a": "warm", "b": "ripple"}, r"explains [\d.]+ % of .*next best: --input . --output ."),
    ],
)
def test_a_log_without_an_axis_is_refused_with_what_it_has(
    tmp_path: Path, columns: dict[str, str], sentence: str
) -> None:
    refused((sentence, lambda: guess(Log("controller", "servo", columns, None).write(tmp_path, 5))))


@pytest.mark.parametrize(
    ("name", "role"),
    [
        ("Motorstrom [A]", "input"),
        ("u_in", "input"),
        ("Lage_Soll", "other"),
        ("q_d", "other"),
        ("qd", "velocity"),
        ("dq", "velocity"),
        ("ActVelo", "velocity"),
        ("0x6064 Position actual value", "position"),
        ("motor_position", "position"),
        ("position_error", "other"),
        ("F_ist", "input"),
        ("x/m", "position"),
        ("n/min-1", "velocity"),
        ("Torque (N∙m)", "input"),
        ("Zählerstand", "counts"),
        ("Zeit/ms", "time"),
        ("v_rad_s", "velocity"),
    ],
)
def test_the_role_in_a_name(name: str, role: str) -> None:
    assert role_of(name) == role


CASES = Path(__file__).parents[2] / "shared" / "data" / "cases"


@pytest.mark.skipif(not CASES.exists(), reason="the shared cases are absent")
@pytest.mark.parametrize(
    ("name", "answer", "theta"),
    [
        ("01-name-u_in/log.csv", ("time_exp", "u_in", "q_meas"), (0.5, 0.4, 0.1)),
        ("03-mat-one-matrix/log.mat", ("data_1", "data_2", "data_3"), (5e-4, 4e-4, 0.1)),
        ("04-stray-line/log.dat", ("", "PWM", "mStep"), (2.0, 1.0, 8.0)),
        ("07-time-in-ms-100/log.csv", ("time(ms)", "inputSignal(8bits)", "encoder(steps)"), (20.0, 10.0, 30.0)),
        ("13-velocity-uneven-clock/position.csv", ("time_s", "torque_Nm", "position_rad"), (0.5, 0.4, 0.1)),
        ("13-velocity-uneven-clock/velocity.csv", ("time_s", "torque_Nm", "velocity_rad_s"), (0.5, 0.4, 0.1)),
    ],
)
def test_shared_cases_are_right_from_init_to_identify(
    tmp_path: Path, name: str, answer: tuple[str, str, str], theta: tuple[float, float, float]
) -> None:
    text = guess(CASES / name).text.replace("dt = 0.001  #", "dt = 0.01  #")  # in the preface of the log
    record = tomllib.loads(text)["record"]
    assert (record.get("time", ""), record["input"], record["output"]) == answer
    (tmp_path / "AXIS.toml").write_text(text, encoding="utf-8")
    axis = load_axis(tmp_path / "AXIS.toml")
    kind = kind_of(axis)
    with unjudged():
        result = identify(kind.read([CASES / name], axis), axis)
    assert result.theta[:3] == pytest.approx(theta, rel=0.02)

"""`pmfid actuators`: the joints of a log, by the names of its columns."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner, Result

from pmfid.actuators.logs import LogLayout, read_joints
from pmfid.cli.main import main
from pmfid.io.tables import ClockedSignals, Signal
from pmfid.types import Floats
from tests.refusals import refused
from tests.test_actuators import STEP, TRUTH, make_log


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of two joints, the first in degrees, and the second at rest."""
    t, goal, position = make_log(gravity=0.0, kd=0.0)
    deg = math.degrees(1.0)
    columns = {"time_ms": 1e3 * t, "goal_1_deg": goal * deg, "position_1_deg": position * deg, "speed_1": 0 * t}
    path = tmp_path_factory.mktemp("arm") / "arm.csv"
    pl.DataFrame({**columns, "goal_2": 0 * t, "position_2": 0 * t}).write_csv(path)
    return path


def call(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["actuators", *map(str, arguments)])


def test_every_joint_of_a_log_has_an_estimate_or_a_reason(arm: Path, tmp_path: Path) -> None:
    words = (arm, "--bits", 12, "--given", "1.kp=8", "--given", "1.kd=0", "--no-search")
    result = call(*words, "--json", "--out", tmp_path)
    assert (result.exit_code, result.stderr) == (0, "")
    joints = json.loads(result.stdout)["joints"]
    for name in ("inertia", "viscous", "coulomb", "delay"):
        own = joints["1"]["parameters"][name]
        assert abs(own["value"] - TRUTH[name]) < min(0.05 * TRUTH[name], 4 * own["std"]), name
    assert joints["1"]["status"] == []
    assert "hardly moves" in joints["2"]["refused"]
    assert json.loads((tmp_path / "actuators.json").read_text())["joints"] == joints
    page = (tmp_path / "actuators.html").read_text()
    assert "kg m2" in page
    assert "hardly moves" in page


def test_the_terminal_shows_one_table_and_the_status_of_each_joint(arm: Path) -> None:
    result = call(arm, "--bits", 12, "--no-search")
    assert result.exit_code == 0
    assert "inertia/kp" in result.stdout
    assert "1: status: none" in result.stdout
    assert "2: status: refused: the servo hardly moves" in result.stdout
    assert "give kp, the inertia, or gravity (m g l), as in --given kp=8" in result.stdout


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["--goal", "aim_*"], 2, "no column matches 'aim_*'"),
        (["--goal", "goal_2", "--position", "position_2", "--bits", "12"], 3, "hardly moves"),
        (["--unit", "counts"], 2, "--bits or --resolution"),
        (["--bits", "12", "--resolution", "0.1"], 2, "give only one of them"),
        (["--bits", "12", "--given", "kp"], 2, "write --given kp=8"),
        (["--bits", "12", "--given", "3.kp=8"], 2, "the joints are 1, 2"),
        (["--bits", "12", "--term", "grafity"], 2, "did you mean 'gravity'"),
        (["--resolution", "nan"], 2, "must be positive"),
    ],
)
def test_a_log_of_no_use_has_one_line_with_a_remedy(arm: Path, words: list[str], code: int, message: str) -> None:
    result = call(arm, *words)
    assert (result.exit_code, result.stderr.count("\n")) == (code, 1)
    assert message in result.stderr


def test_a_log_of_bam_states_its_pendulum(tmp_path: Path) -> None:
    entries = [{"position": STEP * k, "goal_position": 0.1 * k, "timestamp": 0.02 * k} for k in range(99)]
    (tmp_path / "log.json").write_text(json.dumps({"mass": 1.0, "length": 0.1, "entries": entries}))
    (log,) = read_joints(tmp_path / "log.json", LogLayout())
    assert log.given["gravity"] == pytest.approx(0.980665)
    assert log.resolution == pytest.approx(STEP)
    held = [entry | {"torque_enable": k < 60} for k, entry in enumerate(entries)]
    (tmp_path / "log.json").write_text(json.dumps({"mass": 1.0, "length": 0.1, "entries": held}))
    (log,) = read_joints(tmp_path / "log.json", LogLayout())
    assert log.on is not None
    assert log.on.sum() == 60
    assert "the torque is off in 39 rows, in which the joint moves freely" in log.notes
    (tmp_path / "log.json").write_text('{"a": 1}')
    refused(("no log of BAM", lambda: read_joints(tmp_path / "log.json", LogLayout())))


@pytest.mark.parametrize("names", [["pan.pos", "lift.pos"], {"motors": ["pan", "lift"]}])
def test_an_episode_of_a_data_set_of_lerobot(names: object, tmp_path: Path) -> None:
    (tmp_path / "meta").mkdir()
    (tmp_path / "data/chunk-000").mkdir(parents=True)
    features = {"action": {"names": names}, "observation.state": {"names": names}}
    (tmp_path / "meta/info.json").write_text(json.dumps({"features": features}))
    episode = np.repeat([0, 1], [30, 50])
    t, number = np.concatenate([np.arange(30), np.arange(50)]) / 30, np.arange(80.0)
    lists = {"action": [[k, -k] for k in number], "observation.state": [[k + 1, -k - 1] for k in number]}
    frame = pl.DataFrame({**lists, "timestamp": t, "episode_index": episode})
    frame.write_parquet(tmp_path / "data/chunk-000/file-000.parquet")
    logs = read_joints(tmp_path, LogLayout(unit="deg", resolution=STEP))
    assert [log.name for log in logs] == ["pan", "lift"]
    assert np.degrees(logs[1].goal) == pytest.approx(-number[30:])
    assert np.degrees(logs[0].position) == pytest.approx(number[30:] + 1)
    assert logs[0].t == pytest.approx(np.arange(50) / 30)
    (first, _) = read_joints(tmp_path, LogLayout(unit="rad", resolution=STEP, episode=0))
    assert first.goal == pytest.approx(number[:30])
    refused(("does not state its unit", lambda: read_joints(tmp_path, LogLayout(resolution=STEP))))
    refused(("no episode 7", lambda: read_joints(tmp_path, LogLayout(unit="rad", resolution=STEP, episode=7))))


def test_a_folder_of_sage_has_a_clock_for_commands_and_one_for_states(tmp_path: Path) -> None:
    (tmp_path / "joint_list.txt").write_text("hip\nknee\n")
    control = [f'CONTROL,{20000 * k},"[{k}.0, {-k}.0]"' for k in range(99)]
    state = [f'STATE_MOTOR,{20000 * k + 5000},"[{k + 0.5}, {k + 0.7}]","[0, 0]","[0, 0]"' for k in range(99)]
    (tmp_path / "control.csv").write_text("\n".join(["type,timestamp,positions", *control]))
    (tmp_path / "state_motor.csv").write_text("\n".join(["type,timestamp,positions,velocities,torques", *state]))
    hip, knee = read_joints(tmp_path, LogLayout(resolution=STEP))
    assert (hip.name, knee.name) == ("hip", "knee")
    assert hip.t == pytest.approx(0.02 * np.arange(99))
    assert knee.goal == pytest.approx(-np.arange(99.0))
    assert hip.position == pytest.approx(np.arange(99) + 0.5)
    (tmp_path / "state_motor.csv").write_text("a,b\n1,2\n")
    refused(("no folder of SAGE", lambda: read_joints(tmp_path, LogLayout(resolution=STEP))))


# --- checks of a log --------------------------------------------------------------------------------------------------


def test_a_joint_at_rest_or_without_an_encoder_step_does_not_stop_the_others(tmp_path: Path) -> None:
    t, goal, position = make_log(1, gravity=0.0, kd=0.0)
    smooth = position + np.random.default_rng(0).normal(0, 1e-4, t.size)
    columns = {"t": t, "goal_1": goal, "position_1": smooth, "goal_2": 0 * t, "position_2": 0 * t + 0.3}
    pl.DataFrame(columns).write_csv(tmp_path / "arm.csv")
    result = call(tmp_path / "arm.csv", "--given", "1.kp=8", "--given", "1.kd=0", "--no-search")
    assert result.exit_code == 0
    assert "inertia" in result.stdout
    assert "2: status: refused: the servo hardly moves" in result.stdout
    assert "show no step of an encoder" in result.stdout


def test_two_logs_are_fitted_at_once_and_a_parameter_may_differ(tmp_path: Path) -> None:
    for seed, gain in ((1, 8.0), (2, 16.0)):
        t, goal, position = make_log(seed, kp=gain, kd=0.0, gravity=0.0, time=5.0)
        pl.DataFrame({"t": t, "goal_1": goal, "position_1": position}).write_csv(tmp_path / f"{seed}.csv")
    known = ["--bits", 12, "--given", "inertia=0.01", "--given", "kd=0", "--no-search"]
    words = [tmp_path / "1.csv", tmp_path / "2.csv", *known]
    assert "give --per-log kp" in call(*words).stdout
    found = json.loads(call(*words, "--per-log", "kp", "--json").stdout)["joints"]["1"]
    assert found["logs"] == 2
    for name, gain in (("kp.1", 8.0), ("kp.2", 16.0)):
        assert found["parameters"][name]["value"] == pytest.approx(gain, rel=0.02)


FEETECH, DYNAMIXEL = lambda n: np.where(n < 0, 2**15 - n, n), lambda n: np.where(n < 0, n + 2**32, n)


@pytest.mark.parametrize("encode", [FEETECH, DYNAMIXEL, lambda n: n])
def test_registers_of_servos_are_steps_with_a_sign_bit(encode: Callable[[Floats], Floats], tmp_path: Path) -> None:
    """As radians, the range was 650 times too large, and a negative step a jump of five turns."""
    t, goal, position = make_log(gravity=0.0, kd=0.0)
    steps = {"Goal_Position": np.round(goal / STEP), "Present_Position": np.round(position / STEP)}
    steps, path = {**steps, "Torque Enable": 1.0 * (t < 5)}, tmp_path / "registers.csv"
    pl.DataFrame({"time": t, **{name: encode(values).astype(int) for name, values in steps.items()}}).write_csv(path)
    (log,) = read_joints(path, LogLayout())
    assert (log.resolution, np.sum(log.on)) == (pytest.approx(math.tau / 4096), 500)
    assert log.position == pytest.approx(steps["Present_Position"] * math.tau / 4096)
    assert log.goal == pytest.approx(steps["Goal_Position"] * math.tau / 4096)


NAMES = [("Goal Position (rad)", "Present Position (rad)"), ("q1_des", "q1"), ("theta_ref", "theta")]


@pytest.mark.parametrize(("goal", "position"), [*NAMES, ("arm_commanded_position", "arm_measured_position")])
def test_names_of_other_loggers(goal: str, position: str, tmp_path: Path) -> None:
    t, commanded, measured = make_log(gravity=0.0, kd=0.0)
    pl.DataFrame({"time": t, goal: commanded, position: measured}).write_csv(tmp_path / "log.csv")
    (log,) = read_joints(tmp_path / "log.csv", LogLayout())
    assert (log.goal[1], log.position[-1]) == pytest.approx((commanded[1], measured[-1]))


@pytest.mark.parametrize(
    ("state", "command"),
    [
        ("/joint_states.position", "/forward_position_controller/commands.data"),
        ("/joint_states.position", "/joint_command.position"),
        ("/arm/controller_state.feedback.positions", "/arm/controller_state.reference.positions"),
    ],
)
def test_topics_of_a_bag(state: str, command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    t, goal, position = make_log(gravity=0.0, kd=0.0)
    same = "controller_state" in command
    sent, sent_goal = (t, goal) if same else (t[:-1:2] + 1e-3, goal[:-1:2])
    signals = {f"{state}.1": Signal(t, position), f"{state}.0": Signal(t, 0 * t)}
    signals |= {f"{command}.1": Signal(sent, sent_goal), f"{command}.0": Signal(sent, 0 * sent)}
    monkeypatch.setattr("pmfid.io.reading.read_table", lambda _: ClockedSignals(signals))
    logs = {log.name: log for log in read_joints(tmp_path / "bag.mcap", LogLayout(resolution=STEP))}
    assert list(logs) == ["1", "0"]
    last = np.searchsorted(sent, t, side="right") - 1
    assert logs["1"].t[0] == 0.0
    assert np.array_equal(logs["1"].position, position[last >= 0])
    assert np.array_equal(logs["1"].goal, sent_goal[last[last >= 0]])

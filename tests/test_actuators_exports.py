"""Exports of servos: each file has the estimates, and MuJoCo moves as the fit predicts."""

from __future__ import annotations

import json
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from pmfid.actuators import Servo, fit_servo, simulate_servo
from pmfid.actuators.exports import make_files
from pmfid.actuators.joints import FittedJoint
from pmfid.actuators.logs import JointLog
from pmfid.types import Floats
from tests.test_actuators import STEP, make_log

NAME = 'knee "left" <--2>'


def fit_joint(seed: int, given: dict[str, float], terms: list[str], **truth: float) -> FittedJoint:
    log = make_log(seed, **truth)
    return FittedJoint([JointLog(NAME, *log, STEP)], fit_servo(Servo(STEP, given, terms), *log, search=False))


@pytest.fixture(scope="module")
def pendulum() -> FittedJoint:
    given = {"kp": 8.0, "kd": 0.02, "gravity_angle": 0.0, "torque_limit": 5.0}
    return fit_joint(1, given, ["gravity"], torque_limit=5.0)


@pytest.fixture(scope="module")
def free() -> FittedJoint:
    return fit_joint(3, {"kd": 0.0}, [], gravity=0.0, kd=0.0)


def estimates(joint: FittedJoint) -> dict[str, float]:
    assert joint.fit is not None
    return dict(zip(joint.fit.raw_names, joint.fit.theta.tolist(), strict=True))


def test_mjcf_and_urdf_have_the_estimates(pendulum: FittedJoint) -> None:
    files, theta = make_files([pendulum]), estimates(pendulum)
    root = ElementTree.fromstring(files["servos.xml"])
    joint, servo, mass = (next(root.iter(tag)) for tag in ("joint", "position", "inertial"))
    length = -float(mass.attrib["pos"].split()[2])
    damping, kv = float(joint.attrib["damping"]), float(servo.attrib["kv"])
    total = float(joint.attrib["armature"]) + float(mass.attrib["diaginertia"].split()[1])
    total += 0.5e-3 * (damping + kv) + 1e-3 * 0.02  # the integrator's own, and the age of the velocity in the loop
    assert joint.attrib["name"] == servo.attrib["joint"] == NAME
    assert total + float(mass.attrib["mass"]) * length**2 == pytest.approx(theta["inertia"], rel=1e-6)
    assert float(mass.attrib["mass"]) * length * 9.80665 == pytest.approx(theta["gravity"], rel=1e-6)
    assert damping == pytest.approx(theta["viscous"])
    assert float(joint.attrib["frictionloss"]) == pytest.approx(theta["coulomb"])
    assert (servo.attrib["kp"], servo.attrib["forcerange"]) == ("8", "-5 5")
    assert kv == pytest.approx(0.02 - 0.5e-3 * 8.0)
    assert float(servo.attrib["delay"]) == pytest.approx(theta["delay"] + 0.5e-3)
    robot = ElementTree.fromstring(files["servos.urdf"])
    dynamics, limit = robot.find(".//dynamics"), robot.find(".//limit")
    assert dynamics is not None
    assert limit is not None
    assert float(dynamics.attrib["damping"]) == pytest.approx(theta["viscous"])
    assert float(dynamics.attrib["friction"]) == pytest.approx(theta["coulomb"])
    assert float(limit.attrib["effort"]) == 5.0
    assert "inertia 0.0" in files["servos.urdf"]
    assert "not in this file: kp, kd, delay" in files["servos.urdf"]


def test_the_other_files_have_the_estimates_by_their_own_names(pendulum: FittedJoint, free: FittedJoint) -> None:
    files, theta = make_files([pendulum]), estimates(pendulum)
    lines = [line.partition("  #")[0].split(": ") for line in files["servos.yaml"].splitlines()]
    isaac = {line[0].strip(): float(line[1]) for line in lines if len(line) == 2 and line[0].startswith("    ")}
    assert isaac["armature"] == pytest.approx(theta["inertia"])
    assert isaac["friction"] == isaac["dynamic_friction"] == pytest.approx(theta["coulomb"])
    assert (isaac["stiffness"], isaac["damping"], isaac["effort_limit"]) == (8.0, 0.02, 5.0)
    wpilib = json.loads(files["wpilib.json"])[NAME]
    assert wpilib["kA"] == pytest.approx(theta["inertia"])
    assert wpilib["kG"] == pytest.approx(theta["gravity"])
    assert 0 < wpilib["std"]["kA"] < 0.1 * wpilib["kA"]
    (bam,) = (json.loads(text) for name, text in files.items() if name.startswith("bam_"))
    assert (bam["model"], bam["armature"]) == ("m1", pytest.approx(theta["inertia"]))
    stated = replace(pendulum.log, stated={"pendulum": 0.004, "motor": "sts3215"})
    bench = next(text for name, text in make_files([replace(pendulum, logs=[stated])]).items() if "bam_" in name)
    assert json.loads(bench)["actuator"] == "sts3215"
    assert json.loads(bench)["armature"] == pytest.approx(theta["inertia"] - 0.004)
    assert bam["friction_base"] == pytest.approx(theta["coulomb"])
    relative = make_files([free])
    assert all("torques are multiples of kp" in text for text in relative.values())
    assert 'kp="1"' in relative["servos.xml"]


@pytest.mark.parametrize("fitted", [False, True])
def test_a_joint_without_an_inertia_is_left_out(pendulum: FittedJoint, fitted: bool) -> None:
    fit = replace(pendulum.fit, theta_std=9 * np.abs(pendulum.fit.theta)) if fitted and pendulum.fit else None
    files = make_files([FittedJoint(pendulum.logs, fit, "hardly moves")])
    assert all(NAME not in text for text in files.values())
    assert ElementTree.fromstring(files["servos.xml"]).find(".//joint") is None


def replay(text: str, t: Floats, goal: Floats, start: float) -> Floats:
    """Position (n,) of MuJoCo at the times t (n,), which are whole steps of the model."""
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'pmfid[mujoco]'")
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    count, step = int(model.actuator_history[0, 0]), model.opt.timestep
    data.qpos[0], data.ctrl[0] = start, goal[0]
    # Before the log, the goal was its first one. The velocity of this integrator is that of half a step before.
    mujoco.mj_initCtrlHistory(model, data, 0, np.arange(-count, 0) * step, np.full((count, 1), goal[0]))
    mujoco.mj_forward(model, data)
    data.qvel[0] = -0.5 * step * data.qacc[0]
    out = np.empty(t.size)
    for k in range(t.size):
        out[k] = data.qpos[0]
        for _ in range(round((t[min(k + 1, t.size - 1)] - t[k]) / model.opt.timestep)):
            data.ctrl[0] = goal[k]
            mujoco.mj_step(model, data)
    return out


@pytest.mark.parametrize(
    ("given", "terms", "change", "within"),
    [
        ({"kd": 0.0}, [], {"gravity": 0.0, "kd": 0.0}, (0.3, 1.1)),
        ({"kp": 8.0, "kd": 0.02, "gravity_angle": 0.0}, ["gravity"], {}, (0.47, np.inf)),  # 1.104
        # The lag of the loop is damping and inertia in MuJoCo, which act at the limit of the torque as well.
        ({"kp": 8.0, "kd": 0.02, "gravity_angle": 0.0}, ["gravity", "torque_limit"], {"torque_limit": 5.0}, (1.3, 1.1)),
    ],
    ids=["free", "pendulum", "limited"],
)
def test_mujoco_moves_as_the_fit_predicts(
    given: dict[str, float], terms: list[str], change: dict[str, float], within: tuple[float, float]
) -> None:
    joint = fit_joint(1, given, terms, **change)
    assert joint.fit is not None
    t, goal, position = make_log(9, **change)
    known = {"kp": 1.0, **dict.fromkeys(joint.fit.raw_names, 0.0), **joint.fit.values}
    own = simulate_servo(Servo(STEP, known), np.empty(0), t, goal, float(position[0]))
    theirs = replay(make_files([joint])["servos.xml"], t, goal, float(position[0]))
    assert np.sqrt(np.mean((theirs - own) ** 2)) < within[0] * STEP / np.sqrt(12)  # an encoder rounds by as much
    assert np.mean((theirs - position) ** 2) < within[1] ** 2 * np.mean((own - position) ** 2)

"""Two masses in the words of controllers: transfer functions, settings, and a replay by MuJoCo."""

from __future__ import annotations

import numpy as np
import pytest

from pmfid.models.controllers import MotorAndLoad
from pmfid.types import Floats
from tests.oracles import two_mass

BELT = MotorAndLoad(2e-4, 4e-4, 0.01, 3e-4, 6e-4, 0.015, 4.55, 0.0014, rotary=True)
STEP = 0.001


def response(f: float, masses: MotorAndLoad) -> Floats:
    """Return the speeds (2,) of motor and load over the torque, from the equations of motion."""
    s = 2j * np.pi * f
    spring = masses.stiffness / s + masses.damping
    own = np.array([masses.motor * s + masses.viscous, masses.load * s + masses.load_viscous])
    return np.linalg.solve(np.diag(own) + spring * np.array([[1, -1], [-1, 1]]), [1, 0])


@pytest.mark.parametrize("f", [0.5, 20.0, 31.0, 200.0])
def test_the_transfer_functions_are_those_of_the_equations(f: float) -> None:
    for row, output in enumerate(("motor", "load")):
        numerator, denominator = BELT.transfer_function(output)  # type: ignore[arg-type]
        own = np.polyval(numerator, 2j * np.pi * f) / np.polyval(denominator, 2j * np.pi * f)
        assert own == pytest.approx(response(f, BELT)[row], rel=1e-9)


def test_python_control_takes_them() -> None:
    pytest.importorskip("control", reason="python-control is not installed: pip install 'pmfid[control]'")
    assert BELT.to_control("load").dcgain() == pytest.approx(1 / (BELT.viscous + BELT.load_viscous))


def test_the_filter_of_a_drive_leaves_one_mass() -> None:
    """Zeros at the resonance and poles at the antiresonance cancel the spring."""
    found = {one.name: one.value for one in MotorAndLoad(0.2, 0, 0, 0.8, 0, 0, 2000.0, 30.0).settings()}
    peak, dip = 2 * np.pi * found["VL.ARZF1"], 2 * np.pi * found["VL.ARPF1"]
    for w in (3.0, 40.0, 300.0):
        s = 1j * w
        filtered = (s**2 / peak**2 + s / (found["VL.ARZQ1"] * peak) + 1) / (
            s**2 / dip**2 + s / (found["VL.ARPQ1"] * dip) + 1
        )
        plant = response(w / (2 * np.pi), MotorAndLoad(0.2, 0, 0, 0.8, 0, 0, 2000.0, 30.0))[0]
        assert filtered * plant == pytest.approx(1 / (found["total inertia"] * s), rel=1e-9)


def test_the_settings_of_a_belt() -> None:
    found = {one.name: one.value for one in BELT.settings()}
    assert found["notch frequency"] == pytest.approx(31.0, rel=1e-3)
    assert found["load over motor"] == pytest.approx(1.5)
    assert found["controller.config.inertia"] == pytest.approx(2 * np.pi * 5e-4)
    assert found["VL.ARZQ1"] == 5.0


@pytest.mark.parametrize("rotary", [True, False])
def test_mujoco_moves_as_the_masses_do(rotary: bool) -> None:
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'pmfid[mujoco]'")
    values = BELT.motor, BELT.viscous, BELT.coulomb, BELT.load, BELT.load_viscous, BELT.load_coulomb
    masses = MotorAndLoad(*values, BELT.stiffness, BELT.damping, rotary=rotary)
    model = mujoco.MjModel.from_xml_string(masses.to_mjcf())
    data, torque = mujoco.MjData(model), np.repeat(np.random.default_rng(1).uniform(-0.15, 0.15, 60), 12)
    truth = two_mass.simulate_two_masses(
        two_mass.TwoMasses(*values, BELT.stiffness, BELT.damping), torque, STEP, np.zeros(4)
    )
    seen = np.zeros((torque.size + 1, 2))
    for k, now in enumerate(torque):
        data.ctrl[0] = now
        while data.time < (k + 1) * STEP - 0.5 * model.opt.timestep:
            mujoco.mj_step(model, data)
        seen[k + 1] = data.qpos
    apart = seen - truth[:, [0, 2]]
    assert np.max(np.abs(apart)) < 0.01 * np.ptp(truth[:, 0])

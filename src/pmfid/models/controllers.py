"""Two masses in the words of others: transfer functions, settings of controllers, and a model of MuJoCo."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from pmfid.errors import UsageError
from pmfid.models.two_mass import derive
from pmfid.types import Floats

if TYPE_CHECKING:
    import control


@dataclass(frozen=True)
class ControllerSetting:
    """A setting of a controller, by its name there. `controller` is empty for a value that any controller takes."""

    controller: str
    name: str
    value: float
    unit: str


@dataclass(frozen=True)
class MotorAndLoad:
    """A motor and a load on a spring, each with viscous and Coulomb friction, in SI units.

    Examples
    --------
    >>> from pmfid.models.controllers import MotorAndLoad
    >>> belt = MotorAndLoad(2e-4, 4e-4, 0.01, 3e-4, 6e-4, 0.015, 4.55, 0.0014, rotary=True)
    >>> numerator, denominator = belt.transfer_function()
    >>> round(float(numerator[-1] / denominator[-1]), 6), f"{belt.settings()[0].value:.1f}"
    (1000.0, '31.0')
    """

    motor: float
    viscous: float
    coulomb: float
    load: float
    load_viscous: float
    load_coulomb: float
    stiffness: float
    damping: float
    rotary: bool = False

    def transfer_function(self, output: Literal["motor", "load"] = "motor") -> tuple[Floats, Floats]:
        """Return numerator (2,) or (3,) and denominator (4,), highest powers first, of the speed of the motor or the
        load [m/s or rad/s] over the force or torque of the motor [N or N m].

        Coulomb friction is not part of a transfer function.
        """
        spring = np.array([self.damping, self.stiffness])
        motor, load = np.array([self.motor, self.viscous]), np.array([self.load, self.load_viscous])
        free = np.append(np.polymul(motor, load), 0.0)
        above = spring if output == "load" else np.polyadd(np.append(load, 0.0), spring)
        return above, np.polyadd(free, np.polymul(spring, motor + load))

    def to_control(self, output: Literal["motor", "load"] = "motor") -> control.TransferFunction:
        """Return `transfer_function` as a system of python-control.

        Raises UsageError if python-control is not installed.
        """
        try:
            import control
        except ImportError:
            raise UsageError("python-control is not installed; pip install pmfid[control]") from None
        return control.TransferFunction(*self.transfer_function(output))

    def settings(self) -> list[ControllerSetting]:
        """Return the settings of controllers.

        The filter of an AKD drive has its zeros at the resonance and its poles at the antiresonance. The motor then
        moves as one mass. The drive takes qualities up to 5 for zeros, and up to 20 for poles.
        """
        high, low, sharp, blunt, total, ratio = derive(self.motor, self.load, self.stiffness, self.damping).tolist()
        unit = "kg m2" if self.rotary else "kg"
        settings = [
            ControllerSetting("", "notch frequency", high, "Hz"),
            ControllerSetting("", "antiresonance", low, "Hz"),
            ControllerSetting("", "load over motor", ratio, ""),
            ControllerSetting("", "total inertia", total, unit),
            ControllerSetting("LinuxCNC", "biquad.0.f0 (type 2)", high, "Hz"),
            ControllerSetting("LinuxCNC", "pid.0.FF2", total, unit),
            ControllerSetting("Kollmorgen AKD", "VL.ARZF1", high, "Hz"),
            ControllerSetting("Kollmorgen AKD", "VL.ARZQ1", min(5.0, 1 / (2 * sharp)), ""),
            ControllerSetting("Kollmorgen AKD", "VL.ARPF1", low, "Hz"),
            ControllerSetting("Kollmorgen AKD", "VL.ARPQ1", min(20.0, 1 / (2 * blunt)), ""),
            ControllerSetting("Beckhoff TwinCAT", "FB_CTRL_NOTCH_FILTER fNotchFreq", high, "Hz"),
            ControllerSetting("Beckhoff TwinCAT", "FB_CTRL_NOTCH_FILTER fBandwidth", 2 * sharp, ""),
            ControllerSetting("Beckhoff AX2000", "BQFC", math.sqrt(high * low), "Hz"),
        ]
        turns = ControllerSetting("ODrive", "controller.config.inertia", 2 * math.pi * total, "N m s2/turn")
        return [*settings, turns] if self.rotary else settings

    def to_mjcf(self) -> str:
        """Return a model of MuJoCo: two bodies, and a tendon as the spring. The input is the force of the motor.

        A period of the resonance has a thousand steps.
        """
        step = 1e-3 / (float(derive(self.motor, self.load, self.stiffness, self.damping)[0]))
        motor = self._make_body("motor", self.motor, self.viscous, self.coulomb, step)
        load = self._make_body("load", self.load, self.load_viscous, self.load_coulomb, step)
        return f"""<mujoco model="two masses">
  <option timestep="{step:.9g}" integrator="implicitfast" gravity="0 0 0"/>
  <worldbody>
{motor}
{load}
  </worldbody>
  <tendon>
    <fixed name="spring" stiffness="{self.stiffness:.9g}" damping="{self.damping:.9g}">
      <joint joint="motor" coef="1"/>
      <joint joint="load" coef="-1"/>
    </fixed>
  </tendon>
  <actuator>
    <motor name="motor" joint="motor"/>
  </actuator>
</mujoco>
"""

    def _make_body(self, name: str, inertia: float, viscous: float, coulomb: float, step: float) -> str:
        """Return a body with a joint. Its friction is as hard as the step permits."""
        kind = "hinge" if self.rotary else "slide"
        return f"""    <body name="{name}">
      <joint name="{name}" type="{kind}" axis="0 0 1" armature="{0.999 * inertia:.9g}" damping="{viscous:.9g}"
             frictionloss="{coulomb:.9g}" solreffriction="{2 * step:.9g} 1" solimpfriction="0.9999 0.9999 0.001 0.5 2"/>
      <inertial pos="0 0 0" mass="{0.001 * inertia:.9g}" diaginertia="{3 * f" {0.001 * inertia:.9g}"}"/>
    </body>"""

"""Servos as files of simulators: MJCF, URDF, BAM, Isaac and WPILib. Standard errors are comments."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

from pmfid.actuators.fit import ServoFit
from pmfid.actuators.joints import FittedJoint
from pmfid.actuators.servo import UNITS
from pmfid.actuators.tuning import TUNING
from pmfid.errors import printable
from pmfid.presentation import format_pair

#: Parameters that each simulator has. A file names all others in a comment.
XML = ("inertia", "viscous", "coulomb", "kp", "kd", "torque_limit", "delay", "gravity", "gravity_angle")
#: Key of a parameter in Isaac Lab. PACE has the same parameters.
ISAAC: Mapping[str, str] = {
    "stiffness": "kp",
    "damping": "kd",
    "armature": "inertia",
    "friction": "coulomb",
    "dynamic_friction": "coulomb",
    "viscous_friction": "viscous",
    "effort_limit": "torque_limit",
    "delay": "delay",
}
WPILIB: Mapping[str, str] = {"kS": "coulomb", "kV": "viscous", "kA": "inertia", "kG": "gravity"}
BAM: Mapping[str, str] = {
    "armature": "inertia",
    "friction_viscous": "viscous",
    "friction_base": "coulomb",
    "friction_stribeck": "stribeck",
    "dtheta_stribeck": "stribeck_speed",
    "load_friction_base": "load_friction",
    "load_friction_stribeck": "load_stribeck",
    "command_delay": "delay",
}
TOTAL = "inertia is all that turns with the joint, and viscous friction includes the back-EMF"


@dataclass(frozen=True)
class _Axle:
    """A joint with its parameters by name, determined or given, and the standard errors of the determined ones."""

    name: str
    fit: ServoFit
    values: Mapping[str, float]
    std: Mapping[str, float]
    stated: Mapping[str, str | float]

    def get(self, name: str) -> float:
        return self.values.get(name, 0.0)

    def describe(self, name: str) -> str:
        """Return a parameter with its standard error and its unit."""
        unit = UNITS[name][self.fit.servo.relative]
        if name not in self.std:
            return f"{name} {self.get(name):.6g} {unit} (given)"
        return "{} {} ± {} {}".format(name, *format_pair(self.get(name), self.std[name]), unit)

    def remark(self, known: Sequence[str]) -> str:
        """Return all parameters in words, and those that a file does not have."""
        words = ", ".join(self.describe(name) for name in self.values)
        left = [name for name in self.values if name not in known and self.get(name)]
        status = f"; status: {', '.join(self.fit.status)}" if self.fit.status else ""
        relative = "; torques are multiples of kp" if self.fit.servo.relative else ""
        missing = f"; not determined, and left out: {', '.join(self.fit.open)}" if self.fit.open else ""
        left_out = f"; not in this file: {', '.join(left)}" if left else ""
        return f"{self.name}: {words}{relative}{status}{missing}{left_out}"

    @property
    def pendulum(self) -> tuple[float, float]:
        """Mass [kg] at a distance [m] that has the gravity, and at most half of the inertia."""
        gravity = self.get("gravity")
        if not gravity:
            return TUNING.least_mass, 0.0
        length = min(TUNING.longest_arm, 0.5 * self.get("inertia") * TUNING.free_fall / gravity)
        return gravity / (TUNING.free_fall * length), length


def _list_axles(found: Sequence[FittedJoint]) -> list[_Axle]:
    axles = []
    for joint in found:
        if (fit := joint.fit) is not None and "inertia" not in fit.open:
            std = dict(zip(fit.raw_names, fit.theta_std.tolist(), strict=True))
            std = {name: error for name, error in std.items() if name not in fit.open}
            base = {"kp": 1.0} if fit.servo.relative else {}
            values = {name: value for name, value in {**base, **fit.values}.items() if name in UNITS}
            values |= {name: max(value, 0.0) for name, value in values.items() if name == "delay"}
            axles.append(_Axle(printable(joint.log.name), fit, values, std, joint.log.stated))
    return axles


def make_files(found: Sequence[FittedJoint]) -> dict[str, str]:
    """Return the texts of all files by name. A joint without an inertia is left out."""
    axles = _list_axles(found)
    files = {"servos.xml": _make_mjcf(axles), "servos.urdf": _make_urdf(axles), "servos.yaml": _make_isaac(axles)}
    files["wpilib.json"] = json.dumps({own.name: _translate(own, WPILIB) for own in axles}, indent=2) + "\n"
    for number, own in enumerate(axles):
        plain = re.sub(r"[^\w-]", "_", own.name)[:60] or str(number)
        name = f"bam_{plain}.json" if f"bam_{plain}.json" not in files else f"bam_{plain}_{number}.json"
        files[name] = json.dumps(_make_bam(own), indent=2) + "\n"
    return files


# --- XML --------------------------------------------------------------------------------------------------------------


def _comment(text: str) -> str:
    return f"<!-- {re.sub('-(?=-)', '- ', text)} -->"


def _attributes(**values: float | str) -> str:
    return " ".join(
        f"{name}={quoteattr(value) if isinstance(value, str) else quoteattr(f'{value:.9g}')}"
        for name, value in values.items()
    )


@dataclass(frozen=True)
class _Stepped:
    """Parameters with which MuJoCo, in steps of `step` [s], moves as a servo does in continuous time.

    The integrator has velocities half a step before positions, so a goal comes half a step later. Damping is implicit,
    which adds half a step of damping to the inertia. The loop of the servo acts late, which takes damping away from kv.
    No gain kv of MuJoCo is negative, so the rest is taken from the joint, although it acts at the torque limit as well.
    """

    armature: float
    damping: float
    kv: float
    delay: float

    @classmethod
    def convert(cls, own: _Axle, step: float) -> _Stepped:
        period = own.fit.servo.loop_period
        left = own.get("kd") - own.get("kp") * (period / 2 + own.get("loop_delay"))
        kv, damping = max(left, 0.0), max(own.get("viscous") + min(left, 0.0), 0.0)
        armature = own.get("inertia") - step / 2 * (damping + kv) - own.get("kd") * period
        return cls(armature, damping, kv, own.get("delay") + step / 2)


def _make_mjcf(axles: Sequence[_Axle]) -> str:
    """Return a model of MuJoCo in which each servo turns its own pendulum.

    The friction of MuJoCo is a soft constraint, which lets a joint at rest creep. `solreffriction` and `solimpfriction`
    make the constraint as hard as the step permits.
    """
    step = TUNING.mujoco_step
    bodies, servos = [], []
    for number, own in enumerate(axles):
        mass, length = own.pendulum
        stepped, limit = _Stepped.convert(own, step), own.get("torque_limit")
        angle, tiny = own.get("gravity_angle"), TUNING.least_inertia * own.get("inertia")
        three = " ".join(3 * [f"{tiny:.9g}"])
        joint = _attributes(
            name=own.name,
            axis="0 1 0",
            armature=max(stepped.armature - mass * length**2 - tiny, 0.0),
            damping=stepped.damping,
            frictionloss=own.get("coulomb"),
            solreffriction=f"{2 * step:g} 1",
            solimpfriction="0.9999 0.9999 0.001 0.5 2",
        )
        bodies += [
            f"    {_comment(own.remark((*XML, 'loop_delay')))}",
            f'    <body pos="0 {0.2 * number:.9g} 0">',
            f"      <joint {joint}/>",
            f"      <inertial {_attributes(pos=_place(length, angle), mass=mass, diaginertia=three)}/>",
            "    </body>",
        ]
        more = {"forcerange": f"{-limit:.9g} {limit:.9g}"} if limit else {}
        gains = _attributes(name=own.name, joint=own.name, kp=own.get("kp"), kv=stepped.kv, **more)
        samples = math.ceil(stepped.delay / step) + 2
        servos.append(f'    <position {gains} delay="{stepped.delay:.9g}" nsample="{samples}" interp="linear"/>')
    head = [
        '<mujoco model="servos">',
        f"  {_comment(TOTAL)}",
        f"  {_comment('armature, damping, kv and delay are for this integrator and its step, from MuJoCo 3.5 on')}",
        '  <compiler angle="radian"/>',
        f'  <option timestep="{step:g}" integrator="implicitfast" gravity="0 0 -{TUNING.free_fall:.9g}"/>',
    ]
    middle = ["  </worldbody>", "  <actuator>", *servos, "  </actuator>", "</mujoco>"]
    return "\n".join([*head, "  <worldbody>", *bodies, *middle, ""])


def _place(length: float, angle: float) -> str:
    """Return the place of the mass of a pendulum that hangs at rest at an angle."""
    return f"{length * math.sin(angle):.9g} 0 {-length * math.cos(angle):.9g}"


def _make_urdf(axles: Sequence[_Axle]) -> str:
    """Return a robot with one link for each joint. URDF has neither gains nor armature."""
    lines = ['<?xml version="1.0"?>', '<robot name="servos">', f"  {_comment(TOTAL)}", '  <link name="base"/>']
    for own in axles:
        mass, length = own.pendulum
        angle, link = own.get("gravity_angle"), quoteattr(f"{own.name}_link")
        rest = own.get("inertia") - mass * length**2
        limit = f' <limit effort="{own.get("torque_limit"):.9g}" velocity="0"/>' if own.get("torque_limit") else ""
        # A simulator refuses a body whose inertia about one axis exceeds the sum about the others.
        inertia = " ".join(f'{name}="{rest:.9g}"' for name in ("ixx", "iyy", "izz"))
        known = ("inertia", "viscous", "coulomb", "torque_limit", "gravity", "gravity_angle")
        lines += [
            f"  {_comment(own.remark(known))}",
            f"  <link name={link}>",
            f'    <inertial><origin xyz="{_place(length, angle)}"/><mass value="{mass:.9g}"/>',
            f'      <inertia {inertia} ixy="0" ixz="0" iyz="0"/></inertial>',
            "  </link>",
            f'  <joint name={quoteattr(own.name)} type="continuous">',
            f'    <parent link="base"/><child link={link}/><axis xyz="0 1 0"/>',
            f"    <dynamics {_attributes(damping=own.get('viscous'), friction=own.get('coulomb'))}/>{limit}",
            "  </joint>",
        ]
    return "\n".join([*lines, "</robot>", ""])


# --- YAML and JSON ----------------------------------------------------------------------------------------------------


def _make_isaac(axles: Sequence[_Axle]) -> str:
    lines = [f"# {TOTAL}", "joints:" if axles else "joints: {}"]
    for own in axles:
        lines += [f"  # {own.remark(tuple(ISAAC.values()))}", f"  {json.dumps(own.name)}:"]
        for key, name in ISAAC.items():
            if name in own.values or name == "kd":
                lines.append(f"    {key}: {own.get(name):.9g}  # {own.describe(name)}")
    return "\n".join([*lines, ""])


def _translate(own: _Axle, keys: Mapping[str, str]) -> dict[str, object]:
    """Return values and standard errors by the names of another program."""
    there = {key: name for key, name in keys.items() if name in own.values}
    std = {key: own.std[name] for key, name in there.items() if math.isfinite(own.std.get(name, math.nan))}
    return {key: own.get(name) for key, name in there.items()} | {
        "std": std,
        "comment": own.remark(list(keys.values())),
    }


def _make_bam(own: _Axle) -> dict[str, object]:
    """Return the parameters of BAM's model m1 to m5. The motor's kt and R are not visible in a log of positions.

    BAM adds the inertia of its pendulum itself. Its model m5 has the friction of motor and load apart.
    """
    frictions = ("stribeck", "load_stribeck", "motor_stribeck")
    falls = any(name in own.values for name in frictions)
    loads = any(name in own.values for name in ("load_friction", *frictions[1:]))
    model = {(False, False): "m1", (True, False): "m2", (False, True): "m3", (True, True): "m4"}[falls, loads]
    speed = next((own.get(f"{name}_speed") for name in frictions if f"{name}_speed" in own.values), None)
    curve = {"alpha": 2.0, **({} if speed is None else {"dtheta_stribeck": speed})} if falls else {}
    found = _translate(own, BAM)
    if "motor_friction" in own.values or "motor_stribeck" in own.values:
        model = "m5"
        for end, kind in (("", "friction"), ("_stribeck", "stribeck")):
            load = own.get(f"load_{kind}")
            found[f"load_friction_external{end}"] = load
            found[f"load_friction_motor{end}"] = load + own.get(f"motor_{kind}")
    pendulum = float(own.stated.get("pendulum", 0.0))
    if "inertia" in own.values:
        found["armature"] = own.get("inertia") - pendulum
    return {"model": model, "actuator": str(own.stated.get("motor", "")), **curve, **found}

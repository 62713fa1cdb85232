"""The model of a servo that follows position commands: what is known of it, and what a fit estimates."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType

import numpy as np

from pmfid.errors import UsageError, did_you_mean
from pmfid.types import Floats

#: Parameter -> its unit, and its unit over that of `kp`. The order is that of the simulation.
UNITS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "inertia": ("kg m2", "s2"),
        "viscous": ("N m s/rad", "s"),
        "coulomb": ("N m", "rad"),
        "kp": ("N m/rad", "1"),
        "kd": ("N m s/rad", "s"),
        "torque_limit": ("N m", "rad"),
        "delay": ("s", "s"),
        "loop_delay": ("s", "s"),
        "gravity": ("N m", "rad"),
        "gravity_angle": ("rad", "rad"),
        "offset": ("N m", "rad"),
        "stribeck": ("N m", "rad"),
        "stribeck_speed": ("rad/s", "rad/s"),
        "load_friction": ("1", "1"),
        "quadratic": ("N m s2/rad2", "s2"),
        "back_emf": ("N m s/rad", "s"),
        "limit_slope": ("N m s/rad", "s"),
        "brake_slope": ("N m s/rad", "s"),
        "ki": ("N m/(rad s)", "1/s"),
        "velocity_filter": ("s", "s"),
        "load_stribeck": ("1", "1"),
        "load_stribeck_speed": ("rad/s", "rad/s"),
        "motor_friction": ("1", "1"),
        "motor_stribeck": ("1", "1"),
        "motor_stribeck_speed": ("rad/s", "rad/s"),
    }
)
#: Parameters of every servo. All others are terms, which a servo has only if they are named or given.
BASE = ("inertia", "viscous", "coulomb", "kp", "delay")
#: Parameters that come with another one.
PARTNERS: Mapping[str, str] = MappingProxyType(
    {
        "stribeck": "stribeck_speed",
        "gravity": "gravity_angle",
        "load_stribeck": "load_stribeck_speed",
        "motor_stribeck": "motor_stribeck_speed",
        "kd": "velocity_filter",
    }
)
#: Parameters of either sign.
SIGNED = ("gravity_angle", "offset", "brake_slope")
#: Parameters that may be given with either sign. A negative Stribeck friction rises with the speed.
EITHER = (*SIGNED, "stribeck")
#: One of these must be given, or all torques are known only as multiples of `kp`.
SCALES = ("kp", "inertia", "gravity", "torque_limit", "coulomb", "kd")


@dataclass(frozen=True)
class Servo:
    """Model of a servo: a position loop, a motor with inertia and friction, and a load.

    The torque is kp (goal - position) - kd velocity + ki (integral of goal - position) within +-torque_limit, with the
    goal of `delay` ago. The position in the loop is that of `loop_delay` ago, and its velocity passes a lag of
    `velocity_filter`. Friction is coulomb + stribeck exp(-(velocity/stribeck_speed)^2), and the same of load_friction
    and load_stribeck times the torque through the gear, which is that of the motor and the load. motor_friction and
    motor_stribeck are the same in proportion to the motor's torque alone. `back_emf` is the drag of the motor while its
    torque is on: it acts beyond the limit, and the gear transmits it. `limit_slope` times the speed lowers the limit of
    a torque that drives the motion, and `brake_slope`, of either sign, that of a torque that brakes it.

    Attributes
    ----------
    resolution : float
        Step of the encoder [rad].
    given : Mapping[str, float]
        Known parameters by name, in SI units. Without any of kp, inertia, gravity, torque_limit, coulomb or kd, the
        log determines torques only as multiples of kp. Without loop_delay, the delay of the loop is half of its period,
        with a standard deviation of half a period.
    terms : Sequence[str]
        Parameters that are estimated in addition to inertia, viscous, coulomb, kp and delay.
    loop_period : float
        Time between two ticks of the position loop [s].
    known_force : bool
        Whether the log has a torque in N m that the motor supplies in addition to the model. It determines kp.

    Raises
    ------
    UsageError
        If a name is unknown, or a value is not finite or has the wrong sign.

    Examples
    --------
    >>> from pmfid.actuators import Servo
    >>> servo = Servo(resolution=0.0015, given={"kp": 8.0}, terms=["gravity"])
    >>> servo.unknown
    ('inertia', 'viscous', 'coulomb', 'delay', 'gravity', 'gravity_angle')
    """

    resolution: float
    given: Mapping[str, float] = field(default_factory=dict)
    terms: Sequence[str] = ()
    loop_period: float = 1e-3
    known_force: bool = False

    def __post_init__(self) -> None:
        for name, value in (("resolution", self.resolution), ("loop_period", self.loop_period)):
            if not (math.isfinite(value) and value > 0):
                raise UsageError(f"{name} must be positive and finite, got {value}: give it in rad or s")
        for name in (*self.given, *self.terms):
            if name not in UNITS:
                raise UsageError(
                    f"unknown parameter {name!r}: use one of {', '.join(UNITS)}{did_you_mean(name, UNITS)}"
                )
        for name, value in self.given.items():
            if (
                not math.isfinite(value)
                or (value < 0 and name not in EITHER)
                or (value <= 0 and name in ("inertia", "kp"))
            ):
                raise UsageError(f"{name} must be finite and positive, got {value}: give it in {UNITS[name][0]}")

    @cached_property
    def relative(self) -> bool:
        """Whether torques are known as multiples of `kp` only."""
        return not self.known_force and not any(self.given.get(name, 0.0) for name in SCALES)

    @cached_property
    def unknown(self) -> tuple[str, ...]:
        """Names of the parameters that a fit estimates, (p,)."""
        names = [*BASE, *self.terms]
        names += [PARTNERS[name] for name in names if name in PARTNERS]
        names += [PARTNERS[name] for name, value in self.given.items() if name in PARTNERS and value != 0]
        fixed = {*self.given, *(["kp"] if self.relative else [])}
        return tuple(name for name in dict.fromkeys(names) if name not in fixed)

    def has(self, name: str) -> bool:
        """Return whether a parameter belongs to the model, known or not."""
        return name in self.unknown or name in self.given

    def values(self, theta: Floats) -> dict[str, float]:
        """Return all parameters by name, with the unknown ones at `theta` (p,)."""
        full = {"kp": 1.0, "loop_delay": 0.5 * self.loop_period, **self.given}
        return full | dict(zip(self.unknown, np.asarray(theta, float).tolist(), strict=True))

"""The model of a servo that follows position commands: what is known of it, and what a fit estimates."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import UsageError, did_you_mean
from pmfid.simulation._servo import simulate_servo
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
    }
)
#: Parameters of every servo. All others are terms, which a servo has only if they are named or given.
BASE = ("inertia", "viscous", "coulomb", "kp", "delay")
#: Parameters that come with another one.
PARTNERS: Mapping[str, str] = MappingProxyType({"stribeck": "stribeck_speed", "gravity": "gravity_angle"})
#: Parameters of either sign.
SIGNED = ("gravity_angle", "offset")
#: Parameters that may be given with either sign. A negative Stribeck friction rises with the speed.
EITHER = (*SIGNED, "stribeck")
#: Parameters that are torques at a motion, apart from those of the loop.
TORQUES = ("inertia", "viscous", "coulomb", "gravity", "offset", "stribeck", "quadratic")
#: One of these must be given, or all torques are known only as multiples of `kp`.
SCALES = ("kp", "inertia", "gravity", "torque_limit", "coulomb", "kd")


@dataclass(frozen=True)
class Servo:
    """Model of a servo: a position loop, a motor with inertia and friction, and a load.

    The torque is kp (goal - position) - kd velocity within +-torque_limit, with the goal of `delay` ago. The position
    in the loop is that of `loop_delay` ago.

    Attributes
    ----------
    resolution : float
        Step of the encoder [rad].
    given : Mapping[str, float]
        Known parameters by name, in SI units. Without any of kp, inertia, gravity, torque_limit, coulomb or kd, the
        log determines torques only as multiples of kp. A given loop_delay says that the loop is known: the standard
        errors then contain a tenth of a period of further delay, in place of a half.
    terms : Sequence[str]
        Parameters that are estimated in addition to inertia, viscous, coulomb, kp and delay.
    loop_period : float
        Longest time between two ticks of the position loop [s].
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
                    f"unknown parameter {name!r}{did_you_mean(name, UNITS)}: use one of {', '.join(UNITS)}"
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
        names += [PARTNERS[name] for name in (*self.terms, *self.given) if name in PARTNERS]
        fixed = {*self.given, *(["kp"] if self.relative else [])}
        return tuple(name for name in dict.fromkeys(names) if name not in fixed)

    def has(self, name: str) -> bool:
        """Return whether a parameter belongs to the model, known or not."""
        return name in self.unknown or name in self.given

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the unknown parameters, (p,)."""
        return tuple(UNITS[name][self.relative] for name in self.unknown)

    def values(self, theta: Floats) -> Floats:
        """Return all parameters (15,) in the order of `UNITS`, with the unknown ones at `theta` (p,)."""
        full = {"torque_limit": math.inf, "stribeck_speed": 1.0, "kp": 1.0, **self.given}
        full.update(zip(self.unknown, theta.tolist(), strict=True))
        return np.array([full.get(name, 0.0) for name in UNITS])

    def simulate(
        self,
        theta: Floats,
        t: Floats,
        goal: Floats,
        start: float,
        velocity: float = 0.0,
        *,
        quantised: bool = False,
        force: Floats | None = None,
    ) -> Floats:
        """Simulate the position (n,) [rad] at the times `t` (n,) [s] under the goal (n,) [rad].

        Parameters
        ----------
        theta : ndarray
            Values of `unknown`, (p,).
        t, goal : ndarray
            Times [s] and commands [rad], (n,). A command is held until the next one.
        start, velocity : float
            Position [rad] and velocity [rad/s] at the first time.
        quantised : bool
            Whether the loop sees the position in steps of the encoder.
        force : ndarray, optional
            Torque (n,) [N m] that the motor supplies in addition to the model, linear between the times.

        Returns
        -------
        ndarray
            Position (n,) [rad].

        Raises
        ------
        ValueError
            If the lengths differ.

        Examples
        --------
        >>> import numpy as np
        >>> from pmfid.actuators import Servo
        >>> servo = Servo(resolution=0.0015, given={"kp": 8.0})
        >>> t = np.arange(100) * 0.01
        >>> position = servo.simulate(np.array([0.01, 0.3, 0.05, 0.0]), t, np.full(100, 0.5), start=0.0)
        >>> round(float(position[-1]), 2)
        0.5
        """
        return self.run(theta, t, goal, start, velocity, quantised=quantised, force=force)[0]

    def run(
        self,
        theta: Floats,
        t: Floats,
        goal: Floats,
        start: float,
        velocity: float = 0.0,
        *,
        quantised: bool = False,
        force: Floats | None = None,
    ) -> tuple[Floats, Floats, float]:
        """Return position (n,) [rad], torque (n,) [N m], and the part of the time at which the torque is limited."""
        step = self.resolution if quantised else 0.0
        return simulate_servo(t, goal, self.values(theta), self.loop_period, step, start, velocity, force)[:3]

    def differentiate(
        self, theta: Floats, t: Floats, goal: Floats, start: float, velocity: float, force: Floats | None
    ) -> tuple[Floats, Floats]:
        """Return position (n,) [rad] and its derivatives (n, p + 2) by `theta`, `start` and `velocity`.

        The loop sees the position without steps of the encoder.
        """
        own = (self.values(theta), self.loop_period, 0.0, start, velocity)
        found = simulate_servo(t, goal, *own, force, self._columns)
        return found[0], found[3]

    @cached_property
    def _columns(self) -> NDArray[np.intp]:
        """Column of the derivatives by each parameter, the start and the velocity (17,); -1 for none."""
        own = [*self.unknown, "start", "velocity"]
        return np.array([own.index(name) if name in own else -1 for name in (*UNITS, *own[-2:])])

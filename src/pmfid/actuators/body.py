"""A servo as the simulated body of `pmfid.fit`: its controller and its friction as rows of parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmfid._body import BASE, LOOP
from pmfid.actuators.servo import SIGNED, Servo
from pmfid.actuators.tuning import TUNING
from pmfid.fit.machine import (
    COULOMB,
    DELAY,
    MASS,
    OFFSET,
    V0,
    VISCOUS,
    X0,
    BodyForce,
    BodyModel,
    Excitation,
    simulate,
)
from pmfid.fit.problem import ObservedStretch
from pmfid.types import Floats

TURN = 2 * math.pi
#: Place of each parameter among the first parameters of the body.
PLACES = {"inertia": MASS, "viscous": VISCOUS, "coulomb": COULOMB, "offset": OFFSET, "delay": DELAY}
#: Place of each parameter of the controller, from the end of the body's parameters.
LOOP_PLACES = {"kp": -LOOP, "torque_limit": 1 - LOOP, "loop_delay": 2 - LOOP}
#: The first of these that is unknown is the one whose logarithm the fit estimates.
LEADS = ("inertia", "kp", "viscous", "coulomb")
#: Name of the constant of each force that has one.
CONSTANTS = {
    **{name: f"{name}_speed" for name in ("stribeck", "load_stribeck", "motor_stribeck")},
    "kd": "velocity_filter",
}
#: Kind and constants of each friction.
FRICTIONS = {
    "stribeck": ("stribeck", 1.0, 0.0),
    "load_friction": ("load", 0.0, 0.0),
    "motor_friction": ("load", 0.0, 1.0),
    "quadratic": ("power", 2.0, 1.0),
    "load_stribeck": ("load_stribeck", 1.0, 0.0),
    "motor_stribeck": ("load_stribeck", 1.0, 1.0),
}
#: Direction of the motion along a torque whose limit falls.
SLOPES = {"limit_slope": 1.0, "brake_slope": -1.0}


@dataclass(frozen=True, eq=False)
class ServoBody(BodyModel):
    """Body of a servo. Gravity of a known size at an unknown angle, parameter `angle`, has the size `gravity`."""

    gravity: float = 0.0
    angle: int = -1
    waves: int = 0

    @property
    def loops(self) -> int:
        return LOOP

    def body(self, theta: Floats) -> Floats:
        body = np.asarray(self.rest + self.lift @ theta)
        if self.angle >= 0:
            body[self.waves : self.waves + 2] = _components(self.gravity, float(theta[self.angle]))
        return body

    def lift_at(self, theta: Floats) -> Floats:
        if self.angle < 0:
            return self.lift
        lift = self.lift.copy()
        angle = float(theta[self.angle])
        lift[self.waves : self.waves + 2, self.angle] = -self.gravity * math.sin(angle), -self.gravity * math.cos(angle)
        return lift


def _components(size: float, angle: float) -> tuple[float, float]:
    """Return the sizes of sine and cosine of gravity that is zero at an angle [rad]."""
    return size * math.cos(angle), -size * math.sin(angle)


def body_of(
    servo: Servo,
    per_log: Mapping[str, int] | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
    load: float = 0.0,
) -> ServoBody:
    """Return the body of a servo, with one parameter for each log in place of a name in `per_log`.

    Gravity of unknown size at an unknown angle has its sine as `gravity` and its cosine as `gravity_angle`. `priors`
    have mean and standard deviation of parameters that count in standard deviations from the mean. An unknown inertia
    counts from that of a known `load` on.
    """
    priors = priors or {}
    names = [
        each
        for name in servo.unknown
        for each in ([f"{name}.{k + 1}" for k in range(per_log[name])] if per_log and name in per_log else [name])
    ]
    kinds = _list_forces(servo)
    constants = [CONSTANTS[name] for name, force in kinds if force.free]
    rows = BASE + len(kinds) + len(constants) + LOOP
    place = PLACES | {name: rows + place for name, place in LOOP_PLACES.items()}
    place |= {name: BASE + j for j, (name, _) in enumerate(kinds)}
    place |= {name: BASE + len(kinds) + j for j, name in enumerate(constants)}
    rest, lift = np.zeros(rows), np.zeros((rows, len(names)))
    rest[place["torque_limit"]] = TUNING.no_limit
    for name, value in servo.values(np.zeros(len(servo.unknown))).items():
        if name in place:
            rest[place[name]] = value
    for i, name in enumerate(names):
        base = name.partition(".")[0]
        if base in place:
            rest[place[base]], lift[place[base], i] = priors.get(base, (load if base == "inertia" else 0.0, 1.0))
    if servo.known_force:
        rest[place["force"]] = 1.0
    extra = _place_gravity(servo, place, names, rest, lift)
    lowest = np.array([-np.inf if name in SIGNED or name == "gravity" else 0.0 for name in names])
    for i, name in enumerate(names):
        if name in priors:
            lowest[i] = -priors[name][0] / priors[name][1]
    lead = next((i for word in LEADS for i, name in enumerate(names) if name.partition(".")[0] == word), 0)
    lowest[lead : lead + 1] = -np.inf
    return ServoBody(tuple(names), tuple(force for _, force in kinds), rest, lift, lead, lowest, TURN, *extra)


def _place_gravity(
    servo: Servo, place: Mapping[str, int], names: Sequence[str], rest: Floats, lift: Floats
) -> tuple[float, int, int]:
    """Write the rows of gravity, and return its size, its unknown angle and its rows where the angle is unknown."""
    if not servo.has("gravity"):
        return 0.0, -1, 0
    rows = [place["gravity"], place["cosine"]]
    if "gravity_angle" in servo.given:
        sine, cosine = _components(1.0, servo.given["gravity_angle"])
        if "gravity" in servo.given:
            rest[rows] = servo.given["gravity"] * sine, servo.given["gravity"] * cosine
        else:
            lift[rows, names.index("gravity")] = sine, cosine
        return 0.0, -1, 0
    angle = names.index("gravity_angle")
    if "gravity" in servo.given:
        return servo.given["gravity"], angle, rows[0]
    lift[rows[1], angle] = 1.0
    return 0.0, -1, 0


def _list_forces(servo: Servo) -> list[tuple[str, BodyForce]]:
    """Return the forces of a servo, each with the parameter that is its size."""
    forces: list[tuple[str, BodyForce]] = []
    if servo.has("gravity"):
        forces += [("gravity", BodyForce("wave", TURN)), ("cosine", BodyForce("wave", TURN, math.pi / 2))]
    forces += [(name, _force(servo, name, *kind)) for name, kind in FRICTIONS.items() if servo.has(name)]
    if servo.has("kd"):
        forces.append(("kd", _force(servo, "kd", "loop_filtered", 0.0)))
    if servo.has("ki"):
        forces.append(("ki", BodyForce("loop_integral")))
    forces += [(name, BodyForce("slope", q=side)) for name, side in SLOPES.items() if servo.has(name)]
    if servo.has("back_emf"):
        forces.append(("back_emf", BodyForce("column_viscous")))
    if servo.known_force:
        forces.append(("force", BodyForce("column", column=1)))
    return forces


def _force(servo: Servo, name: str, kind: str, p: float = 1.0, q: float = 0.0) -> BodyForce:
    constant = CONSTANTS.get(name, "")
    return BodyForce(kind, servo.given.get(constant, p), q, free=constant in servo.unknown)


def excite(
    t: Floats,
    goal: Floats,
    tick: float,
    force: Floats | None = None,
    on: Floats | None = None,
    lead: float = 0.0,
    same: float = 0.0,
) -> Excitation:
    """Return the input of a servo at times t (n,) [s] from goals (n,) [rad], known torques and switches.

    A known torque moves along a line from row to row, in a few steps. The observations come a time `lead` [s] after the
    goals of their rows. A goal that acts at most `same` [s] before or after an observation acts with it.
    """
    seen = t + lead
    after = np.minimum(np.searchsorted(seen, t), t.size - 1)
    apart = np.minimum(np.abs(t - seen[after]), np.abs(t - seen[np.maximum(after - 1, 0)]))
    steps = np.arange(1, 1 if force is None else TUNING.pieces) / TUNING.pieces
    between = (t[:-1, None] + steps * np.diff(t)[:, None]).ravel()
    times = np.sort(np.concatenate([t[apart > same], seen, between]))
    at = np.searchsorted(t, times[:-1] + same, side="right") - 1
    switch = np.ones(at.size) if on is None else np.asarray(on[at], float)
    columns = [switch] if force is None else [switch, np.interp((times[:-1] + times[1:]) / 2, t, force)]
    return Excitation(
        np.diff(times),
        np.asarray(goal[at], float),
        np.searchsorted(times, seen).astype(np.int32),
        np.ascontiguousarray(columns),
        tick,
        None if on is None else switch,
    )


def excite_ticks(one: ObservedStretch, delay: float, period: float) -> Excitation:
    """Return the input of a loop in ticks of a period [s], at which the goals of a stretch act after a delay [s]."""
    ends = np.append(0.0, np.cumsum(one.drive.step))
    ticks = np.append(0.0, np.arange(delay % period, one.times[-1], period))
    at = np.clip(np.searchsorted(ends, ticks - delay + 1e-9, side="right") - 1, 0, ends.size - 2)
    instants = np.concatenate([ticks, one.times])
    order = np.argsort(instants, kind="stable")
    is_tick, row = order[:-1] < ticks.size, np.flatnonzero(order >= ticks.size).astype(np.int32)
    steps, at = np.diff(instants[order]), at[np.cumsum(is_tick) - 1]
    now = np.searchsorted(ends[1:-1], instants[order][:-1] + steps / 2)
    on = is_tick if one.drive.on is None else is_tick * np.where(one.drive.on[at] > 0, 1, -1)
    columns = np.ascontiguousarray(one.drive.columns[:, now])
    return Excitation(steps, one.drive.u[at], row, columns, period, np.asarray(on, float))


def simulate_servo(
    servo: Servo,
    theta: Floats,
    t: Floats,
    goal: Floats,
    start: float,
    velocity: float = 0.0,
    force: Floats | None = None,
) -> Floats:
    """Simulate the position (n,) [rad] of a servo at the times `t` (n,) [s] under the goal (n,) [rad].

    Parameters
    ----------
    servo : Servo
        The model.
    theta : ndarray
        Values of `servo.unknown`, (p,).
    t, goal : ndarray
        Times [s] and commands [rad], (n,). A command is held until the next one.
    start, velocity : float
        Position [rad] and velocity [rad/s] at the first time.
    force : ndarray, optional
        Torque (n,) [N m] that the motor supplies in addition to the model.

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
    >>> from pmfid.actuators import Servo, simulate_servo
    >>> servo = Servo(resolution=0.0015, given={"kp": 8.0})
    >>> t = np.arange(100) * 0.01
    >>> position = simulate_servo(servo, np.array([0.01, 0.3, 0.05, 0.0]), t, np.full(100, 0.5), start=0.0)
    >>> round(float(position[-1]), 2)
    0.5
    """
    if goal.shape != t.shape or (force is not None and force.shape != t.shape):
        raise ValueError(f"t, goal and force must be equally long, got {t.size} and {goal.size}")
    known = replace(servo, given=servo.values(theta), terms=())
    at = body_of(known).rest.copy()
    at[[X0, V0]] = start, velocity
    return simulate(excite(t, goal, servo.loop_period, force), body_of(known).forces, at, 1)[0]

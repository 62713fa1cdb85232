"""The table of terms that a servo may have in addition to those of its model. A new term is one row and its test."""

from __future__ import annotations

import math
from collections.abc import Iterator

from pmfid.actuators.body import SLOPES
from pmfid.actuators.servo import Servo
from pmfid.fit.machine import DIRECTIONAL, OFFSET, BodyForce
from pmfid.fit.terms import ExtraForce, Sizes

#: Terms with even odds, because most servos have them: published models have Stribeck friction and a gear that rubs
#: under load.
COMMON = ("stribeck", "load_friction", "load_stribeck", "motor_friction", "motor_stribeck")
#: The part of the viscous friction that the loop makes. Every servo without a named kd has this term, because no motion
#: below the limit of the torque shows it: it hides a part of the inertia, its size times the age of its velocity.
LOOP_FRICTION = "loop_friction"
#: Terms whose rows come and go together.
PAIRS = (("gravity",), tuple(SLOPES))
#: Speeds of Stribeck friction as parts of the highest speed. Each moves by the factors of `pmfid.fit.problem.CONSTANT`.
SHARES = (0.02, 0.06, 0.2, 0.6)
NAME = "name the term {}, or give its value"


def table_of(servo: Servo, gain: float, s: Sizes) -> list[ExtraForce]:
    """Return the terms that a servo does not have yet, with priors for a gain kp [N m/rad] and the sizes of a log."""
    rows = [*_loads(s), *_loop(servo, gain, s), *_frictions(s)]
    return [row for row in rows if not servo.has({LOOP_FRICTION: "kd"}.get(row.name, row.name))]


def _row(name: str, words: str, sd: float, **more: object) -> ExtraForce:
    return ExtraForce(name, words, NAME.format(name), sd, **more)  # type: ignore[arg-type]


def _loads(s: Sizes) -> Iterator[ExtraForce]:
    yield _row("offset", "a constant load", 0.3 * s.force, base=OFFSET)
    for phase in (0.0, math.pi / 2):
        yield _row("gravity", "gravity", 0.5 * s.force, force=BodyForce("wave", 2 * math.pi, phase))


def _loop(servo: Servo, gain: float, s: Sizes) -> Iterator[ExtraForce]:
    force = BodyForce("loop_filtered", 0.5 * servo.loop_period)
    yield _row(LOOP_FRICTION, "a derivative gain", 0.5 * s.viscous, force=force, lowest=0.0)
    force = BodyForce("column_viscous")
    yield _row("back_emf", "a back-EMF", 0.5 * s.viscous, force=force, lowest=0.0)
    for (name, side), lowest in zip(SLOPES.items(), (0.0, -math.inf), strict=True):
        words, force = "a torque limit that depends on the speed", BodyForce("slope", q=side)
        yield _row(name, words, s.force / s.speed, force=force, lowest=lowest)
    yield _row("ki", "an integral gain", 3.0 * gain, force=BodyForce("loop_integral"), lowest=0.0)


def _frictions(s: Sizes) -> Iterator[ExtraForce]:
    for share in SHARES:
        force = BodyForce("stribeck", share * s.speed)
        yield _row("stribeck", "Stribeck friction", 0.4 * s.coulomb, force=force, lowest=0.0)
    for q, name, words in ((0.0, "load", "the load"), (1.0, "motor", "the motor's torque")):
        force = BodyForce("load", q=q)
        yield _row(f"{name}_friction", f"friction in proportion to {words}", 0.1, force=force, lowest=0.0)
        for share in SHARES:
            force = BodyForce("load_stribeck", share * s.speed, q)
            words_ = f"Stribeck friction in proportion to {words}"
            yield _row(f"{name}_stribeck", words_, 0.1, force=force, lowest=0.0)
    force = BodyForce("power", 2.0, 1.0)
    yield _row("quadratic", "quadratic friction", 0.3 * s.viscous / s.speed, force=force, lowest=0.0)
    yield _row("viscous_difference", "friction that differs by direction", 0.3 * s.viscous, base=DIRECTIONAL)

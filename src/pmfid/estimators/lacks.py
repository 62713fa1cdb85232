"""What the model of a drive may lack: forces that machines have, along the simulated motion.

Each is a force per unit of one coefficient, which is zero where the model is right. It is tested whether the counts
ask for it (`adequacy`), and how far it would move the parameters if a machine had as much of it as machines well may.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pmfid.estimators.difference import Difference, rms
from pmfid.models.equation import (
    COULOMB_BACKWARD,
    COULOMB_FORWARD,
    LATE,
    MASS,
    OFFSET,
    STIFFNESS,
    VISCOUS_BACKWARD,
    VISCOUS_FORWARD,
)
from pmfid.models.shapes import Square, Stribeck
from pmfid.types import Floats

#: Coulomb friction of a machine is taken for at least this part of the motor's force.
LEAST_FRICTION = 0.02
#: Speeds, as parts of the root mean square one, over which Stribeck friction falls.
STRIBECK_SPEEDS = (0.03, 0.1, 0.3)
#: The simulated velocity changes by at most this part of a Stribeck speed within the parts of a sample that this
#: friction is taken over, of which there are so many at most: around a reversal it turns within a fraction of a sample.
FINE, MOST_PARTS = 0.1, 16
#: A smaller change of velocity, as a part of the Stribeck speed, is none.
STEADY = 1e-3
#: What a machine may well have: parts of Coulomb friction, of viscous friction, of the motor's force, of a sample.
STRIBECK, UNEVEN, CURVED, LATE_BY = 0.3, 0.15, 0.15, 0.5


@dataclass(frozen=True)
class Lack:
    """One force that the model may lack.

    name; says: what it is, for people; cure: what to do about it; force: (n,) against the motion, or (k n,) over the k
    equal parts of every sample, per unit of its coefficient; plausible: coefficient that a machine may well have, 0: it
    is tested for, but not supposed.
    """

    name: str
    says: str
    cure: str
    force: Floats
    plausible: float


def lacks(difference: Difference, q: Floats) -> list[Lack]:
    """What may be missing beside the motion simulated at q (q,)."""
    x, v = difference.motion(q)
    moving = v != 0
    if not np.any(moving):
        return []
    return [*_frictions(difference, q, v), *_forces(difference, q, x, v)]


def _frictions(difference: Difference, q: Floats, v: Floats) -> Iterator[Lack]:
    values = difference.equation.role_values(q * difference.scale)
    speed, side, usual = np.abs(v), np.sign(v), rms(v[v != 0])
    coulomb = max(
        (values[COULOMB_FORWARD] + values[COULOMB_BACKWARD]) / 2,
        LEAST_FRICTION * abs(difference.equation.input_gain) * rms(difference.u),
    )
    viscous = (values[VISCOUS_FORWARD] + values[VISCOUS_BACKWARD]) / 2 * usual
    known = [term.shape for term in difference.equation.shaped if term.signal == "friction"]
    for part in () if any(isinstance(shape, Stribeck) for shape in known) else STRIBECK_SPEEDS:
        says, cure = "friction that is larger at low speed (Stribeck)", 'set stribeck = "estimate" in [model]'
        yield Lack("stribeck", says, cure, _stribeck(difference, q, v, part * usual), STRIBECK * coulomb)
    if not any(isinstance(shape, Square) for shape in known):
        cure = "set quadratic = true in [model]"
        yield Lack("curved", "friction that is not linear at high speed", cure, v * speed / usual**2, CURVED * viscous)
    yield Lack("drifting", "friction that changes over the record", "", side * np.linspace(-1, 1, v.size), 0.0)
    roles = difference.equation.roles
    if roles[COULOMB_FORWARD] == roles[COULOMB_BACKWARD]:
        cure = 'set friction = "directional" in [model]' + ("" if roles[OFFSET] is None else " in place of offset")
        yield Lack("uneven", "viscous friction that differs with the direction", cure, speed / usual, UNEVEN * viscous)
        if roles[OFFSET] is None:
            cure += ", or offset = true for a constant load"
            says = "a constant load, or Coulomb friction that differs with the direction"
            yield Lack("load", says, cure, np.abs(side), UNEVEN * coulomb)


def _stribeck(difference: Difference, q: Floats, v: Floats, fall: float) -> Floats:
    """(k n,): exp(-(v / fall)^2) against the motion, its mean over the k parts of every sample as the velocity goes on
    straight from one to the next."""
    from scipy.special import erf  # slow to import, and only this needs it

    change = float(np.max(np.abs(np.diff(v)), initial=0.0))
    parts = int(np.clip(np.ceil(change / (FINE * fall)), 1, MOST_PARTS))
    v = difference.motion(q, np.zeros(parts * v.size))[1]
    ends = np.r_[v[0], (v[1:] + v[:-1]) / 2, v[-1]]
    below = np.diff(fall * np.sqrt(np.pi) / 2 * erf(np.abs(ends) / fall))
    step = np.diff(ends)
    steady = np.abs(step) < STEADY * fall
    return np.where(steady, np.sign(v) * np.exp(-((v / fall) ** 2)), below / np.where(steady, 1.0, step))


def _forces(difference: Difference, q: Floats, x: Floats, v: Floats) -> Iterator[Lack]:
    gain, u, roles = difference.equation.input_gain, difference.u, difference.equation.roles
    late = gain * np.diff(u, prepend=u[0]) / difference.dt
    if roles[LATE] is None:
        cure = 'set dead_time = "estimate" in [model]'
        yield Lack("dead_time", "a dead time, or a lag, of the input", cure, late, LATE_BY * difference.dt)
    place = (x - np.mean(x)) / max(float(np.ptp(x)), np.finfo(float).tiny)
    along = {term.signal for term in difference.equation.shaped if term.shape and not term.shape.of_speed}
    if "friction" not in along:
        yield Lack("uneven_way", "friction that differs along the travel", "", np.sign(v) * place, 0.0)
    if "place" not in along and roles[STIFFNESS] is None:
        yield Lack("spring", "a force that grows with the position", "set spring = true in [model]", place, 0.0)
    yield Lack("bent_input", "an input that does not act in proportion", "", -gain * u * np.abs(u) / rms(u), 0.0)
    if difference.equation.roles[MASS] is not None:
        acceleration = np.diff(v, append=v[-1]) / difference.dt
        yield Lack(
            "changing", "a mass that changes over the record", "", acceleration * np.linspace(-1, 1, v.size), 0.0
        )

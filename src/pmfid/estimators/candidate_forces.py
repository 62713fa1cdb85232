"""Candidate forces: unmodelled effects that a drive may have, evaluated along the simulated motion.

Each candidate is a force per unit of one coefficient, which is zero if the model is right. `adequacy` tests whether the
counts ask for the force, and bounds how far a plausible amount of it would move the parameters.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from pmfid.estimators.difference import Difference, rms
from pmfid.estimators.starts import STRIBECK_SPEEDS
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
from pmfid.models.shapes import ESTIMATE, Square, Stribeck, Wave
from pmfid.types import Floats

#: Coulomb friction of a machine is taken for at least this part of the motor's force.
LEAST_FRICTION = 0.02
#: Stribeck friction is averaged over parts of a sample, because it turns within a fraction of a sample at a reversal.
#: Greatest change of velocity within a part, as a fraction of the Stribeck speed, and greatest number of parts.
FINE, MOST_PARTS = 0.1, 16
#: A smaller change of velocity, as a part of the Stribeck speed, is none.
STEADY = 1e-3
#: What to set in [model], by key.
Change = Mapping[str, object]
DIRECTIONAL: Change = {"friction": "directional", "offset": False}
#: What a machine may well have: parts of Coulomb friction, of viscous friction, of the motor's force, of a sample, of
#: the largest input.
STRIBECK, UNEVEN, CURVED, LATE_BY, DEAD_ZONE = 0.3, 0.15, 0.15, 0.5, 0.03
#: Parts of the largest input from which on an amplifier may give less.
KINKS = (0.5, 0.7, 0.9)
ACTING = "give the input that acts, as [record] input"


@dataclass(frozen=True)
class CandidateForce:
    """One force that the model leaves out.

    name; says: description for people; cure: what to do about it; force: (n,) against the motion, or (k n,) over the k
    equal parts of every sample, per unit of its coefficient; plausible: coefficient that a machine may have, 0: the
    force is tested, but not assumed; changes: changes of [model], each of which adds the force; positive: no machine
    has a negative coefficient.
    """

    name: str
    says: str
    cure: str
    force: Floats
    plausible: float
    changes: tuple[Change, ...] = field(default=(), kw_only=True)
    positive: bool = field(default=False, kw_only=True)


@dataclass(frozen=True)
class PeriodicForce:
    """A force or a friction that is periodic in the position: its key in [model], and its period in the unit of y."""

    key: str
    period: float

    @property
    def says(self) -> str:
        what = {
            "gravity": "gravity, or a load out of balance,",
            "cogging": "a cogging force",
            "friction_period": "friction",
        }
        return f"{what[self.key]} that comes again every {self.period:.4g} of the travel"

    def forces(self, x: Floats, v: Floats) -> Iterator[Floats]:
        """(n,) each, of a unit of sin and of cos along the motion."""
        side = np.sign(v) if self.key == "friction_period" else 1.0
        for wave in (Wave(self.period), Wave(self.period, True)):
            yield np.asarray(side * wave.at(x))


def list_candidate_forces(
    difference: Difference, q: Floats, places: Sequence[PeriodicForce] = ()
) -> list[CandidateForce]:
    """Forces that may be missing, along the motion simulated at q (q,). places: forces periodic in the position."""
    x, v = difference.motion(q)
    moving = v != 0
    if not np.any(moving):
        return []
    return [*_frictions(difference, q, v), *_forces(difference, q, x, v), *_places(difference, places, v)]


def _frictions(difference: Difference, q: Floats, v: Floats) -> Iterator[CandidateForce]:
    values = difference.equation.role_values(q * difference.scale)
    speed, side, usual = np.abs(v), np.sign(v), rms(v[v != 0])
    coulomb = max(
        (values[COULOMB_FORWARD] + values[COULOMB_BACKWARD]) / 2,
        LEAST_FRICTION * abs(difference.equation.input_gain) * rms(difference.u),
    )
    viscous = (values[VISCOUS_FORWARD] + values[VISCOUS_BACKWARD]) / 2 * usual
    known = [term.shape for term in difference.equation.shaped if term.signal == "friction"]
    for part in () if any(isinstance(shape, Stribeck) for shape in known) else STRIBECK_SPEEDS:
        says = "friction that is larger at low speed (Stribeck)"
        change: Change = {"stribeck": ESTIMATE}
        force = _stribeck(difference, q, v, part * usual)
        yield CandidateForce(
            "stribeck", says, _cure(change), force, STRIBECK * coulomb, changes=(change,), positive=True
        )
    if not any(isinstance(shape, Square) for shape in known):
        says, change = "friction that is not linear at high speed", {"quadratic": True}
        force = v * speed / usual**2
        yield CandidateForce("curved", says, _cure(change), force, CURVED * viscous, changes=(change,), positive=True)
    yield CandidateForce(
        "drifting", "friction that changes over the record", "", side * np.linspace(-1, 1, v.size), 0.0
    )
    roles = difference.equation.roles
    if roles[COULOMB_FORWARD] == roles[COULOMB_BACKWARD]:
        cure = 'set friction = "directional" in [model]' + ("" if roles[OFFSET] is None else " in place of offset")
        says = "viscous friction that differs with the direction"
        yield CandidateForce("uneven", says, cure, speed / usual, UNEVEN * viscous, changes=(DIRECTIONAL,))
        if roles[OFFSET] is None:
            cure += ", or offset = true for a constant load"
            says = "a constant load, or Coulomb friction that differs with the direction"
            changes = ({"offset": True}, DIRECTIONAL)
            yield CandidateForce("load", says, cure, np.abs(side), UNEVEN * coulomb, changes=changes)


def _cure(change: Change) -> str:
    return f"set {' and '.join(setting(*pair) for pair in change.items())} in [model]"


def setting(key: str, value: object) -> str:
    """A line of [model]."""
    if isinstance(value, bool):
        return f"{key} = {'true' if value else 'false'}"
    return f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {value:.9g}"


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


def _forces(difference: Difference, q: Floats, x: Floats, v: Floats) -> Iterator[CandidateForce]:
    gain, u, roles = difference.equation.input_gain, difference.u, difference.equation.roles
    late = gain * np.diff(u, prepend=u[0]) / difference.dt
    if roles[LATE] is None:
        change: Change = {"dead_time": ESTIMATE}
        says, known = "a dead time, or a lag, of the input", difference.equation.dead_time
        yield CandidateForce(
            "dead_time", says, _cure(change), late, LATE_BY * difference.dt, changes=(change,), positive=not known
        )
    place = (x - np.mean(x)) / max(float(np.ptp(x)), np.finfo(float).tiny)
    along = {term.signal for term in difference.equation.shaped if term.shape and not term.shape.of_speed}
    if "friction" not in along:
        yield CandidateForce("uneven_way", "friction that differs along the travel", "", np.sign(v) * place, 0.0)
    if "place" not in along and roles[STIFFNESS] is None:
        change = {"spring": True}
        yield CandidateForce(
            "spring", "a force that grows with the position", _cure(change), place, 0.0, changes=(change,)
        )
    yield CandidateForce(
        "bent_input", "an input that does not act in proportion", "", -gain * u * np.abs(u) / rms(u), 0.0
    )
    largest = float(np.max(np.abs(u)))
    for part in KINKS:
        less = gain * np.sign(u) * np.maximum(np.abs(u) - part * largest, 0.0)
        yield CandidateForce(
            "saturated_input", "an input whose largest values act as smaller ones", ACTING, less, 0.0, positive=True
        )
    zone, most = gain * np.sign(u), DEAD_ZONE * largest
    yield CandidateForce("dead_zone", "a dead zone of the input", ACTING, zone, most)
    if difference.equation.roles[MASS] is not None:
        acceleration = np.diff(v, append=v[-1]) / difference.dt
        yield CandidateForce(
            "changing", "a mass that changes over the record", "", acceleration * np.linspace(-1, 1, v.size), 0.0
        )


def _places(difference: Difference, places: Sequence[PeriodicForce], v: Floats) -> Iterator[CandidateForce]:
    """At the measured places: the simulated motion may be off by more than a period."""
    middle = difference.y - difference.slack
    middle = middle + np.diff(middle, append=middle[-1]) / 2
    for place in places:
        change: Change = {place.key: place.period}
        for force in place.forces(middle, v):
            yield CandidateForce(place.key, place.says, _cure(change), force, 0.0, changes=(change,))

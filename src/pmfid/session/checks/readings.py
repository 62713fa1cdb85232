"""A log that is taken for what it is not: turned, exchanged, a velocity, or nothing that belongs together.

Each is a reading of the two columns. As they stand, the input is a sum of acceleration, friction and load to a small
part, with a positive mass and a friction that takes power from the motion. Where that is not so, the reading under
which it is names the mistake.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pmfid.encoder import Encoder, fine_counts
from pmfid.findings import Finding
from pmfid.session.checks.log import CheckedLog, hasty, liveliest
from pmfid.session.checks.timing import drifts, too_slow
from pmfid.session.checks.view import MASS, VISCOUS, View, best_view
from pmfid.types import Counts, Floats

__all__ = ["INTEGRATE", "convert_velocity", "integrate_velocity", "is_exchanged", "read_as", "suggest_sign"]

#: Part of the input that a reading may leave unexplained, of all of it, and of what the record as it stands leaves.
FOLLOWS, BETTER = 0.15, 0.3
#: The same, with friction of forms that no reading has, where the input is not of another clock: an integral follows
#: that as well.
LOOSELY = 0.3
#: With a part this small left, and a mass that is seen, no other reading need be tried.
CLEARLY = 0.001
#: Standard deviations from which on a sign is certain, and from which on it is likely.
CERTAIN, LIKELY = 4.5, 3.0
#: Part beyond which what a record as it stands leaves says nothing of a sign.
UNSEEN = 0.5
#: A body comes to speed within more samples than this; where there is no body, a velocity may leave so many times as
#: much.
SAMPLES, ALIKE = 1.5, 2.0
#: A reading is one of a motion that lasts for so many time constants of the filters.
LASTING = 10.0
#: Change of the velocity from row to row, in parts of the velocity: of a column that is no position, and of one that
#: may be.
ROUGH, SMOOTH = 0.6, 0.1
RATE = 'give [record] output_kind = "velocity"'
INTEGRATE = (
    "name the column of the position or the counts, or integrate this one, its cumulative sum times the sample period"
)


def read_as(log: CheckedLog) -> Iterator[Finding]:
    """Columns that are exchanged, a velocity, turned, or do not belong together."""
    if not log.is_machine:
        return
    other = _other_reading(log)
    if other is not None:
        yield other
    elif log.view is not None and log.knows_sign and is_turned(log.view):
        mistake = "the output has the opposite sign of the input"
        yield _make_finding("reversed", mistake, suggest_sign(log), log.view.unexplained)


def _other_reading(log: CheckedLog) -> Finding | None:
    """Of exchanged columns or a velocity, where these explain the input so much better."""
    view = log.closest_view
    heavy = view is not None and _has_inertia(view, log.record.dt) and _is_one_body(view)
    left = _measure_rest(view)
    if heavy and left < CLEARLY:
        return None
    velocity, exchanged = _measure_rest(_velocity(log)), _measure_rest(_view_exchanged(log))
    better = ALIKE if hasty(log.change) > ROUGH > SMOOTH > hasty(np.diff(log.record.u)) else BETTER
    bound = min(better * left, velocity)
    if exchanged < min(FOLLOWS, bound) or (exchanged < min(LOOSELY, bound) and not any(drifts(log))):
        return _make_finding("exchanged", "input and output are exchanged", _exchange(log), exchanged)
    if log.sudden_stops or view is None or view.one_way or log.axis.record.output_kind == "velocity":
        return None
    bound = left * (BETTER if heavy else 1.0 if _is_one_body(view) else ALIKE)
    loosely = velocity < LOOSELY and (velocity < bound or (velocity < FOLLOWS and _is_no_body(view)))
    if velocity < min(FOLLOWS, bound, left) or (loosely and _is_in_time(log)):
        mistake = f"the output column {log.axis.record.output!r} is a velocity and no position"
        return _make_finding("velocity", mistake, RATE, velocity)
    return None


def _is_in_time(log: CheckedLog) -> bool:
    """Is the input of the output's clock, and the record fast enough for the axis?"""
    return not (any(too_slow(log)) or any(drifts(log)))


def is_exchanged(log: CheckedLog) -> bool:
    """Do the columns follow each other the other way round, whatever they do as they stand?"""
    return log.is_machine and _measure_rest(_view_exchanged(log)) < FOLLOWS


def _make_finding(code: str, mistake: str, remedy: str, left: float) -> Finding:
    sentence = f"{mistake}, for then the motion explains the input to {100 * (1 - left):.3g} %"
    return Finding(code, sentence, remedy, "wrong")


def is_turned(view: View) -> bool:
    """Is the mass negative, or does friction drive, and neither is as it should be, in a record that says much of
    them?"""
    mass, work = view.sure(np.eye(view.theta.size)[MASS]), view.sure(view.friction_work)
    return view.unexplained < UNSEEN and min(mass, work) < -CERTAIN and max(mass, work) < LIKELY


def _has_inertia(view: View, dt: float) -> bool:
    """Is there a mass, which takes more than a sample to come to speed?"""
    mass, viscous = abs(view.theta[MASS]), abs(view.theta[VISCOUS])
    return abs(view.sure(np.eye(view.theta.size)[MASS])) > CERTAIN and mass > SAMPLES * dt * viscous


def _is_one_body(view: View) -> bool:
    """Does friction take power from the motion where the mass is positive, and drive where all is turned?"""
    mass, work = view.sure(np.eye(view.theta.size)[MASS]), view.sure(view.friction_work)
    return mass * work > 0 or abs(work) < LIKELY


def _is_no_body(view: View) -> bool:
    """Does friction certainly drive what has a mass, or take power from what has a negative one?"""
    mass, work = view.sure(np.eye(view.theta.size)[MASS]), view.sure(view.friction_work)
    return mass * work < 0 and min(abs(mass), abs(work)) > LIKELY


def _measure_rest(view: View | None) -> float:
    """Of the input; all where there is no such reading."""
    return np.inf if view is None else view.unexplained


def _view_exchanged(log: CheckedLog) -> View | None:
    if isinstance(log.axis.record.input_scale, str):
        return None
    position = log.encoder.position(log.record.counts)  # with steps, as a random input has them
    encoder, counts = fine_counts(log.record.u)
    return _view_reading(position - position.mean(), counts, encoder, log.record.dt)


def _velocity(log: CheckedLog) -> View | None:
    encoder, counts = convert_velocity(log.record.counts, log.record.resolution, log.record.dt)
    return _view_reading(log.force, counts, encoder, log.record.dt)


def _view_reading(force: Floats, counts: Counts, encoder: Encoder, dt: float) -> View | None:
    """A reading of the record, if it makes a machine of it."""
    part = liveliest(counts)
    view = best_view(force[part], counts[part], encoder, dt, lasting=LASTING)
    return view if view is not None and _has_inertia(view, dt) and _is_one_body(view) else None


def _exchange(log: CheckedLog) -> str:
    config = log.axis.record
    return f'give [record] input = "{config.output}" and output = "{config.input}"'


def integrate_velocity(velocity: Floats, dt: float) -> Floats:
    """The position (n,) from 0 on of a velocity (n,) that runs along a line between samples."""
    return np.asarray(np.r_[0.0, np.cumsum(velocity[1:] + velocity[:-1])] * (dt / 2))


def convert_velocity(counts: Counts, resolution: float, dt: float) -> tuple[Encoder, Counts]:
    """A fine encoder and its counts (n,) of the position of a velocity of counts (n,) times a resolution.

    Count 0 is none, not the middle of its step: an axis at rest would creep on, and its friction have a direction.
    """
    return fine_counts(integrate_velocity(np.float64(resolution) * counts.astype(np.float64), dt))


def suggest_sign(log: CheckedLog) -> str:
    """What to write where the force of the input points the other way."""
    model = log.axis.model
    if model.kind == "drive" and isinstance(model.input_gain, float):
        return f"give [model] input_gain = {-model.input_gain:g}"
    return "give the known term of the input in [model] the other sign"

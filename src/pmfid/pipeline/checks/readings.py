"""Checks for other readings of the two columns, such as another sign, another unit, a velocity or a delay."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from pmfid.encoder import Encoder, fine_counts
from pmfid.estimators.known import CONTRADICTED
from pmfid.estimators.stretches import liveliest
from pmfid.findings import Finding
from pmfid.models.drive import Drive
from pmfid.pipeline.checks.view import (
    MASS,
    PLAIN,
    READINGS_FEWEST,
    VIEW_MOST_SAMPLES,
    VISCOUS,
    CheckedLog,
    View,
    best_view,
)
from pmfid.pipeline.guess.roles import is_position
from pmfid.pipeline.known import finds_gain, set_any_gain
from pmfid.records.travel import integrate_velocity
from pmfid.types import Counts, Floats
from pmfid.units import OUTPUTS, column_unit

#: Greatest part of the input that a reading leaves unexplained. `READINGS_BETTER` is the greatest ratio of the part
#: that another reading leaves unexplained to the part that the given reading leaves.
READINGS_FOLLOWS = 0.15
READINGS_BETTER = 0.3
#: Number of standard deviations above which a sign, or the mass of a reading, is certain.
READINGS_CERTAIN = 4.5
#: Unexplained part above which a record says nothing about a sign.
READINGS_UNSEEN = 0.5
#: Smallest time in which a mass reaches its speed [samples].
READINGS_SAMPLES = 1.5
#: Smallest duration of the motion in a reading, in time constants of the filters.
READINGS_LASTING = 10.0
#: Smallest travel that shows gravity [rad]. A spring explains a shorter travel equally well.
READINGS_TURNED = 1.0

RATE = 'give [record] output_kind = "velocity"'


def read_as(log: CheckedLog) -> Iterator[Finding]:
    """Yield a finding if the columns are exchanged, the output is a velocity, or the input has the wrong sign."""
    if not log.is_machine:
        return
    other = _other_reading(log)
    if other is not None:
        yield other
    elif log.view is not None and not finds_gain(log.axis) and is_turned(log.view):
        mistake = "the output has the opposite sign of the input"
        found = _make_finding("reversed", mistake, suggest_sign(log), log.view.unexplained)
        yield replace(found, detail="If the sign is right, a force other than this input moves the axis.")


def is_turned_by_gravity(log: CheckedLog) -> bool:
    """Return whether gravity explains the input of a rotary axis whose model has no gravity much better.

    Under position control, the input is a function of the position, and any force of the position explains it. The fit
    decides; other readings of the columns say nothing then.
    """
    model = set_any_gain(log.axis).model.make()
    if not (log.is_machine and isinstance(model, Drive) and model.axis == "rotary" and model.gravity is False):
        return False
    counts = log.known.counts[log.part]
    if np.ptp(counts) * log.encoder.resolution < READINGS_TURNED:
        return False
    hanging = best_view(log.force[log.part], counts, log.encoder, log.record.dt, model=replace(PLAIN, gravity=True))
    left = _measure_rest(hanging)
    better = left < min(READINGS_FOLLOWS, READINGS_BETTER * _measure_rest(log.closest_view))
    return hanging is not None and better and _is_one_body(hanging)


def _other_reading(log: CheckedLog) -> Finding | None:
    """Return a finding on exchanged columns or on a velocity if such a reading explains the input much better."""
    view = log.closest_view
    heavy = view is not None and _has_inertia(view, log.record.dt) and _is_one_body(view)
    left = _measure_rest(view)
    velocity, exchanged = _measure_rest(_velocity(log)), _measure_rest(_view_exchanged(log))
    if exchanged < min(READINGS_FOLLOWS, READINGS_BETTER * left, velocity):
        return _make_finding("exchanged", "input and output are exchanged", _exchange(log), exchanged)
    if log.sudden_stops or view is None or view.one_way or log.axis.record.output_kind == "velocity":
        return None
    named = is_position(log.axis.record.output)
    if velocity < min(READINGS_FOLLOWS, left * (READINGS_BETTER if heavy or named else 1.0)):
        mistake = f"the output column {log.axis.record.output!r} is a velocity, not a position"
        return _make_finding("velocity", mistake, RATE, velocity)
    return None


def is_exchanged(log: CheckedLog) -> bool:
    """Return whether the motion explains the input if the two columns are exchanged."""
    return log.is_machine and _measure_rest(_view_exchanged(log)) < READINGS_FOLLOWS


def _make_finding(code: str, mistake: str, remedy: str, left: float) -> Finding:
    sentence = f"{mistake}; with this changed, the motion explains {100 * (1 - left):.3g} % of the input"
    return Finding(code, sentence, remedy, "wrong")


def is_turned(view: View) -> bool:
    """Return whether the mass is negative or friction drives the axis.

    The record must determine both signs, and neither sign may be the proper one.
    """
    mass, work = view.sure(np.eye(view.theta.size)[MASS]), view.sure(view.friction_work)
    return view.unexplained < READINGS_UNSEEN and min(mass, work) < -READINGS_CERTAIN and max(mass, work) < CONTRADICTED


def _has_inertia(view: View, dt: float) -> bool:
    """Return whether the mass needs more than `READINGS_SAMPLES` to reach its speed."""
    mass, viscous = abs(view.theta[MASS]), abs(view.theta[VISCOUS])
    return abs(view.sure(np.eye(view.theta.size)[MASS])) > READINGS_CERTAIN and mass > READINGS_SAMPLES * dt * viscous


def _is_one_body(view: View) -> bool:
    """Return whether mass and friction power have equal signs, if both are significant."""
    mass, work = view.sure(np.eye(view.theta.size)[MASS]), view.sure(view.friction_work)
    return mass * work > 0 or abs(work) < CONTRADICTED


def _measure_rest(view: View | None) -> float:
    """Return the part of the input that a reading leaves unexplained, or infinity without a reading."""
    return np.inf if view is None else view.unexplained


def _view_exchanged(log: CheckedLog) -> View | None:
    if isinstance(log.axis.record.input_scale, str):
        return None
    position = log.encoder.position(log.record.counts)  # the position keeps its steps, as in a random input
    encoder, counts = fine_counts(log.record.u)
    return _view_reading(position - position.mean(), counts, encoder, log.record.dt)


def _velocity(log: CheckedLog) -> View | None:
    # Count 0 means exactly zero velocity. With the middle of a step, an axis at rest would drift.
    velocity = np.float64(log.record.resolution) * log.record.counts.astype(np.float64)
    encoder, counts = fine_counts(integrate_velocity(velocity, log.record.dt))
    return _view_reading(log.force, counts, encoder, log.record.dt)


def _view_reading(force: Floats, counts: Counts, encoder: Encoder, dt: float) -> View | None:
    """Return the view of a reading, or None if the reading describes no machine."""
    part = liveliest(counts, VIEW_MOST_SAMPLES)
    view = best_view(force[part], counts[part], encoder, dt, lasting=READINGS_LASTING)
    return view if view is not None and _has_inertia(view, dt) and _is_one_body(view) else None


def _exchange(log: CheckedLog) -> str:
    config = log.axis.record
    names = f'input = "{config.output}" and output = "{config.input}"'
    if np.array_equal(log.record.u, np.rint(log.record.u)) and column_unit(config.input, OUTPUTS) is None:
        return f'give [record] {names}, output_kind = "counts", and the travel of a count in [encoder]'
    return f"give [record] {names}"


def suggest_sign(log: CheckedLog) -> str:
    """Return the remedy for an input whose force has the opposite sign."""
    model = log.axis.model
    if model.kind == "drive" and isinstance(model.input_gain, float):
        return f"give [model] input_gain = {-model.input_gain:g}"
    return "reverse the sign of the known input term in [model]"


def no_motion(log: CheckedLog) -> Iterator[Finding]:
    """Yield a finding if the axis is at rest or hardly leaves its count."""
    travel = int(np.ptp(log.record.counts))
    if travel == 0:
        sentence = f"the axis does not move: the output column {log.axis.record.output!r} never changes"
        yield Finding("little_motion", sentence, "record a motion, and check that this column is the encoder", "wrong")
        return
    if not np.any(log.record.u):
        sentence = "the input is zero while the axis moves"
        yield Finding("little_motion", sentence, "record the input that drives the axis", "wrong")
        return
    if travel < READINGS_FEWEST and not is_exchanged(log):
        yield Finding(
            "little_motion",
            f"the axis moves by {travel} counts in all, so the encoder's steps hide the motion",
            "record a longer stroke, or use a finer encoder",
            "wrong",
        )

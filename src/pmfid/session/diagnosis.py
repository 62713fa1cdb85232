"""An equation of the user's own that takes a velocity for a position: the integrated output fits better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pmfid.encoder import Encoder
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.iv import IV
from pmfid.estimators.ls import LS
from pmfid.models.drive import EquationModel
from pmfid.models.equation import Equation
from pmfid.session.checks.log import liveliest
from pmfid.session.checks.readings import INTEGRATE, convert_velocity
from pmfid.session.config import Axis
from pmfid.session.records import Record

__all__ = ["check_direction"]

#: Largest ratio of the unexplained part after integration to the unexplained part of the record as it is.
BETTER = 0.5


def check_direction(record: Record, axis: Axis) -> str:
    """The mistake of an equation of first order with a direction if the output is a velocity; otherwise empty.

    The direction follows the output's change. If the output is a velocity, this is the direction of the acceleration.
    """
    model, config = axis.model.make(), axis.estimator
    above = _integrate_equation(model.equation)
    if above is None or not np.any(np.diff(record.counts)):
        return ""
    part = liveliest(record.counts)
    u, counts = record.u[part], record.counts[part]
    encoder = Encoder(record.resolution, standstill_time=axis.encoder.standstill_time)
    finer, position = convert_velocity(counts, record.resolution, record.dt)
    try:
        plain = LS(model, encoder, record.dt, config.pole, order=config.order).fit(u, counts).relative_error
        risen = IV(EquationModel(above), finer, record.dt, config.pole, order=config.order).fit(u, position)
    except (NotIdentifiableError, UsageError):
        return ""
    if not risen.relative_error < BETTER * plain:
        return ""
    return (
        f"[model] direction is that of the output's change, but {axis.record.output!r} is a velocity: the equation "
        f"leaves {100 * plain:.2g} %, and {100 * risen.relative_error:.2g} % with the direction of the velocity; "
        f"{INTEGRATE}, and raise every derivative of the output by one"
    )


def _integrate_equation(equation: Equation) -> Equation | None:
    """An equation of first order with the output replaced by its integral; None for any other equation."""
    terms = (*equation.unknown, *equation.known)
    if equation.order != 1 or any(term.facts.measured and term.facts.one_way for term in terms):
        return None
    if not any(term.facts.of_motion for term in terms):
        return None
    unknown, known = (
        tuple(replace(term, derivative=term.derivative + (term.signal == "output")) for term in side)
        for side in (equation.unknown, equation.known)
    )
    above = Equation(unknown, known)
    return None if above.without_simulation else above

"""What a log may have got wrong, found by reading it in other ways.

The commonest mistakes are not in the numbers but in what they are taken for. Each of them is a reading of the two
columns: as they stand, with the sign of the output turned, with the output as a velocity, with the columns exchanged.
The reading under which the simulated motion follows the input, where it does not as the columns stand, names the
mistake. A counter that wraps shows in the counts alone and is undone first.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from pmfid.encoder import Encoder, fine_counts
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.configuration import like
from pmfid.estimators.iv import IV
from pmfid.estimators.ls import LS
from pmfid.estimators.output_error import OE
from pmfid.judge.counts import count_jump
from pmfid.models.drive import EquationModel, Model
from pmfid.models.equation import Equation
from pmfid.session.config import Axis
from pmfid.session.records import Record
from pmfid.session.wrap import wrap_of
from pmfid.types import Counts, Floats

__all__ = ["check_direction", "diagnose"]


#: Part of a record that is read in other ways [samples]: the one with the most motion.
MOST_SAMPLES = 5000
#: Part of the motion that may be left unexplained by a reading that names a mistake, of what the record as it stands
#: leaves, and of all motion.
BETTER, FOLLOWS = 0.5, 0.4
#: A mass known to this part of its size is no accident.
KNOWN = 0.2
#: With a part this small left the motion follows the input, and no other reading need be tried.
CLEARLY = 0.1
#: Dead times to try, in filter time constants.
DEAD_TIMES = (0.5, 1.0, 2.0)
INTEGRATE = (
    "name the column of the position or the counts, or integrate this one, its cumulative sum times the sample period"
)


@dataclass(frozen=True)
class Reading:
    """A way to take a record: u (n,), counts (n,) of the encoder; the sentence where it is right, and the remedy;
    model: another one than that of the configuration."""

    u: Floats
    counts: Counts
    encoder: Encoder
    mistake: str
    remedy: str
    model: Model | None = None


def diagnose(record: Record, axis: Axis) -> str:
    """The mistake that explains why a record does not fit `axis`, with its remedy; empty where none is found."""
    wrap = wrap_of(record.counts)
    if wrap is not None and axis.encoder.bits is None and axis.encoder.range is None:
        unit = axis.model.make().equation.motion.travel if axis.model.kind == "drive" else ""
        return wrap.sentence(axis.record.output, axis.record.output_kind, record.resolution, unit)
    model, config = axis.model.make(), axis.estimator
    shaped = model.equation.further  # speeds of friction, which the readings are not made with
    if model.equation.without_simulation or shaped or not np.any(np.diff(record.counts)):
        return ""
    encoder = Encoder(record.resolution, standstill_time=axis.encoder.standstill_time)
    estimator = IV(model, encoder, record.dt, config.pole, order=config.order)
    u, counts = _liveliest(record.u, record.counts)
    as_it_stands = Reading(u, counts, encoder, "", "")
    least = _unexplained(estimator, as_it_stands)
    jump = count_jump(record.counts) if axis.encoder.max_speed is None else ""  # what that keeps out is no mistake
    if least < CLEARLY:  # with the jump left out
        return jump
    for reading in (*_exchanges(as_it_stands, axis), _loaded(as_it_stands, axis)):
        unexplained = _unexplained(estimator, reading)
        if unexplained < min(FOLLOWS, BETTER * least):
            return _sentence(reading, unexplained)
    if jump or count_jump(record.counts):  # an integral would smooth it away and follow
        return jump
    velocity = _velocity(as_it_stands, record.dt, axis)
    unexplained = _unexplained(estimator, velocity)
    if unexplained < CLEARLY:  # an integral follows anything more easily: a load or a dead time must not do as well
        lamer = (_unexplained(estimator, lame) for lame in _lamer(as_it_stands, estimator, axis))
        least = min(least, _without_friction(estimator, as_it_stands), *lamer)
    return _sentence(velocity, unexplained) if unexplained < min(CLEARLY, BETTER * least) else ""


def _sentence(reading: Reading, unexplained: float) -> str:
    return f"{reading.mistake}, for then the motion follows it to {100 * unexplained:.2g} %: {reading.remedy}"


def check_direction(record: Record, axis: Axis) -> str:
    """The mistake of an equation of first order with a direction, where the output is a velocity: the direction is that
    of the output's change, which is then the acceleration's. Empty where the output may be a position.
    """
    model, config = axis.model.make(), axis.estimator
    above = _of_position(model.equation)
    if above is None or not np.any(np.diff(record.counts)):
        return ""
    u, counts = _liveliest(record.u, record.counts)
    encoder = Encoder(record.resolution, standstill_time=axis.encoder.standstill_time)
    finer, position = fine_counts(integrated(encoder.position(counts), record.dt))
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


def _of_position(equation: Equation) -> Equation | None:
    """The same equation of first order with the integral of the output in its place; None if it is no such equation."""
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


def _liveliest(u: Floats, counts: Counts) -> tuple[Floats, Counts]:
    """At most MOST_SAMPLES in a row, those over which the counts change most."""
    if u.size <= MOST_SAMPLES:
        return u, counts
    travelled = np.r_[0, np.cumsum(np.abs(np.diff(counts)))]
    start = int(np.argmax(travelled[MOST_SAMPLES - 1 :] - travelled[: u.size - MOST_SAMPLES + 1]))
    return u[start : start + MOST_SAMPLES], counts[start : start + MOST_SAMPLES]


def _exchanges(log: Reading, axis: Axis) -> Iterator[Reading]:
    """With the sign of the output turned, and with the columns exchanged."""
    config, u, encoder = axis.record, log.u, log.encoder
    yield replace(
        log, counts=-log.counts, mistake="the output has the opposite sign of the input", remedy=_turned(axis)
    )
    if isinstance(config.input_scale, str):
        return
    is_position = config.output_kind == "position"
    as_input = encoder.position(log.counts) if is_position else log.counts.astype(np.float64)
    finer, counts = fine_counts(u / config.input_scale * (1.0 if is_position else axis.encoder.resolution))
    remedy = f'give [record] input = "{config.output}" and output = "{config.input}"'
    yield Reading(config.input_scale * as_input, counts, finer, "input and output are exchanged", remedy)


def _loaded(log: Reading, axis: Axis) -> Reading:
    """With a constant load; as it stands where the model has one, or no room for one."""
    model = axis.model
    if model.kind != "drive" or model.offset or model.spring or model.friction == "directional":
        return log
    loaded = model.model_copy(update={"offset": True}).make()
    return replace(log, model=loaded, mistake="a constant load acts on the axis", remedy="give [model] offset = true")


def _velocity(log: Reading, dt: float, axis: Axis) -> Reading:
    finer, counts = fine_counts(integrated(log.encoder.position(log.counts), dt))
    mistake = f"the output column {axis.record.output!r} is a velocity and no position"
    there = axis.model.kind == "drive" and axis.record.output_kind == "position"
    return Reading(log.u, counts, finer, mistake, 'give [record] output_kind = "velocity"' if there else INTEGRATE)


def _lamer(log: Reading, estimator: IV, axis: Axis) -> Iterator[Reading]:
    """As it stands, but with what a model may lack: a load, and dead times up to two filter time constants."""
    loaded = _loaded(log, axis)
    yield loaded
    for part in DEAD_TIMES:
        late = min(log.u.size - 1, round(part / (estimator.cutoff * estimator.dt)))
        yield replace(loaded, u=np.r_[np.full(late, log.u[0]), log.u[: log.u.size - late]])


def _without_friction(estimator: IV, log: Reading) -> float:
    """Part of the input that the equation leaves without dry friction, which a motion in one direction cannot tell from
    the rest, and whatever the sign of the mass, which may be small against a dead time."""
    wet = tuple(term for term in estimator.equation.at_once.unknown if term.derivative > 0)
    model = EquationModel(Equation(wet, estimator.equation.known))
    try:
        return like(LS, estimator, model=model).fit(log.u, log.counts).relative_error
    except (NotIdentifiableError, UsageError):
        return np.inf


def integrated(velocity: Floats, dt: float) -> Floats:
    """The position (n,) from 0 on of a velocity (n,) that runs along a line between samples."""
    return np.asarray(np.r_[0.0, np.cumsum(velocity[1:] + velocity[:-1])] * (dt / 2))


def _turned(axis: Axis) -> str:
    if axis.model.kind == "drive" and isinstance(axis.model.input_gain, float):
        return f"give [model] input_gain = {-axis.model.input_gain:g}"
    return "give the known term of the input in [model] the other sign"


def _unexplained(estimator: IV, reading: Reading) -> float:
    """Part of the motion that the one simulated from the input alone leaves; infinite where there is no estimate."""
    encoder = replace(reading.encoder, standstill_time=estimator.encoder.standstill_time)
    least = np.inf
    for method in (IV, OE):  # the slower one where the encoder's noise hides how well the first does
        try:
            fit = like(method, estimator, model=reading.model or estimator.model, encoder=encoder).fit(
                reading.u, reading.counts
            )
        except (NotIdentifiableError, UsageError):
            continue
        mass, std = fit.theta[estimator.equation.leading], fit.theta_std[estimator.equation.leading]
        if std < KNOWN * mass:
            least = min(least, fit.relative_error)
        if least < CLEARLY:
            break
    return least

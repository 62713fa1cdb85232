"""A free friction curve from a record and AXIS.toml, or from arrays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from pmfid.encoder import Encoder
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.arguments import check_arrays
from pmfid.estimators.cutoff import choose_cutoff
from pmfid.estimators.friction_curve import NODES, FrictionCurve
from pmfid.estimators.friction_curve import friction_curve as curve_of
from pmfid.estimators.iv import IV
from pmfid.judge.drive import SIGNIFICANT, correlation_score
from pmfid.models.drive import Drive
from pmfid.models.equation import ESTIMATE
from pmfid.session.arrays import axis_of
from pmfid.session.config import Axis, check_sampling
from pmfid.session.drives import match_kind
from pmfid.session.gaps.longest import unbroken
from pmfid.session.known import check_numbers_known
from pmfid.session.outliers import believed_of
from pmfid.session.records import Record
from pmfid.types import Counts, Floats

#: Forces of a model that stand beside friction, and that no curve takes.
BESIDE = ("spring", "gravity", "cogging", "friction_period")
#: Time constant of the filters [samples] that is chosen at most: behind slower ones nearby speeds look alike.
SLOWEST = 30
FEEDBACK = (
    "the input follows what the curve leaves unexplained, as under position control, or with a dead time or a lag that "
    "[model] has not (pmfid identify tells): the curve may be off by many of its error bars, under control most where "
    "the same stroke is made again and again"
)


def friction_curve(
    u: ArrayLike,
    counts: ArrayLike,
    *,
    model: Drive,
    encoder: Encoder,
    dt: float,
    cutoff: float | None = None,
    nodes: int = NODES,
    rising_from: float | None = None,
) -> FrictionCurve:
    """Friction over velocity with no law assumed, and the mass beside it, as `pmfid friction` finds them.

    u: input (n,); counts (n,) of the encoder. model: its input_gain and dead_time count, what it says of friction
    does not. dt: sample period [s]. cutoff: pole of the filters [rad/s], None: by the record. nodes: speeds in each
    direction; rising_from: from this speed [m/s] on friction does not fall, None: it may. Raises UsageError for
    arguments that do not fit and NotIdentifiableError where the record does not show friction apart.
    """
    axis = axis_of(model, encoder, dt, {"cutoff": cutoff})
    return _estimate_curve(*check_arrays(u, counts), dt, encoder, axis, nodes, rising_from)


def record_curve(record: Record, axis: Axis, nodes: int = NODES, rising_from: float | None = None) -> FrictionCurve:
    """The same of a record that was read for `axis`, without what no motion explains."""
    record, axis = unbroken(record), match_kind(record, axis)
    without, encoder = believed_of(record, axis), axis.encoder.make_encoder(record.resolution)
    found = _estimate_curve(without.record.u, without.record.counts, record.dt, encoder, axis, nodes, rising_from)
    return replace(found, notes=(*record.notes, *filter(None, (without.told,)), *found.notes))


def _estimate_curve(
    u: Floats, counts: Counts, dt: float, encoder: Encoder, axis: Axis, nodes: int, rising_from: float | None
) -> FrictionCurve:
    model = axis.model.make()
    if not isinstance(model, Drive):
        raise UsageError('a friction curve is of a machine with friction: give [model] kind = "drive"')
    check_numbers_known(axis, "a friction curve")
    if axis.estimator.cutoff is not None:
        check_sampling(axis, dt)
    if beside := [key for key in BESIDE if getattr(model, key)]:
        raise UsageError(f"a friction curve beside {', '.join(beside)} is not there yet; record a motion without it")
    if model.lag:
        raise UsageError(
            "a friction curve behind a lag is not there yet, it would be wrong by many error bars: give [model] "
            "dead_time of the same time, or record a motion that is slow beside it"
        )
    if model.dead_time == ESTIMATE:
        raise UsageError("a friction curve needs the dead time: pmfid identify finds it; write it into [model]")
    free = Drive(model.input_gain, friction="directional", dead_time=model.dead_time)
    cutoff = axis.estimator.cutoff or max(choose_cutoff([free], encoder, dt, u, counts), 1 / (SLOWEST * dt))
    estimator = IV(free, encoder, dt, cutoff, order=axis.estimator.order)
    found = curve_of(estimator, u, counts, nodes, rising_from)
    if not found.mass_std < found.mass:
        raise NotIdentifiableError(
            f"the mass beside the curve comes out as {found.mass:.3g} with a standard deviation of {found.mass_std:.2g}"
            ": this record does not show friction apart behind these filters; use fewer nodes, or a higher cutoff, or "
            "record reversals and speeds that vary"
        )
    change = np.diff(u, prepend=u[:1])[-found.error.size :]
    follows = correlation_score(found.error, change) > SIGNIFICANT
    return replace(found, notes=(FEEDBACK,) if follows else (), motion=model.equation.motion)


def curve_json(found: FrictionCurve, name: str) -> dict[str, object]:
    """The object that `--json` prints."""
    return {"record": name, **found.to_dict()}

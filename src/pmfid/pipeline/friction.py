"""Estimate of a free friction curve from a record and AXIS.toml, or from arrays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from pmfid.config.axis import Axis, check_sampling
from pmfid.diagnostics.drives import correlation_score
from pmfid.diagnostics.tuning import TUNING as DIAGNOSTIC_TUNING
from pmfid.encoder import Encoder
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.configuration import check_arrays
from pmfid.estimators.cutoff import choose_cutoff
from pmfid.estimators.friction_curve import FrictionCurve
from pmfid.estimators.friction_curve import friction_curve as curve_of
from pmfid.estimators.iv import IV
from pmfid.estimators.tuning import TUNING as ESTIMATOR_TUNING
from pmfid.models.drive import POSITION_KEYS, Drive
from pmfid.models.equation import ESTIMATE
from pmfid.pipeline.arrays import axis_of
from pmfid.pipeline.drives import match_kind
from pmfid.pipeline.known import check_numbers_known
from pmfid.pipeline.tuning import TUNING
from pmfid.records.joining import unbroken
from pmfid.records.outliers import repair_as_configured
from pmfid.records.record import Record
from pmfid.types import Counts, Floats

FEEDBACK = (
    "the input follows the part that the curve leaves unexplained. The cause is position control, or a dead time or "
    "lag that [model] leaves out (see pmfid identify). The curve may be wrong by many standard errors, most of all "
    "under control with one repeated stroke"
)


def friction_curve(
    u: ArrayLike,
    counts: ArrayLike,
    *,
    model: Drive,
    encoder: Encoder,
    dt: float,
    cutoff: float | None = None,
    nodes: int = ESTIMATOR_TUNING.friction_curve_nodes,
    rising_from: float | None = None,
) -> FrictionCurve:
    """Estimate the mass, and friction over velocity without an assumed law, as `pmfid friction` does.

    Parameters
    ----------
    u : array_like (n,)
        The input.
    counts : array_like (n,)
        Counts of the encoder.
    model : Drive
        The drive. The function uses its input_gain and dead_time, and ignores its friction.
    encoder : Encoder
    dt : float
        Sample period [s].
    cutoff : float, optional
        Pole of the filters [rad/s]. By default, the record determines the pole.
    nodes : int
        Number of speeds in each direction.
    rising_from : float, optional
        Speed [unit of y per s] above which friction does not fall. By default, friction may fall at any speed.

    Returns
    -------
    FrictionCurve

    Raises
    ------
    UsageError
        The arguments contradict each other.
    NotIdentifiableError
        The record does not separate friction from other forces.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import Drive, Encoder, friction_curve, quantize
    >>> from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, simulate_drive
    >>> u = prbs(3000, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
    >>> counts = quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION)
    >>> curve = friction_curve(
    ...     u, counts, model=Drive(CART.input_gain), encoder=Encoder(CART_RESOLUTION), dt=CART_DT, cutoff=20.0, nodes=4
    ... )
    >>> round(curve.mass, 2), CART.mass
    (1.07, 1.07)
    """
    axis = axis_of(model, encoder, dt, {"cutoff": cutoff})
    return _estimate_curve(*check_arrays(u, counts), dt, encoder, axis, nodes, rising_from)


def record_curve(
    record: Record, axis: Axis, nodes: int = ESTIMATOR_TUNING.friction_curve_nodes, rising_from: float | None = None
) -> FrictionCurve:
    """Return the friction curve of a record that was read for `axis`, without samples that no motion explains."""
    record, axis = unbroken(record), match_kind(record, axis)
    repaired, encoder = repair_as_configured(record, axis), axis.encoder.make_encoder(record.resolution)
    found = _estimate_curve(repaired.record.u, repaired.record.counts, record.dt, encoder, axis, nodes, rising_from)
    return replace(found, notes=(*record.notes, *filter(None, (repaired.sentence,)), *found.notes))


def _estimate_curve(
    u: Floats, counts: Counts, dt: float, encoder: Encoder, axis: Axis, nodes: int, rising_from: float | None
) -> FrictionCurve:
    model = axis.model.make()
    if not isinstance(model, Drive):
        raise UsageError('a friction curve needs a machine with friction: give [model] kind = "drive"')
    check_numbers_known(axis, "a friction curve")
    if axis.estimator.cutoff is not None:
        check_sampling(axis, dt)
    if others := [key for key in POSITION_KEYS if getattr(model, key)]:
        raise UsageError(f"a friction curve with {', '.join(others)} is not supported yet; record a motion without it")
    if model.lag:
        raise UsageError(
            "a friction curve with a lag is not supported, because it would be wrong by many standard errors: give the "
            "time of the lag as [model] dead_time, or record a slower motion"
        )
    if model.dead_time == ESTIMATE:
        raise UsageError(
            "a friction curve needs a number as dead time: run pmfid identify, and write the dead_time "
            "that it finds into [model]"
        )
    free = Drive(model.input_gain, friction="directional", dead_time=model.dead_time)
    cutoff = axis.estimator.cutoff or max(
        choose_cutoff([free], encoder, dt, u, counts), 1 / (TUNING.friction_slowest * dt)
    )
    estimator = IV(free, encoder, dt, cutoff, order=axis.estimator.order)
    found = curve_of(estimator, u, counts, nodes, rising_from)
    if not found.mass_std < found.mass:
        raise NotIdentifiableError(
            f"the mass of the curve comes out as {found.mass:.3g} with a standard deviation of {found.mass_std:.2g}: "
            "these filters do not separate friction from the mass. Use fewer nodes or a higher cutoff, or record "
            "reversals and speeds that vary"
        )
    change = np.diff(u, prepend=u[:1])[-found.error.size :]
    follows = correlation_score(found.error, change) > DIAGNOSTIC_TUNING.significant
    return replace(found, notes=(FEEDBACK,) if follows else (), motion=model.equation.motion)


def curve_json(found: FrictionCurve, name: str) -> dict[str, object]:
    """Return the object that `--json` prints."""
    return {"record": name, **found.to_dict()}

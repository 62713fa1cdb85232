"""The on-line estimator of a configuration whose encoder gives the ages of its edges."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from pmfid.config.axis import Axis
from pmfid.encoder import Encoder
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.auto import AUTO
from pmfid.estimators.base import memory_of
from pmfid.estimators.redge import REdge, is_plain
from pmfid.models.drive import Drive
from pmfid.records.record import Record
from pmfid.status import Status
from pmfid.types import Floats


def takes_edges(axis: Axis) -> bool:
    """Return whether the on-line estimator of a configuration takes the ages of edges."""
    return axis.encoder.edge_age is not None and axis.estimator.method == AUTO


def make_edge_estimator(axis: Axis, record: Record, steps: bool = False) -> REdge:
    """Return the on-line estimator of a configuration that takes the ages of edges, for the record's clock.

    Raises UsageError for a model or a clock that this estimator does not take.
    """
    model, config = axis.model.make(), axis.estimator
    if steps or not isinstance(model, Drive) or not is_plain(model):
        raise UsageError(
            "edge times identify only mass, viscous and Coulomb friction, and an offset, and need a known input_gain "
            'and a fixed sample period; otherwise set method = "riv", which uses only the counts'
        )
    memory = memory_of(config.forgetting, record.dt)
    return REdge(
        model,
        Encoder(record.resolution, bits=axis.encoder.bits or 32),
        record.dt,
        lines=axis.encoder.lines,
        tick=axis.encoder.tick,
        memory=None if math.isinf(memory) else memory,
        precision=config.precision,
    )


def learn_edges(axis: Axis, normal: Record) -> Floats:
    """Return the normal parameters (p,) of a reference record with the ages of edges.

    Raises UsageError without ages, and NotIdentifiableError if the record does not give the parameters.
    """
    if normal.ages is None:
        raise UsageError(f"{normal.name} has no usable ages of edges ([encoder] edge_age); name another reference")
    estimator = replace(make_edge_estimator(axis, normal), memory=None)
    estimator.run(normal.u, normal.counts, normal.ages)
    if estimator.status & (Status.STARTING | Status.DISTORTED):
        raise NotIdentifiableError(
            f"the edges of {normal.name} do not give mass and friction: {Status(estimator.status)!r}; name a reference "
            "with more motion, or give [monitor] nominal"
        )
    return np.asarray(estimator.theta)

"""The on-line estimator and the monitor of a configuration whose encoder gives the ages of its edges."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from pmfid.config.axis import Axis
from pmfid.encoder import Encoder
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.auto import AUTO
from pmfid.estimators.base import memory_of
from pmfid.estimators.iv import initial_vector
from pmfid.estimators.redge import REdge, is_plain
from pmfid.models.drive import Drive
from pmfid.monitor.edges import EdgeMonitor
from pmfid.monitor.events import Watch
from pmfid.monitor.monitor import Monitor
from pmfid.pipeline.tuning import TUNING
from pmfid.records.joining import make_even
from pmfid.records.record import Record, read_record
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


@dataclass(frozen=True)
class EdgeSetup:
    """A monitor of edges at its start, with the normal parameters (p,) and texts for the user."""

    monitor: EdgeMonitor
    nominal: Floats
    notes: tuple[str, ...] = ()

    @property
    def reported(self) -> Floats:
        """The nominal values (p,)."""
        return self.nominal

    @cached_property
    def baseline(self) -> str:
        """Nominal values as text."""
        return json.dumps({"nominal": self.nominal.tolist()})

    def take_baseline(self, text: str) -> EdgeSetup:
        """Return the same monitor at its start with the nominal values of an earlier run.

        Raises ValueError, TypeError, KeyError or UsageError for a text that no such monitor has saved.
        """
        nominal = np.array(json.loads(text)["nominal"], np.float64)
        return replace(self, monitor=EdgeMonitor(self.monitor.estimator, nominal, self.monitor.watch), nominal=nominal)

    def describe_start(self) -> dict[str, object]:
        """Return the settings of a monitored axis for `--json`."""
        return describe_monitor(self.monitor, self.nominal) | {"notes": list(self.notes)}


def describe_monitor(monitor: Monitor | EdgeMonitor, nominal: Floats) -> dict[str, object]:
    """Return the settings of any monitor with the nominal values (q,) for `--json`."""
    return {
        "event": "start",
        "method": monitor.estimator.method,
        "nominal": dict(zip(monitor.names, nominal.tolist(), strict=True)),
        "units": dict(zip(monitor.names, monitor.units, strict=True)),
        "mtbf_hours": monitor.watch.mtbf_hours,
        "tolerance": monitor.watch.tolerance,
        "threshold": monitor.threshold,
    }


def set_up_edges(axis: Axis, folder: Path, record: Record | None) -> EdgeSetup:
    """Return the monitor of AXIS.toml in `folder` for a record with the ages of edges, or for a pipe if it is None.

    The normal parameters are those of [monitor] nominal, or of the reference record by the same estimator. A pipe has
    the sample period of the reference. Raises UsageError without either, and NotIdentifiableError if the reference does
    not give the parameters.
    """
    config = axis.monitor
    if axis.record.friction_temperature is not None:
        raise UsageError(
            'friction_temperature works with the counts alone: set [estimator] method = "riv", or drop the key'
        )
    normal = None if config.reference is None else make_even(read_record(folder / config.reference, axis))
    source = record or normal
    if source is None or (normal is None and config.nominal is None):
        raise UsageError(
            '[monitor] reference is missing: name a record of normal work, for example reference = "normal.csv"'
            + ("" if record is None else ", or give the nominal values")
        )
    if normal is not None and abs(source.dt / normal.dt - 1) > 1e-3:
        raise UsageError(
            f"the record has dt = {source.dt:g} s, the reference {normal.dt:g} s; take a reference with the same "
            "sample period"
        )
    estimator, watch = make_edge_estimator(axis, source), Watch(config.mtbf_hours, config.tolerance)
    if config.nominal is not None:
        nominal = initial_vector(config.nominal, estimator.names)
    elif normal is not None:
        nominal = _learn_normal(axis, normal)
    following = replace(estimator, memory=estimator.memory or TUNING.default_memory)
    return EdgeSetup(EdgeMonitor(following, nominal, watch), nominal)


def _learn_normal(axis: Axis, normal: Record) -> Floats:
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

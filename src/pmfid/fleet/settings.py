"""What the estimates of a fleet are made with: AXIS.toml, completed once by records of the fleet itself."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from pmfid.errors import UsageError
from pmfid.estimators.base import Estimator
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.registry import ESTIMATORS
from pmfid.session.config import Axis, check_sampling
from pmfid.session.drives import make_estimator
from pmfid.session.known import finds_gain
from pmfid.session.records import Record, record_of
from pmfid.session.tables import Table

#: Lengths of a segment, one estimate, where the configuration has no memory of its own [s].
SEGMENTS = (60.0, 120.0, 300.0, 600.0, 1800.0)
#: The same in memories.
MEMORIES = 2.5
#: Rests that are left out may lengthen a segment by this factor.
SPAN = 10
#: Length of a segment in settling times of the filters: usual and least.
SETTLED, LEAST_SETTLED = 20, 4
#: Part of a piece whose samples may be missing.
MOST_MISSING = 0.2


@dataclass(frozen=True)
class Settings:
    """axis: with method and pole of the filters; estimator: at the sample period of the record that they were chosen
    by; segment: [s] of an estimate; span: [s] that it may take with the rests that are left out."""

    axis: Axis
    estimator: RecursiveEstimator
    segment: float
    span: float

    def adapt_estimator(self, dt: float, resolution: float) -> RecursiveEstimator:
        """The estimator of an axis with another sample period [s] and resolution. Raises UsageError if the pole of the
        filters does not fit the axis."""
        check_sampling(self.axis, dt)
        if dt == self.estimator.dt and resolution == self.estimator.encoder.resolution:
            return self.estimator
        encoder = replace(self.estimator.encoder, resolution=resolution)
        return replace(self.estimator, dt=dt, encoder=encoder, forgetting=forgetting_of(self.segment, dt))


def forgetting_of(segment: float, dt: float) -> float:
    """Weight of the past per sample in a segment [s]: of its first samples, which may have come before the filters and
    the method's model had settled, little is left at its end."""
    return max(0.5, 1 - MEMORIES * dt / segment)


def record_at(table: Table, axis: Axis) -> Record:
    """The record of a piece, whose time is in s. Raises UsageError for what is none."""
    own = axis.record.model_copy(update={"time_unit": "s", "dt": None})
    record = record_of(table, axis.model_copy(update={"record": own}))
    if record.there is not None and record.there.mean() < 1 - MOST_MISSING:
        raise UsageError(
            f"{1 - record.there.mean():.0%} of the samples are missing on the grid of {record.dt:.6g} s that fits most"
            ": the sample period changes within, or the logger loses as much"
        )
    return replace(record, dt=float(f"{record.dt:.6g}"))


@dataclass(frozen=True)
class Chosen:
    """A choice by records of the fleet: pole of the filters [rad/s], zeros of the pre-filters [1/s], and sample period
    [s] and resolution of the records."""

    cutoff: float
    zeros: tuple[float, float] | None
    dt: float
    resolution: float


def choose_method(axis: Axis) -> Axis:
    """The axis with the method that "auto" stands for. Raises UsageError for settings that a history does not
    support."""
    method = "riv" if axis.estimator.method == "auto" else axis.estimator.method
    if not issubclass(ESTIMATORS[method], RecursiveEstimator):
        raise UsageError(f"[estimator] method = {method!r} takes a record as a whole; use riv, bcrls or auto")
    if finds_gain(axis) or axis.estimator.given or axis.estimator.prior:
        raise UsageError("the history of a fleet takes no given, prior or input_gain to be found; give the input_gain")
    return axis.model_copy(update={"estimator": axis.estimator.model_copy(update={"method": method})})


def make_settings(axis: Axis, chosen: Chosen, most: float, segment: float | None) -> Settings:
    """most: that a segment may last [s]; segment: [s], None: by the memory of [estimator] forgetting, or by the
    filters. Raises UsageError for segments that are too short for the filters."""
    config = choose_method(axis).estimator.model_copy(update={"cutoff": chosen.cutoff, "prefilter_zeros": chosen.zeros})
    axis = axis.model_copy(update={"estimator": config})
    nothing = Record(np.zeros(0), np.zeros(0, np.int64), chosen.dt, chosen.resolution, (), "")
    estimator = recursive(make_estimator(axis, nothing))
    settled = estimator.settle_samples * chosen.dt
    if segment is None:
        plain = next((one for one in SEGMENTS if one >= SETTLED * settled), SEGMENTS[-1])
        segment = plain if config.forgetting == 1 else MEMORIES * chosen.dt / (1 - config.forgetting)
    segment, least = min(segment, most), LEAST_SETTLED * settled
    if not segment >= least:
        raise UsageError(
            f"segments of {segment:.3g} s are too short for the filters, which take {least:.3g} s: use longer periods "
            "or segments, or a higher cutoff"
        )
    estimator = replace(estimator, forgetting=forgetting_of(segment, chosen.dt), forgetting_scheme="exponential")
    return Settings(axis, estimator, segment, max(segment, min(SPAN * segment, most)))


def recursive(estimator: Estimator) -> RecursiveEstimator:
    """The same. Raises UsageError for an off-line method."""
    if not isinstance(estimator, RecursiveEstimator):
        raise UsageError(f"{estimator.method} is an off-line method; use riv or bcrls")
    return estimator


def quarter_of(settings: Settings, dt: float) -> int:
    """Samples of a quarter of a segment: estimates are kept on this grid, and pieces cut to it."""
    return max(1, math.floor(settings.segment / dt / 4))

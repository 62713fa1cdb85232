"""Settings of a history, and its method and filters."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from pmfid.config.axis import Axis, check_sampling
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.base import Estimator
from pmfid.estimators.cutoff import CUTOFF_TRIED
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.redge import REdge
from pmfid.estimators.registry import ESTIMATORS
from pmfid.estimators.stretches import parts_of
from pmfid.fleet.tuning import TUNING
from pmfid.io.tables import Table
from pmfid.pipeline.drives import make_estimator, match_kind
from pmfid.pipeline.edges import make_edge_estimator, takes_edges
from pmfid.pipeline.known import finds_gain
from pmfid.records.joining import make_even
from pmfid.records.record import Record, record_of


@dataclass(frozen=True)
class Settings:
    """The settings of a history.

    `axis` includes the method and the pole of the filters. `estimator` has the sample period of the record that decided
    on method and pole. `segment` is the length of an estimate [s], and `span` its largest duration with the omitted
    rests [s].
    """

    axis: Axis
    estimator: RecursiveEstimator | REdge
    segment: float
    span: float

    def adapt_estimator(self, dt: float, resolution: float) -> RecursiveEstimator | REdge:
        """Return the estimator of an axis with another sample period [s] and resolution.

        Raises UsageError if the pole of the filters does not fit the axis.
        """
        encoder = replace(self.estimator.encoder, resolution=resolution)
        if isinstance(self.estimator, REdge):
            return replace(self.estimator, dt=dt, encoder=encoder)
        check_sampling(self.axis, dt)
        estimator = recursive(self.estimator)
        if dt == estimator.dt and resolution == estimator.encoder.resolution:
            return estimator
        return replace(estimator, dt=dt, encoder=encoder, forgetting=forgetting_of(self.segment, dt))


def forgetting_of(segment: float, dt: float) -> float:
    """Return the weight of the past per sample in a segment [s].

    The first samples of a segment may have come before the filters and the method's model had settled. At the end of
    the segment, little of these samples is left.
    """
    return max(0.5, 1 - TUNING.settings_memories * dt / segment)


def record_at(table: Table, axis: Axis) -> Record:
    """Return the record of a piece, whose time is in s. Raises UsageError for a piece that is no record."""
    own = axis.record.model_copy(update={"time_unit": "s", "dt": None})
    record = make_even(record_of(table, axis.model_copy(update={"record": own})))
    if record.there is not None and record.there.mean() < 1 - TUNING.most_missing:
        raise UsageError(
            f"even at the most suitable sample period, {record.dt:.6g} s, {1 - record.there.mean():.0%} "
            "of the samples are missing: either the sample period changes within the record, or the "
            "logger loses samples"
        )
    return replace(record, dt=float(f"{record.dt:.6g}"))


def choose_method(axis: Axis) -> Axis:
    """Return the axis with the method that "auto" selects.

    Raises UsageError for settings that a history does not support.
    """
    method = "riv" if axis.estimator.method == "auto" else axis.estimator.method
    if not issubclass(ESTIMATORS[method], RecursiveEstimator):
        raise UsageError(f"[estimator] method = {method!r} needs a whole record at once; use riv, bcrls or auto")
    if finds_gain(axis) or axis.estimator.given or axis.estimator.prior:
        raise UsageError(
            "the history of a fleet does not accept given, prior, or an unknown input_gain; give the "
            "value of input_gain"
        )
    return axis.model_copy(update={"estimator": axis.estimator.model_copy(update={"method": method})})


def make_settings(given: Axis, estimator: RecursiveEstimator | REdge, most: float, segment: float | None) -> Settings:
    """Make the settings of a history from the estimator of `choose`.

    `most` is the largest duration of a segment [s]. `segment` is its length [s]. By default the length fits the memory
    of [estimator] forgetting, or the filters. Raises UsageError for segments that are too short for the filters.
    """
    if isinstance(estimator, REdge):
        length = min(TUNING.settings_segment if segment is None else segment, most)
        return Settings(given, estimator, length, length)
    filters = {"cutoff": estimator.cutoff, "prefilter_zeros": estimator.prefilter_zeros}
    config = choose_method(given).estimator.model_copy(update=filters)
    axis = given.model_copy(update={"estimator": config})
    settled = estimator.settle_samples * estimator.dt
    if segment is None:
        plain = max(TUNING.settings_segment, TUNING.settings_settled * settled)
        segment = plain if config.forgetting == 1 else TUNING.settings_memories * estimator.dt / (1 - config.forgetting)
    segment, least = min(segment, most), TUNING.segments_long * settled
    if not segment >= least:
        raise UsageError(
            f"segments of {segment:.3g} s are shorter than the {least:.3g} s that the filters need; use "
            "longer periods or segments, or a higher cutoff"
        )
    estimator = replace(estimator, forgetting=forgetting_of(segment, estimator.dt))
    return Settings(axis, estimator, segment, max(segment, min(TUNING.settings_span * segment, most)))


def recursive(estimator: Estimator | REdge) -> RecursiveEstimator:
    """Return the estimator. Raises UsageError for an off-line method."""
    if not isinstance(estimator, RecursiveEstimator):
        raise UsageError(f"{estimator.method} is an off-line method; use riv or bcrls")
    return estimator


def quarter_of(settings: Settings, dt: float) -> int:
    """Return the number of samples in a quarter of a segment, the grid on which estimates are kept and pieces cut."""
    return max(1, math.floor(settings.segment / dt / 4))


def choose(given: Axis, tables: Iterable[Table]) -> RecursiveEstimator | REdge:
    """Return the estimator whose pre-filter has the zeros that suit the first record with motion.

    The filters are the quickest, because axes outside the sample may move in any way. The tables belong to different
    axes. Raises UsageError for a method that is not recursive, and the error of the first table if no record is
    suitable.
    """
    axis = choose_method(given)
    refused: UsageError | NotIdentifiableError = UsageError("no axis has any rows")
    for number, table in enumerate(tables):
        try:
            return _choose_for(given, axis, _cut_gaps(record_at(table, axis)))
        except (UsageError, NotIdentifiableError) as error:
            refused = error if number == 0 else refused
    raise type(refused)(f"{refused}; if another column names the axes, correct --axis")


def _cut_gaps(record: Record) -> Record:
    """Return the longest part of a record without a gap. Raises NotIdentifiableError for a part without motion."""
    part = max(parts_of(record.u), key=lambda part: part.stop - part.start, default=slice(0, 0))
    if not np.any(np.diff(record.counts[part])):
        raise NotIdentifiableError("the first axes do not move, so their parameters cannot be estimated")
    return replace(record, u=record.u[part], counts=record.counts[part], there=None)


def _choose_for(given: Axis, axis: Axis, record: Record) -> RecursiveEstimator | REdge:
    if takes_edges(given):
        return replace(make_edge_estimator(given, record), memory=None)
    cutoff = axis.estimator.cutoff or 1 / (min(CUTOFF_TRIED) * record.dt)
    update = {"cutoff": cutoff, "forgetting": forgetting_of(TUNING.settings_segment, record.dt)}
    own = axis.model_copy(update={"estimator": axis.estimator.model_copy(update=update)})
    return recursive(make_estimator(match_kind(record, own), record))

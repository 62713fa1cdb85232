"""The way from AXIS.toml to the recursive estimator that runs on a drive with its own counter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pmfid.config.axis import Axis, EstimatorConfig
from pmfid.config.record import NO_ENCODER
from pmfid.errors import UsageError
from pmfid.estimators.auto import AUTO
from pmfid.estimators.base import memory_of
from pmfid.estimators.plants import plant_of
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.redge import REdge
from pmfid.estimators.registry import ESTIMATORS, methods_for
from pmfid.estimators.sample_steps import GIVEN
from pmfid.linear.experiment import Experiment
from pmfid.pipeline.drives import make_estimator
from pmfid.pipeline.edges import make_edge_estimator, takes_edges
from pmfid.pipeline.identify import kind_of
from pmfid.pipeline.known import check_numbers_known
from pmfid.records.record import Record


def drive_estimator(
    axis: Axis, record: Record | None = None, dt: float | None = None, steps: bool = False
) -> RecursiveEstimator | REdge:
    """Return the recursive estimator of a configuration for the raw counts of a counter.

    The record determines the sample period. If the configuration has no pre-filter zeros, the record determines the
    zeros. Without a record, dt [s] or [record] dt is the sample period, and the zeros are the method's default. If
    `steps`, each sample comes with the time since the previous sample. With [encoder] edge_age and the method "auto",
    the estimator is `REdge`. Raises UsageError for an off-line method or a missing sample period.
    """
    if takes_edges(axis):
        check_exportable(axis)
        return make_edge_estimator(axis, record or _no_record(axis, dt), steps)
    if record is not None:
        axis = _prepare(axis, record)
    config, model = check_exportable(axis), axis.model.make()
    if record is None:
        record = _no_record(axis, dt)
        if ESTIMATORS[config.method].instrumental and config.prefilter_zeros is None:
            needed, memory = len(model.equation.symmetric.noisy), memory_of(config.forgetting, record.dt)
            zeros = plant_of(model.equation).zeros_without_record(config.pole, memory, needed)
            config = config.model_copy(update={"prefilter_zeros": zeros})
    estimator = make_estimator(axis.model_copy(update={"estimator": config}), record)
    encoder = replace(estimator.encoder, bits=axis.encoder.bits or 32)
    return replace(estimator, encoder=encoder, steps=GIVEN if steps else None)  # type: ignore[return-value]


def check_exportable(axis: Axis) -> EstimatorConfig:
    """Return [estimator] with the on-line method of the plant in place of "auto".

    Raises UsageError for a method or data that a drive cannot have. The function needs no record.
    """
    kind, config, model = kind_of(axis), axis.estimator, axis.model.make()
    check_numbers_known(axis, "firmware")
    if refused := model.equation.refuse_second_mass("firmware"):
        raise UsageError(refused)
    if axis.encoder.resolution == NO_ENCODER:
        raise UsageError(
            "firmware reads counts: give the travel per count of the encoder or converter as [encoder] resolution"
        )
    if config.method == AUTO:
        config = config.model_copy(update={"method": kind.on_line})
    usable = [name for name in methods_for(model) if issubclass(ESTIMATORS[name], RecursiveEstimator)]
    if config.method not in usable:
        names = ", ".join(usable)
        raise UsageError(
            f"{config.method} cannot run sample by sample on this model; give --method with one of {names}"
        )
    kind.check_on_line(axis.model_copy(update={"estimator": config}))
    return config


def drive_samples(estimator: RecursiveEstimator | REdge, record: Record) -> tuple[np.ndarray, ...]:
    """Return input and counts (n,) of the self-test, and the ages of edges if the estimator takes them.

    Raises UsageError if the record does not have the ages.
    """
    if not isinstance(estimator, REdge):
        return record.u, record.counts
    if record.ages is None:
        raise UsageError(
            f"{record.name} has no usable ages of edges ([encoder] edge_age); give another record, or leave --record "
            "out"
        )
    return record.u, record.counts, record.ages


def _prepare(axis: Axis, record: Record) -> Axis:
    """Return the configuration with values for all settings that the counts of a record determine."""
    if axis.model.kind != "transfer_function":
        return kind_of(axis).prepare_axis(record, axis)
    output = np.asarray(record.counts * record.resolution, np.float64)
    return kind_of(axis).prepare_axis([Experiment(record.u, output, dt=record.dt)], axis)


def _no_record(axis: Axis, dt: float | None) -> Record:
    dt = axis.record.dt if dt is None else dt
    if dt is None:
        raise UsageError("the sample period is not known: give --dt in s, [record] dt, or --record")
    return Record(np.empty(0), np.empty(0, np.int64), dt, axis.encoder.resolution, (), "")

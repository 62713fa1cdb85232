"""A monitor from AXIS.toml."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, is_dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np

from pmfid.config.axis import Axis
from pmfid.errors import UsageError
from pmfid.estimators.configuration import like
from pmfid.estimators.facts import INPUT_GAIN
from pmfid.estimators.iv import IV, RIV, initial_vector
from pmfid.estimators.known import Known
from pmfid.estimators.recursive import RLS, RecursiveEstimator
from pmfid.estimators.registry import ESTIMATORS
from pmfid.monitor.calibration import Calibration, calibrate
from pmfid.monitor.edges import EdgeMonitor
from pmfid.monitor.events import Watch
from pmfid.monitor.monitor import Monitor
from pmfid.monitor.warmth import find_warmth
from pmfid.pipeline.drives import make_estimator
from pmfid.pipeline.edges import learn_edges, make_edge_estimator, takes_edges
from pmfid.pipeline.identify import kind_of
from pmfid.pipeline.known import finds_gain, known_of, set_gain, try_both_signs
from pmfid.records.joining import make_even
from pmfid.records.record import Record, read_record
from pmfid.types import Floats

#: Memory [s] if [estimator] forgetting is 1, because an infinite memory would never follow a change.
DEFAULT_MEMORY = 2.0
#: Ratio of the standard deviations in normal work and in simulation above which the encoder is not the main noise.
SETUP_NOISY = 1.3
#: Factor within which a reference record should determine the mean time between false alarms.
SETUP_SURE = 2.0

#: Version of the calibration in saved states. Every change of it needs a new version.
VERSION = 12


def _read_fields(kind: Any, raw: dict[str, Any]) -> Any:
    """Return a dataclass of numbers, arrays and such dataclasses from a part of a baseline.

    Raises ValueError, TypeError or KeyError for another object.
    """
    hints = get_type_hints(kind)
    return kind(**{name: _read_value(hint, raw[name]) for name, hint in hints.items()})


def _read_value(hint: Any, raw: Any) -> Any:
    if isinstance(raw, dict):
        return _read_fields(next(filter(is_dataclass, (hint, *get_args(hint))), None), raw)
    return np.array(raw) if isinstance(raw, list) else raw


@dataclass(frozen=True)
class Setup:
    """A monitor at its start, of counts or of edges.

    `nominal` (p,) are the normal parameters. `notes` are texts for the user.
    """

    monitor: Monitor | EdgeMonitor
    nominal: Floats
    notes: tuple[str, ...] = ()

    @property
    def reported(self) -> Floats:
        """The nominal values (q,), with an estimated input gain at the end."""
        further = len(self.monitor.names) - len(self.monitor.estimator.names)
        return np.concatenate([self.nominal, [self.monitor.estimator.equation.input_gain] * further])

    @cached_property
    def baseline(self) -> str:
        """The numbers that a monitor got from its reference, as text: nominal values, thresholds and input gain.

        A linear algebra rounds them by the kind of processor and by the number of threads. States of a monitor
        therefore travel together with its baseline, from which `set_up` makes the same monitor.
        """
        if isinstance(self.monitor, EdgeMonitor):
            return json.dumps({"nominal": self.nominal.tolist()})
        gain, calibration = self.monitor.estimator.equation.input_gain, asdict(self.monitor.calibration)
        return json.dumps({"calibration": calibration, "input_gain": gain}, default=lambda array: array.tolist())

    def describe_start(self) -> dict[str, object]:
        """Return the settings of a monitored axis for `--json`."""
        monitor, watch = self.monitor, self.monitor.watch
        hours = {"record_hours": monitor.calibration.record_hours} if isinstance(monitor, Monitor) else {}
        return {
            "event": "start",
            "method": monitor.estimator.method,
            "nominal": dict(zip(monitor.names, self.reported.tolist(), strict=True)),
            "units": dict(zip(monitor.names, monitor.units, strict=True)),
            "mtbf_hours": watch.mtbf_hours,
            "tolerance": watch.tolerance,
            "threshold": monitor.threshold,
            **hours,
            "notes": list(self.notes),
        }


def _begin_at(estimator: RecursiveEstimator, nominal: Floats) -> RecursiveEstimator:
    """Return the estimator with start values (p,), if it takes any."""
    if not isinstance(estimator, RIV):
        return estimator
    return replace(estimator, initial=dict(zip(estimator.names, nominal.tolist(), strict=True)))


def set_up(axis: Axis, folder: Path, record: Record | None, baseline: str | None = None) -> Setup:
    """Return the monitor of AXIS.toml in `folder` for a record, or for a pipe if `record` is None.

    The monitor is that of edges if the configuration, and the record if there is one, has their ages. A `baseline` of
    the same configuration saves the time of the calibration. Raises UsageError if both reference and record are
    missing, or if the nominal values are missing. Raises NotIdentifiableError if the reference cannot identify the
    nominal values.
    """
    edges, config = takes_edges(axis) and (record is None or record.ages is not None), axis.monitor
    if edges and axis.record.friction_temperature is not None:
        raise UsageError(
            'friction_temperature works with the counts alone: set [estimator] method = "riv", or drop the key'
        )
    if not edges:
        check_monitored(axis)
    normal = None if config.reference is None else make_even(read_record(folder / config.reference, axis))
    if normal is None and (record is None or config.nominal is None):
        raise UsageError(
            "[monitor] reference is missing: name a record of normal work, 10 minutes or more, "
            'for example reference = "normal.csv"' + ("" if record is None else ", or give the nominal values")
        )
    if record is not None and normal is not None and abs(record.dt / normal.dt - 1) > 1e-3:
        raise UsageError(
            f"the record has dt = {record.dt:g} s, the reference {normal.dt:g} s; take a reference with the same "
            "sample period"
        )
    raw = None if baseline is None else json.loads(baseline)
    return _set_up_edges(axis, normal, record, raw) if edges else _set_up_counts(axis, normal, record, raw)


def _set_up_edges(axis: Axis, normal: Record | None, record: Record | None, raw: dict[str, Any] | None) -> Setup:
    """Return the monitor of edges. The normal parameters are given, or those of the reference by the same estimator."""
    source, config = record or normal, axis.monitor
    assert source is not None  # as checked
    estimator = make_edge_estimator(axis, source)
    if raw is not None:
        nominal = np.array(raw["nominal"], np.float64)
    elif config.nominal is not None or normal is None:
        nominal = initial_vector(config.nominal or {}, estimator.names)
    else:
        nominal = learn_edges(axis, normal)
    following = replace(estimator, memory=estimator.memory or DEFAULT_MEMORY)
    return Setup(EdgeMonitor(following, nominal, Watch(config.mtbf_hours, config.tolerance)), nominal)


def _set_up_counts(axis: Axis, normal: Record | None, record: Record | None, raw: dict[str, Any] | None) -> Setup:
    """Return the monitor of counts.

    Without a reference, the record's own input calibrates the monitor, with the encoder as the only noise.
    """
    source, config, notes = normal or record, axis.monitor, list[str]()
    assert source is not None  # as checked
    on_line = kind_of(axis).prepare_axis(source, _configure_recursive(axis, source.dt))
    gain = None if raw is None else float(raw["input_gain"])
    estimator = _estimator(_set_normal_gain(on_line, source, gain), source, wraps=record is None)
    known = known_of(axis, estimator)
    calibration = None if raw is None else _read_fields(Calibration, raw["calibration"])
    nominal = _nominal(estimator, config.nominal, source, known) if calibration is None else calibration.theta
    estimator = _begin_at(estimator, nominal)
    if normal is None:
        notes.append("no reference record: thresholds hold for the encoder's noise alone; name one in [monitor]")
    counts = None if normal is None else source.counts
    temperature = None if normal is None else source.temperature
    calibration = calibration or calibrate(estimator, nominal, source.u, counts, temperature)
    notes += calibration_notes(calibration, config.mtbf_hours)
    watch = Watch(config.mtbf_hours, config.tolerance)
    return Setup(Monitor(estimator, calibration, watch, known), nominal, tuple(notes))


def calibration_notes(calibration: Calibration, mtbf_hours: float) -> list[str]:
    """Return notes on the thresholds if normal work is noisier than its simulation."""
    hours, notes = calibration.record_hours, []
    if np.max(calibration.noise) > SETUP_NOISY or hours:
        notes.append(
            f"normal work is {np.max(calibration.noise):.2g} times as noisy as the encoder explains: "
            + ("the thresholds come from" if hours else "the scale is that of")
            + " the reference record itself"
        )
    doubt = calibration.chance.doubt(mtbf_hours)
    if hours and doubt > math.log(SETUP_SURE):
        notes.append(
            f"from the {hours:.2g} h of the reference record the time between false alarms is known to a factor of "
            f"{math.exp(doubt):.2g} only. A factor of {SETUP_SURE:g} takes about "
            f"{hours * (doubt / math.log(SETUP_SURE)) ** 2:.2g} h: record more normal work, or "
            "lower mtbf_hours"
        )
    return notes


def check_monitored(axis: Axis) -> None:
    """Raise UsageError for a model that the monitor cannot watch. The check needs no record."""
    equation = axis.model.make().equation
    if refused := equation.refuse_second_mass("the monitor"):
        raise UsageError(refused)
    reason = equation.without_simulation
    if reason:
        raise UsageError(
            f"the monitor is for a machine with friction that it can simulate, but {reason}. To follow the parameters "
            "of this equation use pmfid identify with forgetting < 1 and bcrls"
        )


def _configure_recursive(axis: Axis, dt: float) -> Axis:
    """Return the axis with a recursive method (`riv` for auto) and with a memory."""
    method = "riv" if axis.estimator.method == "auto" else axis.estimator.method
    forgetting = axis.estimator.forgetting
    if forgetting == 1:
        forgetting = max(0.5, 1 - dt / DEFAULT_MEMORY)
    changed = axis.estimator.model_copy(update={"method": method, "forgetting": forgetting})
    return axis.model_copy(update={"estimator": changed})


def _estimator(axis: Axis, source: Record, wraps: bool) -> RecursiveEstimator:
    """Return the configured recursive method. `wraps` says whether the counter's bits matter, as in a pipe."""
    method = axis.estimator.method
    if not issubclass(ESTIMATORS[method], RecursiveEstimator) or issubclass(ESTIMATORS[method], RLS):
        usable = [
            name for name, cls in ESTIMATORS.items() if issubclass(cls, RecursiveEstimator) and not issubclass(cls, RLS)
        ]
        raise UsageError(f"[estimator] method = {method!r} does not run sample by sample without bias: use {usable}")
    estimator = make_estimator(axis, source)
    if not isinstance(estimator, RecursiveEstimator):
        raise UsageError(f"{method} is an off-line method")
    if wraps and axis.encoder.bits is not None and axis.record.output_kind == "counts":
        return replace(estimator, encoder=replace(estimator.encoder, bits=axis.encoder.bits))
    return estimator


def _set_normal_gain(axis: Axis, source: Record, known: float | None) -> Axis:
    """Return the axis with the input gain of normal work if the gain is estimated.

    The gain comes from a baseline (`known`), [monitor] nominal or the reference. Raises UsageError if nominal has no
    input gain.
    """
    if not finds_gain(axis):
        return axis
    if known is not None:
        return set_gain(axis, known)
    given = axis.monitor.nominal
    if given is not None and INPUT_GAIN not in given:
        raise UsageError(f"[monitor] nominal must name {INPUT_GAIN}, too, if [model] leaves it to be estimated")
    if given is not None:
        return set_gain(axis, given[INPUT_GAIN])

    def find_gain(own: Axis) -> Axis:
        estimator = _estimator(own, source, wraps=False)
        known = known_of(axis, estimator)
        fit = like(IV, estimator, prefilter_zeros=None).fit(source.u, source.counts)
        return own if known is None else set_gain(own, known.combine(fit)[INPUT_GAIN])

    return try_both_signs(axis, find_gain)


def _fit_reference(front: IV, source: Record, known: Known | None) -> Floats:
    """Return the parameters (p,) of a reference. Only prior information needs their standard errors."""
    if known is None:
        return front.settle_iteration(source.u, source.counts)[1]
    return np.asarray(known.combine(front.fit(source.u, source.counts)).theta[: len(front.names)])


def _nominal(
    estimator: RecursiveEstimator, given: dict[str, float] | None, source: Record, known: Known | None
) -> Floats:
    """Return the normal parameters (p,), as given or as identified from the reference."""
    front = like(IV, estimator, prefilter_zeros=None)
    names = front.names
    if given is None:
        theta = _fit_reference(front, source, known)
        if source.temperature is None:
            return theta
        return find_warmth(front, theta, source.u, source.counts, source.temperature)[1]
    try:
        return initial_vector({name: value for name, value in given.items() if name in names or known is None}, names)
    except UsageError:
        raise UsageError(f"[monitor] nominal must name {list(names)}, got {list(given)}") from None

"""A monitor from AXIS.toml, with thresholds in a cache."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from pmfid.config.axis import Axis
from pmfid.errors import UsageError
from pmfid.estimators.base import Estimator
from pmfid.estimators.configuration import like
from pmfid.estimators.facts import INPUT_GAIN
from pmfid.estimators.iv import IV, RIV, initial_vector
from pmfid.estimators.known import Known
from pmfid.estimators.recursive import RLS, RecursiveEstimator
from pmfid.estimators.registry import ESTIMATORS
from pmfid.monitor.calibration import Calibration, NormalWork, Tail, calibrate
from pmfid.monitor.events import Watch
from pmfid.monitor.monitor import Monitor
from pmfid.monitor.scores import Scale
from pmfid.monitor.tuning import TUNING as MONITOR_TUNING
from pmfid.monitor.warmth import Warmth, find_warmth
from pmfid.pipeline.drives import make_estimator
from pmfid.pipeline.edges import EdgeSetup, describe_monitor, set_up_edges, takes_edges
from pmfid.pipeline.identify import kind_of
from pmfid.pipeline.known import finds_gain, known_of, set_gain, try_both_signs
from pmfid.pipeline.tuning import TUNING
from pmfid.records.joining import make_even
from pmfid.records.record import Record, read_record
from pmfid.types import Floats

#: Version of the calibration and its file. Every change of either needs a new version.
VERSION = 9
#: Simulated time of a calibration [h].
HOURS = MONITOR_TUNING.calibration_hours


def cache_dir() -> Path:
    """Return the folder of calibrations, which is PMFID_CACHE, or pmfid in the user's cache folder."""
    if os.environ.get("PMFID_CACHE"):
        return Path(os.environ["PMFID_CACHE"])
    home = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    return Path(home) / "pmfid" if home else Path.home() / ".cache" / "pmfid"


def cached_calibration(
    estimator: Estimator,
    theta: Floats,
    u: Floats,
    counts: np.ndarray | None,
    hours: float,
    progress: Callable[[float], None] | None = None,
    temperature: Floats | None = None,
) -> tuple[Calibration, Path, bool]:
    """Return the calibration, its file, and whether the file existed. An unwritable cache is ignored."""
    digest = sha256(f"{VERSION} {estimator!r} {hours!r} {counts is None}".encode())
    for part in (theta, u, counts, temperature):
        digest.update(np.ascontiguousarray(np.zeros(0) if part is None else part).tobytes())
    path = cache_dir() / f"calibration-{digest.hexdigest()[:32]}.json"
    known = _read(path)
    if known is not None:
        return known, path, True
    made = calibrate(estimator, theta, u, counts, hours=hours, temperature=temperature, progress=progress)
    _write(path, made)
    return made, path, False


def _text_of(calibration: Calibration) -> str:
    return json.dumps(asdict(calibration), default=lambda array: array.tolist())


def _write(path: Path, calibration: Calibration) -> None:
    text = _text_of(calibration)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(f".{os.getpid()}")
        part.write_text(f"{_digest(text)}\n{text}", encoding="utf-8")
        part.replace(path)  # another run may write this file
    except OSError:
        return


def _digest(text: str) -> str:
    return sha256(text.encode()).hexdigest()


def _read(path: Path) -> Calibration | None:
    try:
        digest, _, text = path.read_text(encoding="utf-8").partition("\n")
        if digest != _digest(text):
            return None  # the file is damaged, even if its numbers are valid
        return _calibration_in(text)
    except (OSError, ValueError, TypeError, KeyError):
        return None  # without a file of this version, the calibration is computed again


def _calibration_in(text: str) -> Calibration:
    """Return the calibration in a text of `_text_of`. Raises ValueError, TypeError or KeyError for another text."""
    raw: dict[str, Any] = json.loads(text)
    return Calibration(
        np.array(raw["theta"]),
        _scale(raw["scale"]),
        _tail(raw["tail"]),
        np.array(raw["noise"]),
        raw["hours"],
        raw["record_hours"],
        None if raw["work"] is None else _work(raw["work"]),
        None if raw["warmth"] is None else Warmth(raw["warmth"]["mean"], np.array(raw["warmth"]["rate"])),
    )


def save_baseline(monitor: Monitor) -> str:
    """Return the numbers that a monitor got from its reference, as text: nominal values, thresholds and input gain.

    A linear algebra rounds them by the kind of processor and by the number of threads. States of a monitor therefore
    travel together with its baseline.
    """
    gain = monitor.estimator.equation.input_gain
    return json.dumps({"calibration": _text_of(monitor.calibration), "input_gain": gain})


def _scale(raw: dict[str, Any]) -> Scale:
    return Scale(**{name: np.array(value) for name, value in raw.items()})


def _tail(raw: dict[str, Any]) -> Tail:
    parts = tuple((level, slope, rate) for level, slope, rate in raw["parts"])
    return Tail(**(raw | {"maxima": tuple(raw["maxima"]), "parts": parts}))


def _work(raw: dict[str, Any]) -> NormalWork:
    return NormalWork(raw["size"], np.array(raw["offset"]), _scale(raw["scale"]), np.array(raw["limit"]))


@dataclass(frozen=True)
class Setup:
    """A monitor at its start.

    `nominal` (p,) are the normal parameters. `calibration` is stored in the file `path`, and `cached` says whether the
    cache had it. `notes` are texts for the user.
    """

    monitor: Monitor
    nominal: Floats
    calibration: Calibration
    path: Path
    cached: bool
    notes: tuple[str, ...]

    @property
    def reported(self) -> Floats:
        """The nominal values (q,), with an estimated input gain at the end."""
        further = len(self.monitor.names) - len(self.monitor.estimator.names)
        return np.concatenate([self.nominal, [self.monitor.estimator.equation.input_gain] * further])

    @cached_property
    def baseline(self) -> str:
        """Nominal values, thresholds and input gain, as `save_baseline` returns them."""
        return save_baseline(self.monitor)

    def take_baseline(self, text: str) -> Setup:
        """Return the same monitor at its start with the baseline of an earlier run.

        Raises ValueError, TypeError, KeyError or UsageError for a text that no such monitor has saved.
        """
        raw = json.loads(text)
        calibration, known = _calibration_in(raw["calibration"]), self.monitor.known
        estimator = self.monitor.estimator
        if known is not None and known.find_gain:
            estimator = replace(estimator, model=replace(estimator.model, input_gain=float(raw["input_gain"])))  # type: ignore[type-var]
            known = replace(known, estimator=estimator)
        nominal = calibration.theta
        if isinstance(estimator, RIV):
            estimator = replace(estimator, initial=dict(zip(estimator.names, nominal.tolist(), strict=True)))
        monitor = Monitor(estimator, calibration, self.monitor.watch, known)
        return replace(self, monitor=monitor, nominal=nominal, calibration=calibration)

    def describe_start(self) -> dict[str, object]:
        """Return the settings of a monitored axis for `--json`."""
        return describe_monitor(self.monitor, self.reported) | {
            "hours": self.calibration.hours,
            "record_hours": self.calibration.record_hours,
            "calibration": str(self.path),
            "cached": self.cached,
            "notes": list(self.notes),
        }


def set_up(axis: Axis, folder: Path, record: Record | None, progress: Callable[[float], None] | None = None) -> Setup:
    """Return the monitor of AXIS.toml in `folder` for a record, or for a pipe if `record` is None.

    Without a reference, the record's own input calibrates the monitor, with the encoder as the only noise. Raises
    UsageError if both reference and record are missing, or if the nominal values are missing. Raises
    NotIdentifiableError if the reference cannot identify the nominal values.
    """
    config, notes = axis.monitor, list[str]()
    check_monitored(axis)
    normal = None if config.reference is None else make_even(read_record(folder / config.reference, axis))
    source = normal or record
    if source is None or (normal is None and config.nominal is None):
        raise UsageError(
            "[monitor] reference is missing: name a record of normal work, 10 minutes or more, "
            'for example reference = "normal.csv"' + ("" if record is None else ", or give the nominal values")
        )
    if record is not None and normal is not None and abs(record.dt / normal.dt - 1) > 1e-3:
        raise UsageError(
            f"the record has dt = {record.dt:g} s, the reference {normal.dt:g} s; take a reference with the same "
            "sample period"
        )
    on_line = kind_of(axis).prepare_axis(source, _configure_recursive(axis, source.dt))
    estimator = _estimator(_set_normal_gain(on_line, source), source, wraps=record is None)
    known = known_of(axis, estimator)
    nominal = _nominal(estimator, config.nominal, source, known)
    if isinstance(estimator, RIV):
        estimator = replace(estimator, initial=dict(zip(estimator.names, nominal.tolist(), strict=True)))
    if normal is None:
        notes.append("no reference record: thresholds hold for the encoder's noise alone; name one in [monitor]")
    counts = None if normal is None else source.counts
    temperature = None if normal is None else source.temperature
    calibration, path, cached = cached_calibration(estimator, nominal, source.u, counts, HOURS, progress, temperature)
    notes += calibration_notes(calibration, config.mtbf_hours)
    watch = Watch(config.mtbf_hours, config.tolerance)
    return Setup(Monitor(estimator, calibration, watch, known), nominal, calibration, path, cached, tuple(notes))


def set_up_record(
    axis: Axis, folder: Path, record: Record | None, progress: Callable[[float], None] | None = None
) -> Setup | EdgeSetup:
    """Return the monitor as `set_up`, or that of edges if the configuration, and the record if there is one, has
    their ages.
    """
    if takes_edges(axis) and (record is None or record.ages is not None):
        return set_up_edges(axis, folder, record)
    return set_up(axis, folder, record, progress)


def calibration_notes(calibration: Calibration, mtbf_hours: float) -> list[str]:
    """Return notes on the thresholds if normal work is noisier than its simulation."""
    hours, notes = calibration.record_hours, []
    if np.max(calibration.noise) > TUNING.setup_noisy or hours:
        notes.append(
            f"normal work is {np.max(calibration.noise):.2g} times as noisy as the encoder explains: "
            + ("the thresholds come from" if hours else "the scale is that of")
            + " the reference record itself"
        )
    doubt = calibration.tail.doubt(mtbf_hours)
    if doubt > math.log(TUNING.setup_sure):
        notes.append(
            f"from the {hours:.2g} h of the reference record the time between false alarms is known to a factor of "
            f"{math.exp(doubt):.2g} only. A factor of {TUNING.setup_sure:g} takes about "
            f"{hours * (doubt / math.log(TUNING.setup_sure)) ** 2:.2g} h: record more normal work, or "
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
        forgetting = max(0.5, 1 - dt / TUNING.default_memory)
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


def _set_normal_gain(axis: Axis, source: Record) -> Axis:
    """Return the axis with the input gain of normal work if the gain is estimated.

    The gain comes from [monitor] nominal or the reference. Raises UsageError if nominal has no input gain.
    """
    if not finds_gain(axis):
        return axis
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


def _nominal(
    estimator: RecursiveEstimator, given: dict[str, float] | None, source: Record, known: Known | None
) -> Floats:
    """Return the normal parameters (p,), as given or as identified from the reference."""
    front = like(IV, estimator, prefilter_zeros=None)
    names = front.names
    if given is None:
        fit = front.fit(source.u, source.counts)
        theta = np.asarray(fit.theta if known is None else known.combine(fit).theta[: len(names)])
        if source.temperature is None:
            return theta
        return find_warmth(front, theta, source.u, source.counts, source.temperature)[1]
    try:
        return initial_vector({name: value for name, value in given.items() if name in names or known is None}, names)
    except UsageError:
        raise UsageError(f"[monitor] nominal must name {list(names)}, got {list(given)}") from None

"""Validation by free runs over other records, for every kind of plant, from files and from Python."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from pmfid.config.axis import Axis
from pmfid.diagnostics.free_run import FreeRun
from pmfid.diagnostics.matter import is_small_doubt
from pmfid.errors import UsageError
from pmfid.findings import Finding, Judged, sort_findings, texts
from pmfid.pipeline.identify import check, kind_of
from pmfid.pipeline.kinds import Records, parameters_of
from pmfid.pipeline.known import set_stored_gain
from pmfid.pipeline.stored import Stored
from pmfid.presentation import Presentable, Summary, plain_dict, remarks_of
from pmfid.types import Floats

#: Multiple of the encoder's error below which a free run explains the counts.
VALIDATION_WITHIN = 1.5


@dataclass(frozen=True, eq=False, repr=False)
class Validation(Presentable, Judged):
    """Free runs of a result over one or more records.

    Attributes
    ----------
    kind, method : str
        Kind of the model, and method of its estimate.
    names, units : tuple of str
    theta : ndarray (p,)
        Parameters.
    unit : str
        Unit of the output, or an empty text if the output has no unit.
    runs : tuple of FreeRun
        One free run for each record, with errors over several horizons.
    findings : tuple of Finding
        Doubts about the model from each record, as in `identify`.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import Drive, Encoder, identify, quantize, validate
    >>> from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, simulate_drive
    >>> u = prbs(1500, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
    >>> counts = quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION)
    >>> settings = {"model": Drive(CART.input_gain), "dt": CART_DT, "encoder": Encoder(CART_RESOLUTION)}
    >>> validation = validate(identify(u[:1000], counts[:1000], cutoff=20.0, method="iv", **settings), u, counts)
    >>> validation.kind, validation.method, validation.findings
    ('drive', 'iv', ())
    """

    kind: str
    method: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    theta: Floats
    unit: str
    runs: tuple[FreeRun, ...]
    findings: tuple[Finding, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """The notes on the free runs and the findings as sentences."""
        own = (note for run in self.runs for note in (*run.notes, *_remarks(run)))
        return tuple(dict.fromkeys((*own, *texts(self.findings))))

    def to_dict(self) -> dict[str, object]:
        """Return the object that `--json` prints."""
        rows = zip(self.names, self.units, self.theta, strict=True)
        return plain_dict(
            {
                "model": self.kind,
                "method": self.method,
                "parameters": {name: {"value": value, "unit": unit} for name, unit, value in rows},
                "unit": self.unit,
                "records": [_as_json(run) for run in self.runs],
                "status": self.status,
                "notes": self.notes,
            }
        )

    def summary(self) -> Summary:
        header = ("record", "samples", "error", "fit [%]", "error at rest", "unit")
        return Summary(
            f"{self.method} against {len(self.runs)} record{'s' * (len(self.runs) != 1)}, simulated from the input",
            header,
            [(run.name, str(run.t.size), *_numbers(run), self.unit) for run in self.runs],
            [self._line(run) for run in self.runs],
            remarks_of(self.status, self.notes),
        )

    def _line(self, run: FreeRun) -> str:
        error, fit, still = _numbers(run)
        unit = f" {self.unit}" if self.unit else ""
        own = f"{run.name}: error {error}{unit}, fit {fit} %"
        return f"{own}; a model at rest has an error of {still}{unit}; {run.t.size} samples"

    def columns(self) -> dict[str, object]:
        """The columns of a table with one row for each record."""
        rows = [_as_json(run) for run in self.runs]
        return {key: [row[key] for row in rows] for key in _as_json(self.runs[0]) if key != "horizons"}


def _numbers(run: FreeRun) -> tuple[str, str, str]:
    """Return the root mean square error, the fit, and the error of an axis at standstill as text."""
    fit = "unknown" if run.fit is None else f"{run.fit:.4g}"
    return f"{run.rmse:.3g}", fit, f"{run.standstill:.3g}"


def _as_json(run: FreeRun) -> dict[str, object]:
    sizes = {"rmse": run.rmse, "largest": run.largest, "fit": run.fit, "relative_error": run.relative}
    others = {"encoder": run.encoder, "mean": run.mean, "standstill": run.standstill}
    head = {"record": run.name, "samples": int(run.t.size), "start_read": run.read}
    return {**head, **sizes, **others, "horizons": [asdict(one) for one in run.horizons]}


def _remarks(run: FreeRun) -> list[str]:
    remarks = []
    if run.encoder is not None and run.rmse <= VALIDATION_WITHIN * run.encoder:
        remarks.append(f"{run.name}: the free run explains every count; only the error of the encoder is left")
    if run.rmse >= min(run.mean, run.standstill):
        better = [f for f in run.horizons if f.rmse < 0.5 * f.standstill]
        over = f"; over {better[-1].seconds:g} s the free run predicts better" if better else ""
        remarks.append(
            f"{run.name}: the free run predicts no better than an axis that stands still or a constant{over}"
        )
    return remarks


def read_records(paths: Sequence[Path], axis: Axis) -> list[Records]:
    """Read the records at `paths` separately. Raises UsageError as `identify` does."""
    return [kind_of(axis).read([path], axis) for path in paths]


def validate_stored(stored: Stored, data: Sequence[Records], axis: Axis) -> Validation:
    """Return free runs with the parameters of a file over the records that `read_records` returns.

    Raises UsageError if the parameters do not belong to the model of `axis`, or if they allow no simulation.
    """
    kind, axis = kind_of(axis), set_stored_gain(axis, stored)
    theta = stored.theta(axis.model.kind, *parameters_of(axis.model.make()))
    for record in data:
        kind.check_known(stored, record, axis)
    return validate_parameters(stored.method, theta, data, axis)


def validate_parameters(method: str, theta: Floats, data: Sequence[Records], axis: Axis) -> Validation:
    """Return free runs over records with parameters theta (p,) of the model of `axis`, estimated by `method`.

    Raises UsageError as `validate_stored` does.
    """
    kind, (names, units) = kind_of(axis), parameters_of(axis.model.make())
    if not data:
        raise UsageError("the list of records is empty; give at least one record to validate on")
    if not np.all(np.isfinite(theta)):
        raise UsageError("a parameter is not finite: identify the record again")
    runs = tuple(run for record in data for run in kind.free_runs(record, axis, theta))
    every = (finding for record in data for finding in check(record, axis))
    findings = sort_findings(finding for finding in every if not is_small_doubt(finding))
    return Validation(axis.model.kind, method, names, units, theta, kind.unit_of_output(axis), runs, findings)

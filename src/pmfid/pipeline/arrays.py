"""The commands as Python functions that take arrays or objects and return results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Unpack, cast, overload

import numpy as np
from numpy.typing import ArrayLike

from pmfid.config.axis import Axis, AxisSections, read_axis
from pmfid.config.keys import EstimatorKeys, OutputKind
from pmfid.config.model import model_section
from pmfid.config.record import NO_ENCODER, EncoderConfig, RecordConfig
from pmfid.config.toml_file import validate_sections
from pmfid.encoder import Encoder
from pmfid.errors import UsageError
from pmfid.estimators.configuration import check_arrays, numbers
from pmfid.findings import Finding
from pmfid.io.tables import Frame, table_of
from pmfid.linear.experiment import Experiment
from pmfid.models.drive import Drive, EquationModel, Model
from pmfid.models.transfer_function import TransferFunction
from pmfid.pipeline.identify import check as checked
from pmfid.pipeline.identify import identify as run
from pmfid.pipeline.identify import kind_of
from pmfid.pipeline.kinds import Records, parameters_of
from pmfid.pipeline.result import ProcessResult, Result
from pmfid.pipeline.terms import TermSearch, search_drive
from pmfid.pipeline.validation import Validation, validate_parameters
from pmfid.records.joining import join_records
from pmfid.records.record import Record, record_of, travel_of
from pmfid.threads import use_one_thread

#: Names of input and output in messages.
INPUT, OUTPUT = "u", "y"
#: Records in memory or in files, which an AXIS.toml describes, and the objects that hold such a description.
Log = Frame | Path | str | Sequence[Path | str]
AxisSource = Axis | AxisSections | Path | str


@overload
def identify(u: Log, *, axis: AxisSource, **settings: Unpack[EstimatorKeys]) -> Result: ...
@overload
def identify(
    u: ArrayLike,
    y: ArrayLike,
    *,
    model: Drive | EquationModel | TransferFunction,
    dt: float,
    encoder: Encoder | None = None,
    **settings: Unpack[EstimatorKeys],
) -> Result: ...
@overload
def identify(
    u: Sequence[tuple[ArrayLike, ArrayLike]],
    *,
    model: Drive | EquationModel,
    dt: float,
    encoder: Encoder,
    **settings: Unpack[EstimatorKeys],
) -> Result: ...
@overload
def identify(
    u: Experiment | Sequence[Experiment],
    *,
    model: TransferFunction,
    encoder: Encoder | None = None,
    **settings: Unpack[EstimatorKeys],
) -> Result: ...


@use_one_thread
def identify(
    u: Log | ArrayLike | Experiment | Sequence[Experiment] | Sequence[tuple[ArrayLike, ArrayLike]],
    y: ArrayLike | None = None,
    *,
    model: Drive | EquationModel | TransferFunction | None = None,
    axis: AxisSource | None = None,
    dt: float | None = None,
    encoder: Encoder | None = None,
    **settings: Unpack[EstimatorKeys],
) -> Result:
    """Identify a machine or a transfer function, with the method, flags and notes of `pmfid identify`.

    Parameters
    ----------
    u : array_like (n,), Experiment, list of pairs (u, y), frame, dict of arrays, or path
        The input. A missing sample is NaN. Several records are [(u, y), (u, y)], or several `Experiment`. With `axis`,
        u is a table of pandas, Polars or Arrow, or one or several paths of files.
    y : array_like (n,), optional
        With an encoder, its counts as integers (see `quantize`). Without an encoder, the output of a transfer function.
    model : Drive, EquationModel or TransferFunction
        The plant. Not allowed with `axis`.
    axis : path, str, dict or Axis
        The configuration: the path of an AXIS.toml, or a dict with its sections. The configuration
        replaces all other arguments except `u`, and `settings` replace the keys of its [estimator].
    dt : float
        Sample period [s].
    encoder : Encoder
        The encoder, which every machine needs. With an encoder, the output of a transfer function is in counts.
    **settings
        Keys of [estimator] in AXIS.toml: method ("auto"), cutoff, order, forgetting, discretization, prefilter_zeros
        and precision. The cutoff is the pole of the filters [rad/s]. By default, the record of a machine determines the
        cutoff. A machine also has tolerance, given and prior. Examples of prior information are
        given={"mass": 1.25} and prior={"mass": (1.0, 0.1)}. Drive(input_gain="estimate") needs prior information in
        place of a known gain.

    Returns
    -------
    Result
        Parameters, standard deviations, status and findings.

    Raises
    ------
    UsageError
        The arguments contradict each other.
    NotIdentifiableError
        The data cannot identify every parameter. If a mistake in the log explains the failure, the message begins with
        that mistake.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import Drive, Encoder, identify, quantize
    >>> from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, simulate_drive
    >>> u = prbs(1500, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
    >>> counts = quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION)
    >>> settings = {"model": Drive(CART.input_gain), "dt": CART_DT, "encoder": Encoder(CART_RESOLUTION)}
    >>> result = identify(u, counts, cutoff=20.0, method="iv", **settings)
    >>> round(result["mass"], 2), CART.mass
    (1.07, 1.07)
    >>> result.status
    ()
    """
    if axis is not None:
        if any(value is not None for value in (y, model, dt, encoder)):
            raise UsageError("axis already describes y, model, dt and encoder: leave these arguments out")
        whole = read_axis(axis, settings)
        return run(_read(u, whole), whole)
    if model is None:
        raise UsageError("model and axis are both missing: give a Drive as model, or an AXIS.toml as axis")
    if isinstance(model, TransferFunction):
        experiments = _experiments(u, y, dt)
        whole = axis_of(model, encoder, experiments[0].period, {**settings})
        return run(_scale_outputs(experiments, whole), whole)
    pairs = _pairs(u) if y is None else [(cast(ArrayLike, u), y)]
    if not pairs or dt is None or encoder is None:
        raise UsageError(f"{model.kind} needs u, counts, dt and encoder: pass all four, u and counts as arrays (n,)")
    own = axis_of(model, encoder, dt, {**settings})
    place_matters = own.model.make().equation.place_matters
    return run(join_records([pair_record(*pair, own) for pair in pairs], place_matters), own)


def _read(record: object, axis: Axis) -> Records:
    """Read the records from a frame, or from one or several files, as an AXIS.toml describes them."""
    kind = kind_of(axis)
    if isinstance(record, str | Path):
        return kind.read([Path(record)], axis)
    if isinstance(record, list | tuple) and record and all(isinstance(one, str | Path) for one in record):
        return kind.read([Path(one) for one in record], axis)
    return kind.read_table(table_of(record), axis)


@overload
def check(u: Log, *, axis: AxisSource) -> tuple[Finding, ...]: ...
@overload
def check(
    u: ArrayLike, y: ArrayLike, *, model: Drive | EquationModel, dt: float, encoder: Encoder
) -> tuple[Finding, ...]: ...
def check(
    u: Log | ArrayLike,
    y: ArrayLike | None = None,
    *,
    model: Drive | EquationModel | None = None,
    axis: AxisSource | None = None,
    dt: float | None = None,
    encoder: Encoder | None = None,
) -> tuple[Finding, ...]:
    """List the mistakes in the log of a machine, most important first, as `pmfid check` does.

    Parameters
    ----------
    u, y, model, axis, dt, encoder
        The record and its configuration, as in `identify`.

    Returns
    -------
    tuple of Finding
        The findings, or an empty tuple if the log has no mistake.

    Raises
    ------
    UsageError
        The arguments contradict each other.

    Examples
    --------
    The input has the wrong sign:

    >>> import numpy as np
    >>> from pmfid import Drive, Encoder, check, quantize
    >>> from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, simulate_drive
    >>> u = prbs(1500, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
    >>> counts = quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION)
    >>> found = check(-u, counts, model=Drive(CART.input_gain), dt=CART_DT, encoder=Encoder(CART_RESOLUTION))
    >>> [finding.code for finding in found]
    ['reversed']
    """
    if axis is not None:
        if any(value is not None for value in (y, model, dt, encoder)):
            raise UsageError("axis already describes y, model, dt and encoder: leave these arguments out")
        own = read_axis(axis)
        return checked(_read(u, own), own)
    if model is None or y is None or dt is None or encoder is None:
        raise UsageError("check needs u, y, model, dt and encoder, or a frame and axis")
    own = axis_of(model, encoder, dt, {})
    return checked(pair_record(cast(ArrayLike, u), y, own), own)


def validate(
    result: Result,
    u: ArrayLike | Experiment | Sequence[Experiment],
    y: ArrayLike | None = None,
    *,
    dt: float | None = None,
    encoder: Encoder | None = None,
) -> Validation:
    """Predict other records with a result by free runs, as `pmfid validate` does.

    Parameters
    ----------
    result : Result
        A result of `identify`.
    u, y : array_like (n,)
        The other record, as in `identify`.
    dt : float, optional
        Sample period [s], by default that of the result.
    encoder : Encoder, optional
        By default, the encoder of the result.

    Returns
    -------
    Validation
        Errors of the prediction over several horizons, and doubts about the model.

    Raises
    ------
    UsageError
        The arguments contradict each other, or the model cannot be simulated.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import Drive, Encoder, identify, quantize, validate
    >>> from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, simulate_drive
    >>> def record(seed):
    ...     u = prbs(1500, clock=10, amplitude=4.0, rng=np.random.default_rng(seed))
    ...     return u, quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION)
    >>> settings = {"model": Drive(CART.input_gain), "dt": CART_DT, "encoder": Encoder(CART_RESOLUTION)}
    >>> result = identify(*record(1), cutoff=20.0, method="iv", **settings)
    >>> validation = validate(result, *record(2))
    >>> validation.status, len(validation.runs)
    ((), 1)
    """
    own, data = result.estimator, list[Records]()
    values = dict(zip(result.names, result.theta.tolist(), strict=True))
    if isinstance(own.model, TransferFunction):
        period = own.dt if dt is None and y is not None else dt
        experiments = _experiments(u, y, period)
        counted = isinstance(result, ProcessResult) and result.counted
        axis = axis_of(
            own.model, encoder or (own.encoder if counted else None), experiments[0].period, {"cutoff": own.cutoff}
        )
        data = [[part] for part in _scale_outputs(experiments, axis)]
    elif y is None:
        raise UsageError(f"validation of a {own.model.kind} needs u and counts (n,); give both")
    else:
        axis = axis_of(own.model, encoder or own.encoder, dt or own.dt, {"cutoff": own.cutoff})
        data = [pair_record(cast(ArrayLike, u), y, axis)]
    names = parameters_of(own.model)[0]
    return validate_parameters(own.method, np.array([values[name] for name in names]), data, axis)


@use_one_thread
def search_terms(
    u: ArrayLike,
    counts: ArrayLike,
    *,
    model: Drive,
    dt: float,
    encoder: Encoder,
    **settings: Unpack[EstimatorKeys],
) -> TermSearch:
    """Search terms of a drive that a model does not have, as `pmfid terms` does.

    Parameters
    ----------
    u, counts : array_like (n,)
        Input and counts.
    model : Drive
        The first model of the search.
    dt : float
        Sample period [s].
    encoder : Encoder
    **settings
        Keys of [estimator], as in `identify`.

    Returns
    -------
    TermSearch

    Raises
    ------
    UsageError
        The arguments contradict each other.
    NotIdentifiableError
        The record cannot identify the first model.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import Drive, Encoder, quantize, search_terms
    >>> from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, simulate_drive
    >>> u = prbs(500, clock=10, amplitude=4.0, rng=np.random.default_rng(1)) + 1.0
    >>> counts = quantize(simulate_drive(CART, u - 1.0, CART_DT).x, CART_RESOLUTION)
    >>> settings = {"model": Drive(CART.input_gain), "dt": CART_DT, "encoder": Encoder(CART_RESOLUTION)}
    >>> search_terms(u, counts, **settings).added
    {'offset': True}
    """
    axis = axis_of(model, encoder, dt, {**settings})
    return search_drive(pair_record(u, counts, axis), axis)


def _pairs(u: object) -> list[tuple[ArrayLike, ArrayLike]]:
    """Return the pairs of arrays of several machine records, or an empty list for any other object."""
    if isinstance(u, list | tuple) and u and all(isinstance(pair, tuple) and len(pair) == 2 for pair in u):
        return list(u)
    return []


def pair_record(u: ArrayLike, counts: ArrayLike, axis: Axis) -> Record:
    """Make a record from two arrays. A sample with NaN in either array is missing."""
    inputs, given = numbers("u", u), numbers("counts", counts)
    there = np.isfinite(given) if given.dtype.kind == "f" else np.ones(given.shape, bool)
    _, whole = check_arrays(inputs, np.where(there, given, 0))
    return record_of(
        {INPUT: inputs.astype(np.float64), OUTPUT: np.where(there, whole.astype(np.float64), np.nan)}, axis
    )


def axis_of(model: Model, encoder: Encoder | None, dt: float, estimator: dict[str, object]) -> Axis:
    """Return the configuration that AXIS.toml would contain for the given objects.

    Raises UsageError for settings that contradict each other.
    """
    kind: OutputKind = "counts" if encoder is not None else "position"
    sections = {
        "record": RecordConfig(input=INPUT, output=OUTPUT, output_kind=kind, dt=float(dt)),
        "encoder": _encoder(encoder, model),
        "model": model_section(model),
        "estimator": estimator,
    }
    return validate_sections(Axis, sections)


def _encoder(encoder: Encoder | None, model: Model) -> EncoderConfig:
    if encoder is None:
        return EncoderConfig(resolution=NO_ENCODER)
    if isinstance(model, TransferFunction):
        return EncoderConfig(resolution=encoder.resolution, bits=encoder.bits)
    return EncoderConfig(
        resolution=encoder.resolution,
        bits=encoder.bits,
        standstill_time=encoder.standstill_time,
        max_speed=encoder.max_speed,
        guard=encoder.guard,
    )


def _scale_outputs(experiments: Sequence[Experiment], axis: Axis) -> list[Experiment]:
    """Return the experiments with counts converted to travel. Without an encoder, nothing needs conversion."""
    if axis.record.output_kind != "counts":
        return list(experiments)
    for experiment in experiments:
        off = np.flatnonzero(np.isfinite(experiment.y) & (experiment.y != np.rint(experiment.y)))
        if off.size:
            raise UsageError(
                f"with an encoder, the output must be counts (whole numbers), got {experiment.y[off[0]]:.6g} in row "
                f"{off[0] + 1} of {experiment.name}; leave out encoder if the output has its unit, or pass quantize(y, "
                "resolution)"
            )
    return [replace(experiment, y=travel_of(experiment.y, axis)) for experiment in experiments]


def _experiments(u: object, y: ArrayLike | None, dt: float | None) -> list[Experiment]:
    given = [u] if isinstance(u, Experiment) else u
    if y is None and isinstance(given, Sequence) and given and all(isinstance(part, Experiment) for part in given):
        return list(given)
    if y is None or dt is None:
        raise UsageError("a transfer function needs u and y (n,) with dt, or Experiments; give one of the two")
    return [Experiment(np.asarray(u, np.float64), np.asarray(y, np.float64), dt=dt)]

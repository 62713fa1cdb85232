"""The search for the terms of a drive's equation."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from pmfid.config.axis import Axis, check_sampling
from pmfid.diagnostics.balance import Balance, make_balance
from pmfid.diagnostics.matter import weigh_findings
from pmfid.diagnostics.term_fits import Bench, choose_cutoff, shortest_part
from pmfid.diagnostics.term_trials import Trial
from pmfid.diagnostics.terms import FittedCandidate, Terms, changed_fields, search
from pmfid.diagnostics.verdict import verdict
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.adequacy import PeriodicForce, setting
from pmfid.estimators.batch import check_identifiable
from pmfid.estimators.configuration import change_arguments, like
from pmfid.estimators.ls import LS
from pmfid.estimators.output_error import IntervalML
from pmfid.estimators.results import Fit
from pmfid.estimators.tuning import TUNING as ESTIMATOR_TUNING
from pmfid.findings import Finding, codes, texts
from pmfid.models.drive import Drive
from pmfid.models.equation import ESTIMATE
from pmfid.pipeline.drives import Drives, match_kind
from pmfid.pipeline.identify import explain_error, identify
from pmfid.pipeline.kinds import Progress
from pmfid.pipeline.known import check_numbers_known
from pmfid.pipeline.result import DriveResult
from pmfid.pipeline.tuning import TUNING
from pmfid.presentation import Presentable, Summary, plain_dict, remarks_of
from pmfid.records.joining import unbroken
from pmfid.records.outliers import repair_as_configured
from pmfid.records.record import Record
from pmfid.units import OUTPUTS, Quantity, column_unit


@dataclass(frozen=True, eq=False)
class NestedModel:
    """One of the compared models.

    `added` holds the keys of [model] that differ from the first model, with their values. `fit` is None without
    standard errors. `error` is the error of free runs over samples outside the fit [unit of y], or infinity without
    such runs. `unexplained` holds the relative parts of friction and load that the model leaves, for the whole motion
    and for its slow part. An unknown part is NaN.
    """

    added: dict[str, object]
    trial: Trial
    fit: Fit | None
    error: float
    balance: Balance | None
    unexplained: tuple[float, float]

    @property
    def label(self) -> str:
        return f"with {format_terms(self.added)}" if self.added else "to begin with"


def compare_nested(bench: Bench, first: Drive, pairs: Sequence[tuple[Trial, float]]) -> tuple[NestedModel, ...]:
    balances = [_balance(bench, trial) for trial, _ in pairs]
    shares = [_measure_unexplained(balance, balances[-1], pairs[-1][0]) for balance in balances]
    return tuple(
        NestedModel(changed_fields(first, trial.model), trial, fit_trial(trial), error, balance, share)
        for (trial, error), balance, share in zip(pairs, balances, shares, strict=True)
    )


def fit_trial(trial: Trial) -> Fit | None:
    """Return the fit of a trial with standard errors, or None if the trial has no such fit."""
    try:
        return trial.method.fit_of(trial.best)
    except NotIdentifiableError:
        return None


def _balance(bench: Bench, trial: Trial) -> Balance | None:
    try:
        return make_balance(trial.method, bench.u, bench.counts, trial.theta)
    except NotIdentifiableError:
        return None


def _measure_unexplained(balance: Balance | None, last: Balance | None, chosen: Trial) -> tuple[float, float]:
    """Return the parts of the resistance to the motion that a model leaves, for the whole motion and its slow part.

    The parts refer to the motion of the chosen model. The unexplained resistance combines the difference to the chosen
    model with the significant rest in the force balance of the chosen model.
    """
    if balance is None or last is None or last.friction is None:
        return math.nan, math.nan
    left = last.friction.left
    beyond = float(np.mean(np.maximum(left.mean**2 - left.error**2, 0.0)))
    x, v = chosen.difference.motion(chosen.best.q)
    place, velocity = (x - chosen.difference.slack)[v != 0], v[v != 0]
    whole = last.resistance(place, velocity)
    apart = balance.resistance(place, velocity) - whole
    slow = np.abs(velocity) <= np.quantile(np.abs(velocity), TUNING.terms_slow)
    every, low = (
        np.sqrt((np.mean(apart[part] ** 2) + beyond) / np.mean(whole[part] ** 2)) for part in (v[v != 0] != 0, slow)
    )
    return float(every), float(low)


def format_terms(added: Mapping[str, object]) -> str:
    """Return the terms of [model] as words."""
    named = {key: value for key, value in added.items() if value is not False}
    return ", ".join(
        f"{value} {key}" if isinstance(value, str) and value != ESTIMATE else key for key, value in named.items()
    )


def finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


@dataclass(frozen=True, eq=False)
class WeighedTerm:
    """A term that was fitted.

    `setting` holds the lines of the term in [model]. `values` holds the name, value, standard error (NaN if unknown)
    and unit of each parameter of the term. `kept` says whether the term is in the chosen model. `with_it` and `without`
    are errors of free runs over samples outside the fits [unit of y]. Without free runs, `with_it` and `without` are
    not finite. `verdict` is the decision on the term.
    """

    setting: str
    values: tuple[tuple[str, float, float, str], ...]
    kept: bool
    with_it: float
    without: float
    verdict: str

    def to_json(self) -> dict[str, object]:
        values = {name: {"value": value, "std": finite(bar), "unit": unit} for name, value, bar, unit in self.values}
        held_out = {"held_out_with": finite(self.with_it), "held_out_without": finite(self.without)}
        return {"set": self.setting, "values": values, "kept": self.kept, **held_out, "verdict": self.verdict}


def write_line(key: str, value: object, unit: str) -> str:
    """Return a line of [model] in which a period has the given unit, and a number with a unit has its own."""
    if isinstance(value, Quantity):
        return setting(key, f"{float(value) / value.unit.factor:.9g} {value.unit.name}")
    periodic = key in PERIODS and isinstance(value, float) and unit
    return setting(key, f"{value:.9g} {unit}" if periodic else value)


def weighed_terms(found: Terms, fit: Fit | None, unit: str = "") -> Iterator[WeighedTerm]:
    """Yield each term of the chosen model with the standard errors of `fit`, and then the fitted terms that were
    refused. `unit` is the unit of periods.
    """
    first, last = found.trials[0].model, dict[str, FittedCandidate]()
    for step in found.without:
        yield _weigh_step(step, first, found.chosen, fit, unit)
    for step in (step for tried in found.steps for step in tried):
        if step.trial is not None and not step.kept and not step.candidate.change.items() <= found.added.items():
            last[_setting(step, unit)] = step
    for step in last.values():
        if step.trial is not None:
            yield _weigh_step(step, first, step.trial, fit_trial(step.trial), unit)


def _setting(step: FittedCandidate, unit: str) -> str:
    return ", ".join(write_line(*pair, unit) for pair in step.candidate.change.items())


def _weigh_step(step: FittedCandidate, first: Drive, trial: Trial, fit: Fit | None, unit: str) -> WeighedTerm:
    """Return the weighed term of a step. `first` is the first model of the search, and `trial` is a fit with the
    term.
    """
    equation = trial.model.equation
    rest = change_arguments(trial.model, {key: getattr(first, key) for key in step.candidate.change}).equation
    names, units = (*equation.names, *dict(equation.further)), (*equation.units, *dict(equation.further).values())
    std = np.full(len(names), np.nan) if fit is None else fit.theta_std
    rows = zip(names, trial.theta.tolist(), std.tolist(), units, strict=True)
    values = tuple(row for row in rows if row[0] not in {*rest.names, *dict(rest.further)})
    return WeighedTerm(_setting(step, unit), values, step.kept, step.error, step.without, step.verdict)


#: Flag that `pmfid identify` does not have.
AMBIGUOUS = "ambiguous_term"
#: Flags of `pmfid identify` whose advice on [model] the search replaces.
UNMODELLED, LATE = "unmodelled", "dead_time"
UNEXPLAINED = "no term of the list explains the rest on data outside its fit"
#: Keys of [model] with a period of the position.
PERIODS = ("cogging", "friction_period", "gravity")
#: Findings on the chosen model, and whether they matter.
Said = tuple[tuple[Finding, ...], bool]


@dataclass(frozen=True, eq=False)
class Hidden:
    """A term that is not in the chosen model, and the least size that this record would show."""

    says: str
    size: float
    unit: str


@dataclass(frozen=True, eq=False, repr=False)
class TermSearch(Presentable):
    """The result of a search for terms.

    Attributes
    ----------
    name : str
        Name of the record.
    samples : int
    resolution : float
        Resolution of the encoder [unit of y].
    models : tuple of NestedModel
        The models from the first to the chosen one.
    weighed : tuple of WeighedTerm
        All fitted terms with their sizes.
    hidden : tuple of Hidden
        Terms that are not in the chosen model.
    status, notes : tuple of str
        The codes and sentences of the findings, as in `Result`.
    unit : str
        Unit of the periods in `lines`, if AXIS.toml needs one because the column of the output is not in SI.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import Drive, Encoder, quantize, search_terms
    >>> from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, simulate_drive
    >>> u = prbs(600, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
    >>> counts = quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION)
    >>> settings = {"model": Drive(CART.input_gain), "dt": CART_DT, "encoder": Encoder(CART_RESOLUTION)}
    >>> search_terms(u, counts, cutoff=20.0, scan=False, **settings).sentence.partition(",")[0]
    'The search adds no term to [model]'
    """

    name: str
    samples: int
    resolution: float
    terms: Terms
    models: tuple[NestedModel, ...]
    weighed: tuple[WeighedTerm, ...]
    hidden: tuple[Hidden, ...]
    status: tuple[str, ...]
    notes: tuple[str, ...]
    unit: str = ""

    @property
    def chosen(self) -> NestedModel:
        return self.models[-1]

    @property
    def model(self) -> Drive:
        """The chosen model."""
        return self.chosen.trial.model

    @property
    def added(self) -> dict[str, object]:
        """The keys of [model] that the search sets, with their values."""
        return self.terms.added

    @cached_property
    def lines(self) -> tuple[str, ...]:
        """The lines of [model] for AXIS.toml."""
        values = [(field.name, getattr(self.model, field.name), field.default) for field in fields(Drive)]
        return (
            "[model]",
            'kind = "drive"',
            *(write_line(key, value, self.unit) for key, value, usual in values if value != usual),
        )

    @property
    def sentence(self) -> str:
        """The summary of the search in one sentence."""
        first = f"{_share(self.models[0])} of friction and load unexplained"
        if not self.added:
            return f"The search adds no term to [model], whose terms leave {first}."
        return f"The terms of [model] leave {first}; adding {format_terms(self.added)} leaves {_share(self.chosen)}."

    def to_json(self) -> dict[str, object]:
        """Return the object that `--json` prints."""
        return {
            "record": self.name,
            "samples": self.samples,
            "model": list(self.lines),
            "added": self.added,
            "sentence": self.sentence,
            "models": [_model_json(model, self.resolution) for model in self.models],
            "terms": [one.to_json() for one in self.weighed],
            "steps": [[_step_json(step) for step in tried] for tried in self.terms.steps],
            "hidden": [{"term": one.says, "seen_from": one.size, "unit": one.unit} for one in self.hidden],
            "status": list(self.status),
            "notes": list(self.notes),
        }

    def summary(self) -> Summary:
        header = ("model", "parameters", "log-likelihood", "unexplained")
        rows = [
            (model.label, str(model.trial.theta.size), f"{model.trial.log_likelihood:.6g}", _share(model))
            for model in self.models
        ]
        lines = [f"{label}: log-likelihood {likelihood}" for label, _, likelihood, _ in rows]
        title = f"{self.name}, {self.samples} samples. {self.sentence}"
        return Summary(title, header, rows, lines, remarks_of(self.status, self.notes))

    def columns(self) -> dict[str, object]:
        """The columns of a table with one row for each parameter of each model."""
        rows = [
            (model.label, name, *estimate.values())
            for model in self.models
            for name, estimate in _parameters_json(model).items()
        ]
        return dict(zip(("model", "parameter", "value", "std"), map(list, zip(*rows, strict=True)), strict=True))

    def to_dict(self) -> dict[str, object]:
        """Return the object that `--json` prints, as plain values."""
        return plain_dict(self.to_json())


def _share(model: NestedModel) -> str:
    whole, slow = model.unexplained
    known = f"{100 * whole:.2g} % ({100 * slow:.2g} % at low speed)"
    return known if math.isfinite(whole) else "an unknown part"


def _model_json(model: NestedModel, resolution: float) -> dict[str, object]:
    return {
        "added": model.added,
        "log_likelihood": model.trial.log_likelihood,
        "held_out": finite(model.error),
        "held_out_counts": finite(model.error / resolution),
        "unexplained": finite(model.unexplained[0]),
        "unexplained_slow": finite(model.unexplained[1]),
        "parameters": _parameters_json(model),
    }


def _parameters_json(model: NestedModel) -> dict[str, dict[str, float | None]]:
    equation = model.trial.model.equation
    names = [*equation.names, *(name for name, _ in equation.further)]
    std = [None] * len(names) if model.fit is None else model.fit.theta_std.tolist()
    rows = zip(names, model.trial.theta.tolist(), std, strict=True)
    return {name: {"value": value, "std": error} for name, value, error in rows}


def _step_json(step: FittedCandidate) -> dict[str, object]:
    return {
        "set": dict(step.candidate.change),
        "term": step.candidate.says,
        "score": step.candidate.z,
        "gain": step.gain,
        "needed": finite(step.needed),
        "held_out": finite(step.error),
        "verdict": step.verdict,
    }


def search_drive(
    data: Record,
    axis: Axis,
    places: Sequence[PeriodicForce] = (),
    scan: bool = True,
    other: Record | None = None,
    done: Progress | None = None,
) -> TermSearch:
    """Search the terms of a drive that a record asks for and [model] does not have.

    `places` are forces that are periodic in the position. If `scan`, the search looks for the pitch of a cogging force.
    `other` is a second record of the same machine, which the models predict instead of parts of the first record.
    Raises UsageError if the plant is not a drive. Raises NotIdentifiableError if the record is too short or cannot
    identify the first model.
    """
    data, other = unbroken(data), None if other is None else unbroken(other)
    axis = match_kind(data, axis)
    model = axis.model.make()
    if not isinstance(model, Drive):
        raise UsageError(
            f'a search for terms needs kind = "drive", got "{axis.model.kind}"; set kind = "drive", or '
            '"transfer_function" to search for poles and zeros'
        )
    check_numbers_known(axis, "pmfid terms")
    axis = _fast_enough(data, axis)
    Drives().check(data, axis)
    check_sampling(axis, data.dt)
    known = repair_as_configured(data, axis)
    method = _method(model, data, axis)
    _check(method, known.record)
    second = repair_as_configured(other, axis).record if other is not None else None
    pair = None if second is None else (second.u, second.counts)
    bench = Bench(method, known.record.u, known.record.counts, pair)
    try:
        found = search(bench, model, places, scan, done)
    except NotIdentifiableError as error:
        raise explain_error(error, Drives().check_record(data, axis)) from None
    notes = tuple(filter(None, (*data.notes, known.sentence)))
    own = None if found.added else _judge_initial_model(data, axis)
    in_units = axis.record.output_unit or column_unit(axis.record.output, OUTPUTS)
    unit = model.equation.motion.travel if in_units else ""
    return _assemble_search(data, bench, found, notes, known.status, axis.estimator.tolerance, own, unit)


def _judge_initial_model(data: Record, axis: Axis) -> Said | None:
    """Return the verdict of `pmfid identify` on the first model if the search leaves it unchanged."""
    with suppress(NotIdentifiableError):
        result = identify(data, axis)
        if isinstance(result, DriveResult):
            doubts = tuple(finding for finding in result.findings if finding.severity != "note")
            return doubts, result.matter.beyond
    return None


def round_up(number: float) -> float:
    """Return the number after rounding up to three digits."""
    digit = 10.0 ** (math.floor(math.log10(number)) - 2)
    return math.ceil(number / digit) * digit


def _fast_enough(data: Record, axis: Axis) -> Axis:
    """Return the configuration with a cutoff.

    A cutoff that the function chooses is high enough for the prediction of a part of the record.
    """
    found, least = (
        Drives().prepare_axis(data, axis),
        choose_cutoff(data.u.size // ESTIMATOR_TUNING.adequacy_parts, data.dt),
    )
    if axis.estimator.cutoff is not None or least is None or found.estimator.pole >= least:
        return found
    return found.model_copy(update={"estimator": found.estimator.model_copy(update={"cutoff": least})})


def _method(model: Drive, data: Record, axis: Axis) -> IntervalML:
    return IntervalML(
        model, axis.encoder.make_encoder(data.resolution), data.dt, axis.estimator.pole, order=axis.estimator.order
    )


def _check(method: IntervalML, record: Record) -> None:
    """Raise NotIdentifiableError if the record is too short or too poor for a search."""
    n, dt = record.u.size, record.dt
    needed = ESTIMATOR_TUNING.adequacy_parts * shortest_part(method)
    if n < needed:
        cutoff = choose_cutoff(n // ESTIMATOR_TUNING.adequacy_parts, dt)
        shorter = f", or use a cutoff of at least {round_up(cutoff):g} rad/s" if cutoff else ""
        raise NotIdentifiableError(
            f"{n} samples are too few to compare terms on parts of the record: record at least {needed} "
            f"({needed * dt:.3g} s){shorter}"
        )
    seen = like(LS, method, model=method.model.simple)
    check_identifiable(seen.columns(record.u, record.counts), seen.names, seen.least_part)


def _assemble_search(
    data: Record,
    bench: Bench,
    found: Terms,
    record_notes: tuple[str, ...],
    status: tuple[str, ...],
    tolerance: float,
    own_said: Said | None,
    unit: str,
) -> TermSearch:
    pairs = zip(found.trials, found.errors, strict=True)
    models = compare_nested(bench, found.trials[0].model, list(pairs))
    judged, beyond = own_said or _judge_chosen_model(bench, models[-1], tolerance)
    unresolved = beyond and (not found.adequacy.adequate or bool(found.refused))
    own = [AMBIGUOUS] * bool(found.either) + [UNMODELLED] * unresolved
    notes = tuple(dict.fromkeys((*record_notes, *_sentences(found), *texts(judged))))
    names = tuple(dict.fromkeys((*status, *own, *codes(judged))))
    hidden = tuple(_list_hidden(found, found.trials[0].model.equation.motion.force))
    terms = tuple(weighed_terms(found, models[-1].fit, unit))
    return TermSearch(data.name, int(data.u.size), data.resolution, found, models, terms, hidden, names, notes, unit)


def _judge_chosen_model(bench: Bench, chosen: NestedModel, tolerance: float) -> Said:
    """Judge the chosen model, as `pmfid identify` judges an estimate."""
    trial = chosen.trial
    if chosen.fit is None:
        sentence = "this record gives no error bars for the chosen model"
        return (Finding("uncertain", sentence, "excite the axis more"),), True
    record = Record(bench.u, bench.counts, trial.method.dt, trial.method.encoder.resolution, (), "")
    said = verdict(trial.method, record.u, record.counts, chosen.fit.theta, chosen.fit.theta_std, tolerance)
    # Findings omit advice to set a term of [model], because the search has already fitted the terms.
    own = [
        replace(one, sentence=UNEXPLAINED, remedy="") if one.code == UNMODELLED else one
        for one in said.judged
        if one.code != LATE
    ]
    return weigh_findings(own, said.matter), said.matter.beyond


def _sentences(found: Terms) -> Iterator[str]:
    for kept, other in found.either:
        own, its = (" and ".join(setting(*pair) for pair in one.candidate.change.items()) for one in (kept, other))
        yield (
            f"either {own} or {its} fits, and this record does not show which; record a motion at other speeds and "
            "strokes"
        )
    for step in found.refused:
        own = " and ".join(setting(*pair) for pair in step.candidate.change.items())
        yield f"{own} was refused in spite of its score: {step.verdict}"
    if not found.adequacy.adequate:
        yield UNEXPLAINED


def _list_hidden(found: Terms, force: str) -> Iterator[Hidden]:
    """Yield the terms that the chosen model does not have.

    Of several forms of a term, the function yields the form that needs the largest size.
    """
    adequacy, sizes = found.adequacy, dict[str, tuple[float, str]]()
    for candidate, std in zip(adequacy.forces, adequacy.size_std, strict=True):
        if candidate.changes and candidate.name != "cogging":
            unit = "s" if candidate.name == "dead_time" else force
            sizes[candidate.says] = (
                max(ESTIMATOR_TUNING.adequacy_missed * float(std), sizes.get(candidate.says, (0.0, ""))[0]),
                unit,
            )
    yield from (Hidden(says, size, unit) for says, (size, unit) in sizes.items())


def list_periodic_forces(
    turn: float | None, pitch: Sequence[float], friction_period: float | None
) -> tuple[PeriodicForce, ...]:
    """Return forces that are periodic in the position, with the user's periods.

    Raises UsageError for a period that is not positive.
    """
    given = [("gravity", turn), *(("cogging", value) for value in pitch), ("friction_period", friction_period)]
    known = [(key, value) for key, value in given if value is not None]
    for key, value in known:
        if not 0 < value < math.inf:
            raise UsageError(f"the period of {key} must be a length above 0 in the unit of y, got {value:g}")
    return tuple(PeriodicForce(key, float(value)) for key, value in known)

"""Which terms a drive has: from a record and a configuration to a search and what to say of it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import cached_property

from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.adequacy import MISSED, PARTS, weigh
from pmfid.estimators.candidate_forces import PeriodicForce, setting
from pmfid.estimators.configuration import like
from pmfid.estimators.identifiable import check_identifiable
from pmfid.estimators.interval import IntervalML
from pmfid.estimators.ls import LS
from pmfid.findings import Finding, codes, texts
from pmfid.judge.matter import weigh_findings
from pmfid.judge.said import verdict
from pmfid.judge.term_fits import Bench, choose_cutoff, shortest_part
from pmfid.judge.term_trials import known_shapes
from pmfid.judge.terms import FittedCandidate, Terms, search
from pmfid.models.drive import Drive
from pmfid.presentation import Presentable, Summary, plain_dict, remarks_of
from pmfid.session.config import Axis, check_sampling
from pmfid.session.drives import Drives, all_known, match_kind
from pmfid.session.gaps.longest import unbroken
from pmfid.session.identify import explain_error, identify
from pmfid.session.kinds import Progress
from pmfid.session.known import check_numbers_known
from pmfid.session.nested import NestedModel, compare_nested, finite, format_terms
from pmfid.session.outliers import repair_as_configured
from pmfid.session.records import Record
from pmfid.session.result import DriveResult
from pmfid.session.weighed import WeighedTerm, weighed_terms

#: What the flags of `pmfid identify` do not say.
AMBIGUOUS, UNRESOLVED = "ambiguous_term", "unresolved"
#: Flags of `pmfid identify` whose advice on [model] the search replaces.
UNMODELLED, LATE = "unmodelled", "dead_time"
UNEXPLAINED = "something is left that no term of the list explains on data that it was not fitted to"
#: What is found of the chosen model, and whether it matters.
Said = tuple[tuple[Finding, ...], bool]


@dataclass(frozen=True, eq=False)
class Hidden:
    """A term that the chosen model has not, and the size from which on this record would show it."""

    says: str
    size: float
    unit: str


@dataclass(frozen=True, eq=False, repr=False)
class TermSearch(Presentable):
    """What a search has found. name, samples, resolution [unit of y]: of the record; models: from that to begin with to
    the chosen one; weighed: every term that was fitted, with its size; hidden: terms that are not in it; status, notes:
    as of a result."""

    name: str
    samples: int
    resolution: float
    terms: Terms
    models: tuple[NestedModel, ...]
    weighed: tuple[WeighedTerm, ...]
    hidden: tuple[Hidden, ...]
    status: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def chosen(self) -> NestedModel:
        return self.models[-1]

    @property
    def model(self) -> Drive:
        """The chosen model."""
        return self.chosen.trial.model

    @property
    def added(self) -> dict[str, object]:
        """The keys of [model] that the search sets, and their values."""
        return self.terms.added

    @cached_property
    def lines(self) -> tuple[str, ...]:
        """[model] for AXIS.toml."""
        values = [(field.name, getattr(self.model, field.name), field.default) for field in fields(Drive)]
        return ("[model]", 'kind = "drive"', *(setting(key, value) for key, value, usual in values if value != usual))

    @property
    def sentence(self) -> str:
        """What a person needs."""
        first = f"{_share(self.models[0])} of friction and load unexplained"
        if not self.added:
            return f"No term beyond those of [model] is found; they leave {first}."
        return f"The terms to begin with leave {first}; with {format_terms(self.added)} {_share(self.chosen)}."

    def to_json(self) -> dict[str, object]:
        """The object that `--json` prints."""
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
        """A row for each parameter of each of the models."""
        rows = [
            (model.label, name, *estimate.values())
            for model in self.models
            for name, estimate in _parameters_json(model).items()
        ]
        return dict(zip(("model", "parameter", "value", "std"), map(list, zip(*rows, strict=True)), strict=True))

    def to_dict(self) -> dict[str, object]:
        """What `--json` prints."""
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
    """The terms of a drive that a record asks for, beyond those of [model].

    places: forces periodic in the position; scan: look for the pitch of a cogging force; other: a second record of the
    same machine, which the models are to predict in place of parts of the first. Raises UsageError if the plant is no
    drive and NotIdentifiableError if the record is too short, or cannot identify the initial model.
    """
    data, other = unbroken(data), None if other is None else unbroken(other)
    axis = match_kind(data, axis)
    model = axis.model.make()
    if not isinstance(model, Drive):
        raise UsageError(
            f'the terms of a drive are searched; kind = "{axis.model.kind}" has none: set kind = "drive", or use pmfid '
            "order for the structure of a transfer function"
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
    return _assemble_search(data, bench, found, notes, known.status, axis.estimator.tolerance, own)


def _judge_initial_model(data: Record, axis: Axis) -> Said | None:
    """The verdict of `pmfid identify` on the initial model, which the search leaves unchanged."""
    with suppress(NotIdentifiableError):
        result = identify(data, axis)
        if isinstance(result, DriveResult):
            doubts = tuple(finding for finding in result.findings if finding.severity != "note")
            return doubts, result.matter.beyond
    return None


def round_up(number: float) -> float:
    """To three digits, never down."""
    digit = 10.0 ** (math.floor(math.log10(number)) - 2)
    return math.ceil(number / digit) * digit


def _fast_enough(data: Record, axis: Axis) -> Axis:
    """With a cutoff: if none is given, one after whose filters a part of the record can be predicted."""
    found, least = Drives().prepare_axis(data, axis), choose_cutoff(data.u.size // PARTS, data.dt)
    if axis.estimator.cutoff is not None or least is None or found.estimator.pole >= least:
        return found
    return found.model_copy(update={"estimator": found.estimator.model_copy(update={"cutoff": least})})


def _method(model: Drive, data: Record, axis: Axis) -> IntervalML:
    return IntervalML(
        model, axis.encoder.make_encoder(data.resolution), data.dt, axis.estimator.pole, order=axis.estimator.order
    )


def _check(method: IntervalML, record: Record) -> None:
    """Raises NotIdentifiableError for a record too short or too poor for a search."""
    n, dt = record.u.size, record.dt
    needed = PARTS * shortest_part(method)
    if n < needed:
        cutoff = choose_cutoff(n // PARTS, dt)
        shorter = f", or use a cutoff of at least {round_up(cutoff):g} rad/s" if cutoff else ""
        raise NotIdentifiableError(
            f"{n} samples are too few to tell terms apart on parts of them: record at least {needed} "
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
) -> TermSearch:
    pairs = zip(found.trials, found.errors, strict=True)
    models = compare_nested(bench, found.trials[0].model, list(pairs))
    judged, beyond = own_said or _judge_chosen_model(bench, models[-1], tolerance)
    unresolved = beyond and (not found.adequacy.adequate or bool(found.refused))
    own = [AMBIGUOUS] * bool(found.either) + [UNRESOLVED] * unresolved
    notes = tuple(dict.fromkeys((*record_notes, *_sentences(found), *texts(judged))))
    names = tuple(dict.fromkeys((*status, *own, *codes(judged))))
    hidden = tuple(_list_hidden(found, found.trials[0].model.equation.motion.force))
    terms = tuple(weighed_terms(found, models[-1].fit))
    return TermSearch(data.name, int(data.u.size), data.resolution, found, models, terms, hidden, names, notes)


def _judge_chosen_model(bench: Bench, chosen: NestedModel, tolerance: float) -> Said:
    """As on an estimate."""
    trial = chosen.trial
    if chosen.fit is None:
        return (Finding("uncertain", "the chosen model has no error bars on this record", "excite it more"),), True
    record = Record(bench.u, bench.counts, trial.method.dt, trial.method.encoder.resolution, (), "")
    asked = all_known(trial.method, record, chosen.fit.theta, chosen.fit.theta_std)
    said = verdict(*asked, weigh(known_shapes(trial.best)), tolerance)
    # what to set in [model] the search itself has fitted, and kept or refused
    own = [
        replace(one, sentence=UNEXPLAINED) if one.code == UNMODELLED else one for one in said.judged if one.code != LATE
    ]
    return weigh_findings(own, said.matter), said.matter.beyond


def _sentences(found: Terms) -> Iterator[str]:
    for kept, other in found.either:
        own, its = (" and ".join(setting(*pair) for pair in one.candidate.change.items()) for one in (kept, other))
        yield f"either {own} or {its}: this record does not tell which; a motion at other speeds and strokes would"
    for step in found.refused:
        own = " and ".join(setting(*pair) for pair in step.candidate.change.items())
        yield f"not {own}, though the score asks for it: {step.verdict}"
    if not found.adequacy.adequate:
        yield UNEXPLAINED


def _list_hidden(found: Terms, force: str) -> Iterator[Hidden]:
    """Terms that the chosen model does not have; of several forms of a term the one that shows last."""
    adequacy, sizes = found.adequacy, dict[str, tuple[float, str]]()
    for candidate, std in zip(adequacy.forces, adequacy.size_std, strict=True):
        if candidate.changes and candidate.name != "cogging":
            unit = "s" if candidate.name == "dead_time" else force
            sizes[candidate.says] = (max(MISSED * float(std), sizes.get(candidate.says, (0.0, ""))[0]), unit)
    yield from (Hidden(says, size, unit) for says, (size, unit) in sizes.items())


def list_periodic_forces(
    turn: float | None, pitch: Sequence[float], friction_period: float | None
) -> tuple[PeriodicForce, ...]:
    """Forces periodic in the position, from the user's periods. Raises UsageError for a period that is not positive."""
    given = [("gravity", turn), *(("cogging", value) for value in pitch), ("friction_period", friction_period)]
    known = [(key, value) for key, value in given if value is not None]
    for key, value in known:
        if not 0 < value < math.inf:
            raise UsageError(f"the period of {key} must be a length above 0 in the unit of y, got {value:g}")
    return tuple(PeriodicForce(key, float(value)) for key, value in known)

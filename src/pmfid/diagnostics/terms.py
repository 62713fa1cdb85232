"""Search for the terms of a drive, one term at a time.

In each step, the score tests of the counts at the best fit propose candidates (`estimators/adequacy.py`). The score
tests need no further fit. Then the search fits the candidates. The search keeps a term if its likelihood ratio is
beyond chance and if it explains parts of the record outside the fit. The limit of chance depends on the number of tried
terms and on the scatter of the scores (Rao 1948; Bonferroni). Finally, the search removes a term if the other terms
make it superfluous.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np

from pmfid.diagnostics.term_fits import Bench
from pmfid.diagnostics.term_trials import Trial, inflation, pitches
from pmfid.diagnostics.tuning import TUNING
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.adequacy import DIRECTIONAL, Adequacy, Change, PeriodicForce, setting
from pmfid.estimators.configuration import change_arguments
from pmfid.estimators.tuning import TUNING as ESTIMATOR_TUNING
from pmfid.models.drive import Drive
from pmfid.models.equation import DEAD_TIME, ESTIMATE, LAG

#: Alternatives to a change of the model that its score does not distinguish. To first order, a lag equals a dead time.
OTHERWISE: Mapping[str, tuple[Change, ...]] = MappingProxyType({"dead_time": ({"lag": ESTIMATE},)})


@dataclass(frozen=True)
class Candidate:
    """A change of the model with its description and origin.

    `z` is the score in standard deviations. `inflation` is the scatter of the score relative to independent errors.
    Before the fit, `inflation` belongs to the model without the term, and afterwards to the model with the term.
    `explains` is the doubled gain of the log-likelihood that the score predicts. `elsewhere` is the predicted gain over
    parts of the record that do not determine the coefficient. `scanned` says whether the pitch comes from a scan.
    """

    change: Change
    says: str
    z: float
    inflation: float
    explains: float
    elsewhere: float
    scanned: bool = False

    @property
    def key(self) -> str:
        """The key of [model] that the candidate sets."""
        return next(iter(self.change))


@dataclass(frozen=True)
class FittedCandidate:
    """One candidate, fitted in addition to the terms of a model.

    `gain` is the doubled gain of the log-likelihood, scaled so that a useless parameter brings 1. `needed` is the least
    gain that counts. `error` and `without` are errors of free runs over other parts of the record [unit of y], with and
    without the candidate. `verdict` is "kept", "either" or the reason for a refusal.
    """

    candidate: Candidate
    trial: Trial | None
    gain: float
    needed: float
    error: float
    verdict: str
    without: float = math.inf

    @property
    def kept(self) -> bool:
        return self.verdict == KEPT

    @property
    def explains_all(self) -> bool:
        """Whether the model with the candidate explains every count. The scores of a model are meaningless if a
        candidate explains every count.
        """
        return self.trial is not None and self.trial.best.clean

    @property
    def refused(self) -> bool:
        """Whether the candidate is beyond chance but refused, for a reason other than a better candidate."""
        return self.gain >= self.needed and self.verdict not in (KEPT, EITHER, DROPPED, LESS)

    @property
    def size(self) -> float:
        """The doubled gain of the log-likelihood itself, before its division by the inflation."""
        return self.gain * self.candidate.inflation


#: A load is a special case of directional friction.
LOAD: Change = MappingProxyType({"offset": True})
KEPT, EITHER, DROPPED, LESS = "kept", "either", "superfluous", "explains less"
WORSE = "predicts other parts worse"
UNCLEAR = "its pitch is unclear: give the pitch"


@dataclass(frozen=True)
class Terms:
    """The result of a search.

    `trials` lead from the first model to the chosen model. `errors` are the errors of the trials in free runs over
    other parts of the record [unit of y]. `steps` holds all candidates that each step has fitted. `without` holds one
    fit of the chosen model without each added term. `adequacy` is the adequacy of the chosen model.
    """

    trials: tuple[Trial, ...]
    errors: tuple[float, ...]
    steps: tuple[tuple[FittedCandidate, ...], ...]
    without: tuple[FittedCandidate, ...]
    adequacy: Adequacy

    @property
    def chosen(self) -> Trial:
        return self.trials[-1]

    @property
    def added(self) -> dict[str, object]:
        """The keys of [model] that the search sets."""
        return changed_fields(self.trials[0].model, self.chosen.model)

    @property
    def refused(self) -> tuple[FittedCandidate, ...]:
        """Refused terms that are beyond chance and that no other term replaces."""
        last = self.steps[-1:] if self.steps and not any(step.kept for step in self.steps[-1]) else ()
        return tuple(
            step
            for tried in (last if self.adequacy.adequate else self.steps)
            for step in tried
            if step.trial is not None and step.refused and step.candidate.key not in self.added
        )

    @cached_property
    def either(self) -> tuple[tuple[FittedCandidate, FittedCandidate], ...]:
        """Pairs of a kept term and a refused term that explains equally much."""
        pairs = []
        for tried in self.steps:
            kept = [step for step in tried if step.kept and step.candidate.key in self.added]
            others = [step for step in tried if step.verdict == EITHER and step.candidate.key not in self.added]
            pairs += [(kept[0], other) for other in others if kept]
        return tuple(pairs)


def changed_fields(first: Drive, last: Drive) -> dict[str, object]:
    """Return the fields in which the last model differs from the first, with the values of the last model."""
    pairs = ((field.name, getattr(first, field.name), getattr(last, field.name)) for field in fields(Drive))
    return {name: after for name, before, after in pairs if before != after}


def search(
    bench: Bench,
    model: Drive,
    places: Sequence[PeriodicForce] = (),
    scan: bool = True,
    done: Callable[[float], None] | None = None,
) -> Terms:
    """Search the terms of a drive, starting from a model.

    `places` are periodic forces along the travel that are candidates, too. If `scan`, the search also looks for the
    pitch of a cogging force. Raises NotIdentifiableError if the first model has no fit.
    """
    looking = scan and model.cogging is None and all(place.key != "cogging" for place in places)
    first = bench.first(model)
    return _Search(bench, tuple(places), looking, [first], [bench.elsewhere(first)], done or (lambda part: None)).run()


@dataclass
class _Search:
    """A search in progress.

    `trials` and `errors` have the same meaning as in `Terms`. `done` is called with the completed part of the work.
    """

    bench: Bench
    places: tuple[PeriodicForce, ...]
    looking: bool
    trials: list[Trial]
    errors: list[float]
    done: Callable[[float], None]
    steps: list[tuple[FittedCandidate, ...]] = field(default_factory=list)

    def run(self) -> Terms:
        """Add a term in each step, and finally remove superfluous terms."""
        seen, without = list[Drive](), tuple[FittedCandidate, ...]()
        while len(self.steps) < TUNING.most_steps and self.trials[-1].model not in seen:
            seen.append(self.trials[-1].model)
            tried = self._try_candidates()
            self.steps.append(tried)
            best = next((step for step in tried if step.kept), None)
            if best is None or best.trial is None:
                break
            self._take(best.trial, best.error)
            without = self._drop_superfluous()
        self.trials[-1] = self.bench.settle_fit(self.trials[-1])
        self.done(1.0)
        adequacy = self.trials[-1].weigh_forces(self.places)
        return self._resolve_alternatives(
            Terms(tuple(self.trials), tuple(self.errors), tuple(self.steps), without, adequacy)
        )

    def _resolve_alternatives(self, found: Terms) -> Terms:
        """Reject alternatives that explain less than the kept term in the final model.

        While other terms were missing, the alternative explained as much as the kept term.
        """
        less = [other for kept, other in found.either if self._is_less(found.chosen, kept.candidate, other.candidate)]
        steps = (
            tuple(replace(step, verdict=LESS) if any(step is one for one in less) else step for step in tried)
            for tried in found.steps
        )
        return replace(found, steps=tuple(steps))

    def _is_less(self, chosen: Trial, kept: Candidate, other: Candidate) -> bool:
        first = self.trials[0].model
        change = {key: getattr(first, key) for key in kept.change} | dict(other.change)
        try:
            swapped = self.bench.fit_model(change_arguments(chosen.model, change), chosen)
        except (NotIdentifiableError, UsageError):
            return True
        return 2 * (chosen.log_likelihood - swapped.log_likelihood) / kept.inflation >= TUNING.terms_alike

    def _take(self, trial: Trial, error: float) -> None:
        self.trials.append(trial)
        self.errors.append(error)

    def _try_candidates(self) -> tuple[FittedCandidate, ...]:
        """Return the fitted candidates of the last model, each with a verdict, best first."""
        trial = self.trials[-1]
        number = TUNING.terms_usual + len(self.places)
        candidates = propose_candidates(trial, trial.weigh_forces(self.places))
        looking = self.looking and trial.model.cogging is None and not trial.best.clean
        number += pitches(trial.best).size if looking else 0
        again = (
            *_otherwise_loaded(trial, candidates),
            *_otherwise_late(trial),
            *_list_retries(trial, self.steps, candidates),
        )
        again = () if trial.best.clean else again
        judged = self._judge_steps(self._fit_candidates(trial, candidates[: TUNING.most_tried], again, number))
        if looking and not any(step.kept for step in judged):
            judged = self._judge_steps(
                [*judged, *self._fit_candidates(trial, self._propose_pitches(trial), (), number)]
            )
        if trial.best.clean or any(step.kept for step in judged):
            return tuple(judged)
        return (*judged, *self._judge_steps(self._pairs(trial, judged, number)))

    def _fit_candidates(
        self, trial: Trial, candidates: Sequence[Candidate], again: Sequence[Candidate], number: int
    ) -> list[FittedCandidate]:
        """Fit the candidates, best first, and then the candidates in `again`, whose scores are meaningless.

        Weak candidates are fitted only if no candidate explains every count.
        """
        fitted = list[FittedCandidate]()
        for candidate in (*candidates, *again):
            known = any(step.explains_all and step.gain > step.needed for step in fitted)
            near = (
                candidate in candidates
                and candidate.explains >= ESTIMATOR_TUNING.adequacy_nearly * candidates[0].explains
            )
            if known and (candidate.scanned or not near):
                break
            fitted.append(_fit_candidate(self.bench, trial, candidate, number))
            self.done((len(self.steps) + len(fitted) / (len(candidates) + len(again) + 1)) / (TUNING.most_steps + 1))
        return fitted

    def _pairs(self, trial: Trial, tried: Sequence[FittedCandidate], number: int) -> list[FittedCandidate]:
        """Fit two terms together if no single term suffices.

        The first pair consists of the two best single terms. Further pairs combine the best term with a force along the
        travel. A quick fit of a force along the travel may diverge while the best term is missing. In later steps, the
        search fits the force along the travel alone. A force along the travel may replace a term that an earlier step
        kept.
        """
        best = [step.candidate for step in tried if step.trial is not None][:2]
        looking = self.looking and trial.model.cogging is None
        pairs = [tuple(best)] if len(best) == 2 else []
        along = self._propose_peaks(trial) if looking else []
        pairs += [(best[0] if best and len(self.trials) == 1 else one, one) for one in along]
        fitted = list[FittedCandidate]()
        for one, other in pairs:
            change = {**one.change, **other.change}
            if other.change.items() <= change.items() and one.change.items() <= change.items():
                says = other.says if one is other else f"{one.says}, and {other.says}"
                both = replace(one, change=change, says=says, scanned="cogging" in change)
                fitted.append(_fit_candidate(self.bench, trial, replace(both, elsewhere=math.inf), number**2))
            if fitted and fitted[-1].explains_all:
                break
        return fitted

    def _propose_peaks(self, trial: Trial) -> list[Candidate]:
        """Return cogging forces at the peaks of the scans."""
        places = [PeriodicForce("cogging", pitch) for pitch in self.bench.scan_pitches(trial)[: TUNING.most_paired]]
        return [Candidate({one.key: one.period}, one.says, 0.0, 1.0, 0.0, math.inf, True) for one in places]

    def _propose_pitches(self, trial: Trial) -> list[Candidate]:
        """Return cogging forces of the pitches that the scans find."""
        found = []
        for gain, pitch in self.bench.pitches(trial):
            place = PeriodicForce("cogging", pitch)
            seen = trial.weigh_forces([place])
            scores = [abs(z) for candidate, z in zip(seen.forces, seen.z, strict=True) if candidate.name == place.key]
            z = float(max(scores, default=0.0))
            found.append(Candidate({place.key: pitch}, place.says, z, 1.0, gain, gain, True))
        return found

    def _judge_steps(self, found: Sequence[FittedCandidate]) -> list[FittedCandidate]:
        """Keep the first candidate beyond chance that does not worsen the prediction of other parts of the record."""
        judged, kept, error = list[FittedCandidate](), None, self.errors[-1]
        for step in _simplest_first(found):
            if step.trial is None or (reason := find_objection(step, found)):
                judged.append(step if step.trial is None else replace(step, verdict=reason, without=error))
                continue
            own = step.error if math.isfinite(step.error) else self.bench.elsewhere(step.trial)
            verdict = WORSE if is_worse(own, error) else _next_to(step, kept) if kept else KEPT
            judged.append(replace(step, error=own, verdict=verdict, without=error))
            kept = judged[-1] if judged[-1].kept else kept
        return judged

    def _drop_superfluous(self) -> tuple[FittedCandidate, ...]:
        """Return the chosen model without each of the added terms.

        The search removes a term if its loss is within chance, or if the term worsens the prediction of other parts.
        """
        first = self.trials[0].model
        while True:
            last = self.trials[-1].model
            tried = [self._remove_term(change) for change in removable(first, last)]
            simpler = [self._remove_term(DIRECTIONAL, LOAD)] if last.friction != first.friction else []
            gone = [step for step in (*tried, *simpler) if step.verdict == DROPPED and step.trial is not None]
            if not gone:
                return tuple(tried)
            least = min(gone, key=lambda step: step.gain)
            self.steps.append((least,))
            if least.trial is not None:
                self._take(least.trial, least.without)

    def _remove_term(self, change: Change, instead: Change = MappingProxyType({})) -> FittedCandidate:
        """Fit the model without a term. `instead` is a simpler term in its place."""
        whole, first = self.trials[-1], self.trials[0].model
        own = {key: getattr(whole.model, key) for key in change}
        candidate = Candidate(own, " and ".join(setting(*pair) for pair in own.items()), 0.0, 1.0, 0.0, math.inf)
        try:
            back = {key: getattr(first, key) for key in change} | dict(instead)
            found = self.bench.fit_model(change_arguments(whole.model, back), whole)
        except (NotIdentifiableError, UsageError):  # no motion follows the record without the term
            return FittedCandidate(candidate, None, math.inf, 0.0, self.errors[-1], KEPT)
        candidate = replace(candidate, inflation=inflation(found, whole))
        needed, loss = (
            _compute_needed_gain(whole, found, TUNING.terms_usual + len(self.places)),
            _gain(whole, found, candidate),
        )
        error = self.bench.elsewhere(found)
        gone = loss < needed or is_worse(self.errors[-1], error)
        return FittedCandidate(candidate, found, loss, needed, self.errors[-1], DROPPED if gone else KEPT, error)


def is_worse(error: float, before: float) -> bool:
    """Return whether an error of free runs exceeds the error `before` of the model without a term."""
    return error > (1 + TUNING.no_worse) * before


def removable(first: Drive, last: Drive) -> list[Change]:
    """Return each single change among the changes from one model to another."""
    found = changed_fields(first, last)
    together = {"friction": DIRECTIONAL}
    return [dict(together.get(key, {key: value})) for key, value in found.items() if key != "offset" or last.offset]


def _next_to(step: FittedCandidate, kept: FittedCandidate) -> str:
    """Return the verdict on a term in comparison with the kept term."""
    return EITHER if _measure_deficit(step, kept) < TUNING.terms_alike and not _is_special_case(kept, step) else LESS


def _measure_deficit(step: FittedCandidate, best: FittedCandidate) -> float:
    """Return how much less a term explains than the best term, in units of chance."""
    if step.trial is None or best.trial is None:
        return math.inf
    return 2 * (best.trial.log_likelihood - step.trial.log_likelihood) / best.candidate.inflation


def _simplest_first(found: Sequence[FittedCandidate]) -> list[FittedCandidate]:
    """Return the terms in the order of their size.

    A special case of the best term comes first if both terms explain equally much within chance.
    """
    ordered = sorted(found, key=lambda step: step.size, reverse=True)
    for step in ordered[1:]:
        if (
            _is_special_case(step, ordered[0])
            and _measure_deficit(step, ordered[0]) < TUNING.terms_alike + TUNING.per_parameter
        ):
            return [step, *(one for one in ordered if one is not step)]
    return ordered


def _is_special_case(step: FittedCandidate, other: FittedCandidate) -> bool:
    """Return whether a term is a special case of another term, as a load is of directional friction."""
    return step.candidate.key == "offset" and other.candidate.key == "friction"


def _otherwise_loaded(trial: Trial, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return a load as a candidate if the model has none.

    The best motion without a large load is far from the record, and the score of the load is then meaningless.
    """
    tried = (one.key for one in candidates[: TUNING.most_tried])
    if _has(trial.model, LOAD) or trial.model.friction == "directional" or "offset" in tried:
        return []
    return [Candidate(LOAD, "a constant load", 0.0, 1.0, 0.0, math.inf)]


def _otherwise_late(trial: Trial) -> list[Candidate]:
    """Return a model with dead time and lag as a candidate if the model has only one of them.

    Likelihoods distinguish a dead time from a lag, but scores do not.
    """
    keys = [key for key in (DEAD_TIME, LAG) if getattr(trial.model, key) == ESTIMATE]
    if len(keys) != 1:
        return []
    other = LAG if keys == [DEAD_TIME] else DEAD_TIME
    return [Candidate({other: ESTIMATE}, "a dead time and a lag of the input", 0.0, 1.0, 0.0, math.inf)]


def _list_retries(
    trial: Trial, steps: Sequence[tuple[FittedCandidate, ...]], candidates: Sequence[Candidate]
) -> tuple[Candidate, ...]:
    """Return the candidates of the last step that were beyond chance but lost.

    The kept term may have absorbed a part of the effect of a lost candidate, so that its score is meaningless.
    """
    if not steps:
        return ()
    lost = [step.candidate for step in steps[-1] if step.trial and not step.kept and step.gain > step.needed]
    known = {candidate.key for candidate in candidates}
    return tuple(one for one in lost if one.key not in known and not _has(trial.model, one.change))


def _has(model: Drive, change: Change) -> bool:
    return all(getattr(model, key) == value for key, value in change.items())


def propose_candidates(trial: Trial, found: Adequacy) -> list[Candidate]:
    """Return the candidates that the counts ask for, ordered by predicted gain.

    If several forces lead to the same change, the function returns the best force.
    """
    by_change: dict[str, Candidate] = {}
    for k in np.argsort(-found.gain).tolist():
        candidate = found.forces[k]
        if not _deserves_trial(trial, found, k) or (candidate.positive and found.size[k] < 0):
            continue
        for change in (*candidate.changes, *OTHERWISE.get(candidate.name, ())):
            if _has(trial.model, change):
                continue
            scatter, gain = float(found.size_std[k] ** 2 * found.expected[k]), float(found.gain[k])
            one = Candidate(change, candidate.says, float(found.z[k]), scatter, gain, float(found.elsewhere[k]))
            by_change.setdefault(repr(sorted(change.items())), one)
    return list(by_change.values())


def _deserves_trial(trial: Trial, found: Adequacy, k: int) -> bool:
    """Return whether a force deserves a trial.

    If the model explains every count, the score of the force must be beyond chance. If the model leaves effects out,
    these effects scatter the scores, and the likelihood decides.
    """
    if trial.best.clean:
        return bool(abs(found.z[k]) >= ESTIMATOR_TUNING.adequacy_missed)
    return bool(abs(found.z[k]) >= TUNING.terms_weak and found.gain[k] >= ESTIMATOR_TUNING.adequacy_missed**2)


def _gain(trial: Trial, before: Trial, candidate: Candidate) -> float:
    return 2 * (trial.log_likelihood - before.log_likelihood) / candidate.inflation


def _compute_needed_gain(found: Trial, before: Trial, number: int) -> float:
    return (
        ESTIMATOR_TUNING.adequacy_missed**2
        + 2 * math.log(number)
        + TUNING.per_parameter * (found.parameters - before.parameters - 1)
    )


def _fit_candidate(bench: Bench, trial: Trial, candidate: Candidate, number: int) -> FittedCandidate:
    try:
        found = bench.further(trial, candidate.change)
        if candidate.scanned:
            found = bench.tune_pitch(found)
            candidate = replace(candidate, change={**candidate.change, "cogging": found.model.cogging})
    except (NotIdentifiableError, UsageError):  # UsageError: the model has no room for both terms
        return FittedCandidate(candidate, None, 0.0, math.inf, math.inf, "no fit")
    candidate = replace(candidate, inflation=inflation(trial, found))
    return FittedCandidate(
        candidate, found, _gain(found, trial, candidate), _compute_needed_gain(found, trial, number), math.inf, ""
    )


def find_objection(step: FittedCandidate, found: Sequence[FittedCandidate]) -> str:
    """Return the reason to refuse a term independently of other terms, or an empty text."""
    if step.gain < step.needed:
        return "gain within chance"
    if step.candidate.elsewhere <= 0 and not step.explains_all:
        return "not confirmed by other parts of the record"
    return UNCLEAR if is_unclear(step, found) else ""


def is_unclear(step: FittedCandidate, found: Sequence[FittedCandidate]) -> bool:
    """Return whether a term is a cogging force whose pitch explains hardly more than another pitch.

    If two pitches explain equally much, neither pitch is credible.
    """
    if step.explains_all:
        return False
    own = step.candidate
    others = [one for one in found if one.candidate.key == own.key == "cogging" and one.candidate.change != own.change]
    return any(one.trial and one.size > TUNING.terms_hardly * step.size for one in others)

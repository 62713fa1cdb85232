"""Which terms does a drive have? A search from a model upwards, one term at a time.

Each step is proposed by the score tests of the counts at the best fit of the model so far (`estimators/adequacy.py`),
which cost nothing, and then fitted. A term is kept where the likelihood ratio is beyond chance, as the number of terms
that were tried and the scatter of the scores allow it (Rao 1948; Bonferroni), and where it explains parts of the record
that it was not fitted to. In the end a term goes that the others have made superfluous.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np

from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.adequacy import MISSED, NEARLY, Adequacy
from pmfid.estimators.configuration import changed
from pmfid.estimators.lacks import Change, Place
from pmfid.judge.term_fits import Bench
from pmfid.judge.term_periods import pitches
from pmfid.judge.term_trials import Trial, inflation
from pmfid.models.drive import Drive
from pmfid.models.equation import ESTIMATE

#: Where the model does not explain every count, its scores scatter for what it lacks: these are worth a trial then.
WEAK = 1.0
#: What the score of a force cannot tell from it: a lag is a dead time to first order.
OTHERWISE: Mapping[str, tuple[Change, ...]] = MappingProxyType({"dead_time": ({"lag": ESTIMATE},)})
#: Terms that are fitted in each step where none explains every count, and steps.
MOST_TRIED, MOST_STEPS = 4, 6
#: Candidates that chance has in each step, about, beside places and pitches.
USUAL = 8
#: A gain that every further parameter of a term has to bring.
PER_PARAMETER = 4.0
#: Gains of two terms that differ by less, in the units of chance, are the same: three standard deviations.
ALIKE = 9.0
#: A pitch that explains more than this part of what the best one explains leaves open which it is.
HARDLY = 0.5
#: Free runs over other parts may be worse by this part: they are a matter of chance, too.
NO_WORSE = 0.02
#: Free runs whose error is within so many times that of a right model refute none.
CHANCE = 1.5


@dataclass(frozen=True)
class Candidate:
    """A change of the model, what it is, and how it was come by. z: standard deviations of its score from zero;
    inflation: by how much the score scatters beyond what independent errors would, at first before the term is there,
    and when it is fitted with it; explains: doubled gain of the log-likelihood that its score promises; elsewhere: that
    over parts that it is not taken from; scanned: its pitch comes from a scan."""

    change: Change
    says: str
    z: float
    inflation: float
    explains: float
    elsewhere: float
    scanned: bool = False

    @property
    def key(self) -> str:
        """The key of [model] that it sets."""
        return next(iter(self.change))


@dataclass(frozen=True)
class Step:
    """One candidate, fitted on top of a model. gain: doubled gain of the log-likelihood over what chance makes of it,
    so that a parameter of no use brings 1; needed: the gain from which on it counts; error: of free runs over other
    parts of the record [unit of y]; verdict: "kept", "either" or the reason why not."""

    candidate: Candidate
    trial: Trial | None
    gain: float
    needed: float
    error: float
    verdict: str

    @property
    def kept(self) -> bool:
        return self.verdict == KEPT

    @property
    def explains_all(self) -> bool:
        """Does the model explain every count with it? Then no score at the model before it is to be asked."""
        return self.trial is not None and self.trial.best.clean

    @property
    def refused(self) -> bool:
        """Is it beyond chance, and yet not kept for a reason other than a better one?"""
        return self.gain >= self.needed and self.verdict not in (KEPT, EITHER, DROPPED, LESS)

    @property
    def size(self) -> float:
        """Doubled gain of the log-likelihood as it stands."""
        return self.gain * self.candidate.inflation


KEPT, EITHER, DROPPED, LESS = "kept", "either", "superfluous", "explains less"
UNCLEAR = "its pitch is unclear: give it"


@dataclass(frozen=True)
class Terms:
    """The search: trials, from the model to begin with to the chosen one, their errors of free runs over other parts of
    the record [unit of y], all candidates that were fitted in each step, and what the last model may still lack."""

    trials: tuple[Trial, ...]
    errors: tuple[float, ...]
    steps: tuple[tuple[Step, ...], ...]
    adequacy: Adequacy

    @property
    def chosen(self) -> Trial:
        return self.trials[-1]

    @property
    def added(self) -> dict[str, object]:
        """Keys of [model] that the search sets."""
        return changed_fields(self.trials[0].model, self.chosen.model)

    @property
    def refused(self) -> tuple[Step, ...]:
        """Terms beyond chance that were not kept, and that nothing else has taken the place of."""
        last = self.steps[-1:] if self.steps and not any(step.kept for step in self.steps[-1]) else ()
        return tuple(
            step
            for tried in (last if self.adequacy.adequate else self.steps)
            for step in tried
            if step.trial is not None and step.refused and step.candidate.key not in self.added
        )

    @cached_property
    def either(self) -> tuple[tuple[Step, Step], ...]:
        """Terms that were kept, with others that explain as much and were not."""
        pairs = []
        for tried in self.steps:
            kept = [step for step in tried if step.kept and step.candidate.key in self.added]
            others = [step for step in tried if step.verdict == EITHER and step.candidate.key not in self.added]
            pairs += [(kept[0], other) for other in others if kept]
        return tuple(pairs)


def changed_fields(first: Drive, last: Drive) -> dict[str, object]:
    """The fields of the last that differ from those of the first."""
    pairs = ((field.name, getattr(first, field.name), getattr(last, field.name)) for field in fields(Drive))
    return {name: after for name, before, after in pairs if before != after}


def search(
    bench: Bench,
    model: Drive,
    places: Sequence[Place] = (),
    scan: bool = True,
    done: Callable[[float], None] | None = None,
) -> Terms:
    """From the model upwards. places: what may come again along the travel, too; scan: look for the pitch of a cogging
    force. Raises NotIdentifiableError where not even the model to begin with has a fit."""
    looking = scan and model.cogging is None and all(place.key != "cogging" for place in places)
    trials, steps = [bench.first(model)], list[tuple[Step, ...]]()
    errors = [bench.elsewhere(trials[0])]
    for _ in range(MOST_STEPS):
        tried = _tried(bench, trials[-1], errors[-1], places, looking, steps)
        steps.append(tried)
        best = next((step for step in tried if step.kept), None)
        if best is None or best.trial is None:
            break
        trials.append(best.trial)
        errors.append(best.error)
        if done is not None:
            done(len(trials) / MOST_STEPS)
    trials, errors, dropped = _without_superfluous(bench, trials, errors, steps)
    steps += [dropped] if dropped else []
    return Terms(tuple(trials), tuple(errors), tuple(steps), trials[-1].weighed(places))


def _tried(
    bench: Bench,
    trial: Trial,
    error: float,
    places: Sequence[Place],
    looking: bool,
    steps: Sequence[tuple[Step, ...]],
) -> tuple[Step, ...]:
    """What is missing in a model, fitted, with a verdict on each; the best first."""
    number = USUAL + len(places)
    candidates = proposed(trial, trial.weighed(places))
    if looking and trial.model.cogging is None:
        number += pitches(trial.best).size
        candidates = sorted([*candidates, *_scanned(bench, trial)], key=lambda one: -one.explains)
    again = () if trial.best.clean else _again(trial, steps, candidates)
    fitted = list[Step]()
    for candidate in (*candidates[:MOST_TRIED], *again):
        if candidate.scanned and any(step.candidate.scanned and step.explains_all for step in fitted):
            continue  # the pitch is known
        near = candidate.explains >= NEARLY * candidates[0].explains if candidates else False
        if not near and any(step.trial and step.trial.best.clean and step.gain > step.needed for step in fitted):
            break
        fitted.append(_fitted(bench, trial, candidate, number))
    fitted.sort(key=lambda step: step.size, reverse=True)
    return tuple(_judged(bench, error, fitted))


def _scanned(bench: Bench, trial: Trial) -> list[Candidate]:
    """Cogging forces of the pitches that scans end at."""
    found = []
    for gain, pitch in bench.pitches(trial):
        place = Place("cogging", pitch)
        seen = trial.weighed([place])
        z = max(
            (float(abs(z)) for lack, z in zip(seen.lacks, seen.z, strict=True) if lack.name == place.key), default=0.0
        )
        found.append(Candidate({place.key: pitch}, place.says, z, 1.0, gain, gain, True))
    return found


def _again(trial: Trial, steps: Sequence[tuple[Step, ...]], candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """What was beyond chance in the last step, and lost: the term that won may have taken its place in part, so that
    its score says nothing any more."""
    if not steps:
        return ()
    lost = [step.candidate for step in steps[-1] if step.trial and not step.kept and step.gain > step.needed]
    known = {candidate.key for candidate in candidates}
    return tuple(one for one in lost if one.key not in known and not _has(trial.model, one.change))


def _has(model: Drive, change: Change) -> bool:
    return all(getattr(model, key) == value for key, value in change.items())


def proposed(trial: Trial, found: Adequacy) -> list[Candidate]:
    """What the counts ask for, by what it promises; of a change that several forces ask for, the best of these."""
    by_change: dict[str, Candidate] = {}
    for k in np.argsort(-found.gain).tolist():
        lack = found.lacks[k]
        if not _asked(trial, found, k) or (lack.positive and found.size[k] < 0):
            continue
        for change in (*lack.changes, *OTHERWISE.get(lack.name, ())):
            if _has(trial.model, change):
                continue
            scatter, gain = float(found.size_std[k] ** 2 * found.expected[k]), float(found.gain[k])
            one = Candidate(change, lack.says, float(found.z[k]), scatter, gain, float(found.elsewhere[k]))
            by_change.setdefault(repr(sorted(change.items())), one)
    return list(by_change.values())


def _asked(trial: Trial, found: Adequacy, k: int) -> bool:
    """Is a force worth a trial? Of a model that explains every count its score must be beyond chance. Beside any other
    the scores scatter for what is missing, up to all that is to be seen of it; there the likelihood decides."""
    if trial.best.clean:
        return bool(abs(found.z[k]) >= MISSED)
    return bool(abs(found.z[k]) >= WEAK and found.gain[k] >= MISSED**2)


def _gain(trial: Trial, before: Trial, candidate: Candidate) -> float:
    return 2 * (trial.log_likelihood - before.log_likelihood) / candidate.inflation


def _fitted(bench: Bench, trial: Trial, candidate: Candidate, number: int) -> Step:
    try:
        found = bench.further(trial, candidate.change)
        if candidate.scanned:
            found = bench.tuned(found)
            candidate = replace(candidate, change={candidate.key: found.model.cogging})
    except (NotIdentifiableError, UsageError):  # or the model has no room for both
        return Step(candidate, None, 0.0, math.inf, math.inf, "no fit")
    further = found.parameters - trial.parameters
    needed = MISSED**2 + 2 * math.log(number) + PER_PARAMETER * (further - 1)
    candidate = replace(candidate, inflation=inflation(trial, found))
    return Step(candidate, found, _gain(found, trial, candidate), needed, math.inf, "")


def _judged(bench: Bench, error: float, found: Sequence[Step]) -> list[Step]:
    """The first that is beyond chance and predicts other parts no worse is kept."""
    judged, kept = list[Step](), None
    for step in found:
        if step.trial is None or (reason := against(step, found)):
            judged.append(step if step.trial is None else replace(step, verdict=reason))
            continue
        if kept is not None and kept.trial is not None:
            behind = 2 * (kept.trial.log_likelihood - step.trial.log_likelihood) / kept.candidate.inflation
            judged.append(replace(step, verdict=EITHER if behind < ALIKE else LESS))
            continue
        own = bench.elsewhere(step.trial)
        worse = own > (1 + NO_WORSE) * error and own > CHANCE * bench.by_chance(step.trial)
        step = replace(step, error=own, verdict="predicts other parts worse" if worse else KEPT)
        kept = step if step.kept else kept
        judged.append(step)
    return judged


def against(step: Step, found: Sequence[Step]) -> str:
    """What speaks against a term whatever else is there; empty where nothing does."""
    if step.gain < step.needed:
        return "within chance"
    if step.candidate.elsewhere <= 0 and not step.explains_all:
        return "not in other parts of the record"
    return UNCLEAR if is_unclear(step, found) else ""


def is_unclear(step: Step, found: Sequence[Step]) -> bool:
    """Is it a force along the travel of a pitch that is hardly better than another one? Neither is to be believed."""
    if step.explains_all:
        return False
    own = step.candidate
    others = [one for one in found if one.candidate.key == own.key == "cogging" and one.candidate.change != own.change]
    return any(one.trial and one.size > HARDLY * step.size for one in others)


def _without_superfluous(
    bench: Bench, trials: list[Trial], errors: list[float], steps: Sequence[tuple[Step, ...]]
) -> tuple[list[Trial], list[float], tuple[Step, ...]]:
    kept = [step for tried in steps for step in tried if step.kept]
    dropped = []
    for step in kept:
        whole, first = trials[-1], trials[0].model
        model = changed(whole.model, {key: getattr(first, key) for key in step.candidate.change})
        try:
            without = bench.fitted(model, whole)
        except (NotIdentifiableError, UsageError):
            continue
        loss = 2 * (whole.log_likelihood - without.log_likelihood) / step.candidate.inflation
        if loss < step.needed:
            trials, errors = [*trials, without], [*errors, bench.elsewhere(without)]
            dropped.append(replace(step, trial=without, gain=loss, verdict=DROPPED, error=errors[-1]))
    return trials, errors, tuple(dropped)

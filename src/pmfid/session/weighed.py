"""The terms of a search one by one: size, standard error, and predictions of other parts with and without the term."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pmfid.estimators.candidate_forces import setting
from pmfid.estimators.configuration import change_arguments
from pmfid.estimators.results import Fit
from pmfid.judge.term_trials import Trial
from pmfid.judge.terms import FittedCandidate, Terms
from pmfid.models.drive import Drive
from pmfid.session.nested import finite, fit_trial


@dataclass(frozen=True, eq=False)
class WeighedTerm:
    """A term that was fitted. setting: its lines of [model]; values: name, value, standard error (NaN: not known) and
    unit of each parameter that the term brings; kept: is it in the chosen model? with_it, without: errors of free runs
    over samples that the fits did not use [unit of y], not finite without such runs; verdict."""

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


def weighed_terms(found: Terms, fit: Fit | None) -> Iterator[WeighedTerm]:
    """Each term of the chosen model, with the standard errors of `fit`; then the terms that were fitted and not
    kept."""
    first, last = found.trials[0].model, dict[str, FittedCandidate]()
    for step in found.without:
        yield _weigh_step(step, first, found.chosen, fit)
    for step in (step for tried in found.steps for step in tried):
        if step.trial is not None and not step.kept and not step.candidate.change.items() <= found.added.items():
            last[_setting(step)] = step
    for step in last.values():
        if step.trial is not None:
            yield _weigh_step(step, first, step.trial, fit_trial(step.trial))


def _setting(step: FittedCandidate) -> str:
    return ", ".join(setting(*pair) for pair in step.candidate.change.items())


def _weigh_step(step: FittedCandidate, first: Drive, trial: Trial, fit: Fit | None) -> WeighedTerm:
    """The weighed term of a step; first: the first model; trial: one with the term."""
    equation = trial.model.equation
    rest = change_arguments(trial.model, {key: getattr(first, key) for key in step.candidate.change}).equation
    names, units = (*equation.names, *dict(equation.further)), (*equation.units, *dict(equation.further).values())
    std = np.full(len(names), np.nan) if fit is None else fit.theta_std
    rows = zip(names, trial.theta.tolist(), std.tolist(), units, strict=True)
    values = tuple(row for row in rows if row[0] not in {*rest.names, *dict(rest.further)})
    return WeighedTerm(_setting(step), values, step.kept, step.error, step.without, step.verdict)

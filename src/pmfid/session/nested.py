"""Models of one drive compared: parameters with standard errors, and the part of the friction that each leaves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pmfid.errors import NotIdentifiableError
from pmfid.estimators.results import Fit
from pmfid.judge.balance import Balance
from pmfid.judge.correlations import make_balance
from pmfid.judge.term_fits import Bench
from pmfid.judge.term_trials import Trial
from pmfid.judge.terms import changed_fields
from pmfid.models.drive import Drive
from pmfid.models.equation import ESTIMATE

#: Part of the motion that counts as slow.
SLOW = 1 / 3


@dataclass(frozen=True, eq=False)
class NestedModel:
    """One of the compared models.

    added: keys of [model] and values that differ from the first model; fit: None without standard errors; error: of
    free runs over samples that the fit did not use [unit of y], infinite without such runs; unexplained: parts of
    friction and load that the model leaves, over the whole motion and its slow part, NaN if not known.
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
    """The fit of a trial with standard errors; None if it has none."""
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
    """Parts of the resistance to the motion that a model leaves: root mean squares over the motion of the chosen model,
    and over the slow part of it. The parts are the difference to the chosen model, and the resistance that the chosen
    model leaves beyond chance by the force balance."""
    if balance is None or last is None or last.friction is None:
        return math.nan, math.nan
    left = last.friction.left
    beyond = float(np.mean(np.maximum(left.mean**2 - left.error**2, 0.0)))
    x, v = chosen.difference.motion(chosen.best.q)
    place, velocity = (x - chosen.difference.slack)[v != 0], v[v != 0]
    whole = last.resistance(place, velocity)
    apart = balance.resistance(place, velocity) - whole
    slow = np.abs(velocity) <= np.quantile(np.abs(velocity), SLOW)
    every, low = (
        np.sqrt((np.mean(apart[part] ** 2) + beyond) / np.mean(whole[part] ** 2)) for part in (v[v != 0] != 0, slow)
    )
    return float(every), float(low)


def format_terms(added: Mapping[str, object]) -> str:
    """Terms of [model], for people."""
    named = {key: value for key, value in added.items() if value is not False}
    return ", ".join(
        f"{value} {key}" if isinstance(value, str) and value != ESTIMATE else key for key, value in named.items()
    )


def finite(value: float) -> float | None:
    return value if math.isfinite(value) else None

"""The contract suite finds estimators that each break one promise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pmfid
from pmfid.estimators.base import Estimator
from pmfid.testing import ContractError, check_estimator, checks_of
from tests.conftest import cart_run
from tests.refusals import refused

DRIVE, ENCODER = pmfid.Drive(2.0, offset=True), pmfid.Encoder(1e-4)
SETTINGS = (DRIVE, ENCODER, 0.005, 40.0)


class Hidden(pmfid.RLS):
    """An estimator whose copies share the state."""

    def __copy__(self):
        other = replace(self)
        other.__dict__.update(kernel=self.kernel, step=self.kernel.step)
        return other


class Mutable(pmfid.LS):
    def __setattr__(self, name, value):
        pass


class Greedy(pmfid.LS):
    """An estimator that sorts the caller's input."""

    def fit(self, u, counts):
        fit = super().fit(u, counts)
        if isinstance(u, np.ndarray):
            u.sort()
        return fit


class Biased(pmfid.LS):
    def fit(self, u, counts):
        fit = super().fit(u, counts)
        return replace(fit, theta=1.2 * fit.theta)


class OneSided(pmfid.LS):
    """An estimator that loses the sign of a load."""

    def fit(self, u, counts):
        fit = super().fit(u, counts)
        return replace(fit, theta=np.abs(fit.theta))


class Confident(pmfid.LS):
    """An estimator whose error bars do not depend on the data."""

    def fit(self, u, counts):
        fit = super().fit(u, counts)
        return replace(fit, theta_cov=np.eye(4))


class Credulous(pmfid.LS):
    """An estimator that finds an estimate in a record at rest."""

    def fit(self, u, counts):
        run = cart_run(1, samples=1500)
        return super().fit(u, counts) if np.any(counts) else super().fit(run.u, run.counts)


class Trusting(pmfid.RLS):
    """An estimator that accepts any state."""

    def set_state(self, state):
        try:
            super().set_state(state)
        except pmfid.UsageError:
            self.reset()


class Jumpy(pmfid.RLS):
    """An estimator whose run in parts differs from the whole run."""

    def set_state(self, state):
        super().set_state(state)
        self.open_memory(0.5)


class Silent(pmfid.RLS):
    """An estimator that hides poor excitation."""

    def run(self, u, counts):
        track = super().run(u, counts)
        return replace(track, status=track.status * 0)


class Fragile(pmfid.RLS):
    def run(self, u, counts):
        track = super().run(u, counts)
        return replace(track, theta=track.theta * (np.nan if np.any(~np.isfinite(u)) else 1.0))


class Rounding(pmfid.RLS):
    def step(self, u, counts):
        return super().step(u, round(counts))


BROKEN = {
    Hidden: "copies_go_on_alone: the original moves",
    Mutable: "configuration_is_a_value: a new value of dt raises no FrozenInstanceError",
    Greedy: "inputs_stay_untouched: the arrays",
    Biased: "finds_the_truth: of",
    OneSided: "mirrors: it is",
    Confident: "more_data_make_shorter_error_bars",
    Credulous: "rest_is_not_identifiable: a record at rest",
    Trusting: "a_foreign_state_is_refused: a state of another dt raises no UsageError",
    Jumpy: "parts_are_the_whole: step",
    Silent: "rest_says_poor_excitation: the status",
    Fragile: "anything_leaves_numbers: theta",
    Rounding: "counts_are_integers: a count of 7.9",
}


def broken(cls: type[Estimator]) -> list[str]:
    """Return the messages of the failed checks."""
    found = []
    for _, check in checks_of(cls(*SETTINGS)):
        try:
            check()
        except ContractError as error:
            found.append(str(error))
    return found


@pytest.mark.parametrize("cls", BROKEN)
def test_a_broken_promise_is_found_and_named(cls) -> None:
    said = broken(cls)
    assert any(BROKEN[cls] in each for each in said), said


@pytest.mark.parametrize("cls", [pmfid.LS, pmfid.RLS])
def test_what_they_derive_from_keeps_all(cls) -> None:
    check_estimator(cls(*SETTINGS))


@pytest.mark.parametrize("thing", [DRIVE, Estimator(*SETTINGS), None])
def test_what_is_no_estimator_is_refused(thing) -> None:
    refused(("needs an Estimator with fit", lambda: check_estimator(thing)))

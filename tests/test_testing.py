"""The contract suite finds estimators that each break one promise."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest

import pmfid
from pmfid.estimators.base import Estimator
from pmfid.estimators.batch import BatchEstimator
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


class Forgetful(pmfid.RLS):
    """An estimator whose copies restart."""

    def __deepcopy__(self, memo):
        return replace(self)


class Mutable(pmfid.LS):
    def __setattr__(self, name, value):
        pass


class Identical(pmfid.LS):
    __hash__ = object.__hash__


class Lax(pmfid.LS):
    def _check_equation(self):
        pass

    def __post_init__(self):
        if self.dt > 0 and self.cutoff > 0 and isinstance(self.encoder, pmfid.Encoder) and self.model:
            object.__setattr__(self, "order", 2)


class Greedy(pmfid.LS):
    """An estimator that sorts the caller's input."""

    def fit(self, u, counts):
        fit = super().fit(u, counts)
        if isinstance(u, np.ndarray):
            u.sort()
        return fit


class Nameless(pmfid.LS):
    @property
    def names(self):
        return ("mass",) * 4


class Biased(pmfid.LS):
    def fit(self, u, counts):
        fit = super().fit(u, counts)
        return replace(fit, theta=1.2 * fit.theta)


class OneSided(pmfid.LS):
    """An estimator that loses the sign of a load."""

    def fit(self, u, counts):
        fit = super().fit(u, counts)
        return replace(fit, theta=np.abs(fit.theta))


class InMetres(pmfid.LS):
    def fit(self, u, counts):
        fit = super().fit(u, counts)
        return replace(fit, theta=fit.theta * (1 + 1e-2 * (self.encoder.resolution > 1e-2)))


class Confident(pmfid.LS):
    """An estimator whose error bars do not depend on the data."""

    def fit(self, u, counts):
        fit = super().fit(u, counts)
        return replace(fit, theta_cov=np.eye(4))


class Slanted(pmfid.LS):
    def fit(self, u, counts):
        fit = super().fit(u, counts)
        return replace(fit, theta_cov=fit.theta_cov * (1 + np.triu(np.ones((4, 4)), 1)))


class Credulous(pmfid.LS):
    """An estimator that finds an estimate in a record at rest."""

    def fit(self, u, counts):
        run = cart_run(1, samples=1500)
        return super().fit(u, counts) if np.any(counts) else super().fit(run.u, run.counts)


class Careless(pmfid.LS):
    def fit(self, u, counts):
        n = min(len(u), len(counts))
        return super().fit(u[:n], np.floor(counts[:n]) if isinstance(counts, np.ndarray) else counts[:n])


class Stubborn(pmfid.RLS):
    def reset(self):
        pass


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


class Drifting(pmfid.LS):
    def __copy__(self):
        return replace(self, cutoff=0.5 * self.cutoff)


class Rounding(pmfid.RLS):
    def step(self, u, counts):
        return super().step(u, round(counts))


class Particular(pmfid.RLS):
    """An estimator that is unequal to a second one with other samples."""

    def __eq__(self, other):
        return self.get_state() == other.get_state()

    __hash__ = pmfid.RLS.__hash__


class Shared(pmfid.RLS):
    """An estimator that starts as the same object."""

    def start(self, state=None):
        return self


class Rough(pmfid.RLS):
    def run(self, u, counts):
        track = super().run(u, counts)
        return replace(track, theta=track.theta * (1.01 if self.precision == "float32" else 1.0))


BROKEN = {
    Hidden: "copies_go_on_alone: the original moves",
    Forgetful: "copies_go_on_alone: copy.deepcopy goes on with other bits",
    Mutable: "configuration_is_a_value: a new value of dt raises no FrozenInstanceError",
    Identical: "configuration_is_a_value: two of the same configuration have two hashes",
    Lax: "wrong_arguments_are_refused: dt = 0.0",
    Greedy: "inputs_stay_untouched: the arrays",
    Nameless: "names_are_of_the_parameters: names are twice",
    Biased: "finds_the_truth: of",
    OneSided: "mirrors: it is",
    InMetres: "scales_with_the_units: it is",
    Confident: "more_data_make_shorter_error_bars",
    Slanted: "covariance_is_one: theta_cov is not symmetric",
    Credulous: "rest_is_not_identifiable: a record at rest",
    Careless: "wrong_arrays_are_refused: a count less",
    Stubborn: "reset_is_a_start: reset leaves",
    Trusting: "a_foreign_state_is_refused: a state of another dt raises no UsageError",
    Jumpy: "parts_are_the_whole: step",
    Silent: "rest_says_poor_excitation: the status",
    Fragile: "anything_leaves_numbers: theta",
    Drifting: "copies_fit_alike: copy.copy fits",
    Rounding: "counts_are_integers: a count of 7.9",
    Particular: "equality_is_of_the_configuration: samples",
    Shared: "the_kernels_own: the estimator moves with another one",
    Rough: "precisions_agree: float32",
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


@pytest.mark.parametrize("cls", [Mutable, Slanted, Stubborn, Rough])
def test_the_first_broken_promise_ends_the_checks_as_a_whole(cls) -> None:
    """The cases break the first check or the last one, off-line and on-line."""
    refused((re.escape(BROKEN[cls]), lambda: check_estimator(cls(*SETTINGS))), kind=ContractError)


@pytest.mark.parametrize("cls", [pmfid.LS, pmfid.RLS])
def test_what_they_derive_from_keeps_all(cls) -> None:
    check_estimator(cls(*SETTINGS))


@dataclass(frozen=True)
class Ridge(BatchEstimator):
    """A user's method: least squares, shrunk slightly towards zero."""

    method = "ridge"

    def _solve(self, columns):
        size = np.linalg.norm(columns.phi, axis=0)
        phi = columns.phi / size
        inverse = np.linalg.inv(phi.T @ phi + 1e-9 * np.eye(phi.shape[1]))
        return inverse @ (phi.T @ columns.z) / size, inverse / np.outer(size, size)


def test_an_estimator_of_ones_own() -> None:
    check_estimator(Ridge(*SETTINGS))


def test_a_record_of_ones_own_for_an_equation_that_nothing_simulates() -> None:
    terms = (pmfid.Term("output", 1, "drag"), pmfid.Term("direction", 0, "friction"))
    model = pmfid.EquationModel(pmfid.Equation(terms, (pmfid.Term("input"), pmfid.Term("output", 2, coefficient=-0.5))))
    run = cart_run(1)
    estimator = pmfid.RLS(model, run.encoder, 0.01, 30.0)
    refused(("give check_estimator a record", lambda: check_estimator(estimator)))
    names = [name for name, check in checks_of(estimator, (run.u, run.counts)) if not _fails(check)]
    assert {"copies_go_on_alone", "parts_are_the_whole", "anything_leaves_numbers"} <= set(names)


def _fails(check) -> bool:
    try:
        check()
    except ContractError:
        return True
    return False


@pytest.mark.parametrize("thing", [DRIVE, Estimator(*SETTINGS), None])
def test_what_is_no_estimator_is_refused(thing) -> None:
    refused(("needs an Estimator with fit", lambda: check_estimator(thing)))


def test_the_estimator_itself_stays_as_it_is() -> None:
    estimator, run = pmfid.BCRLS(*SETTINGS), cart_run(1)
    estimator.run(run.u, run.counts)
    before = estimator.get_state()
    check_estimator(estimator)
    assert estimator.get_state() == before

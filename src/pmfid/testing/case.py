"""What the checks look at: an estimator, and its result on records of its own model."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from pmfid._estimate import Estimate
from pmfid.errors import PmfidError, UsageError
from pmfid.estimators.arguments import check_arrays
from pmfid.estimators.base import Estimator
from pmfid.estimators.configuration import change_arguments, configuration_of
from pmfid.estimators.results import Fit
from pmfid.estimators.track import Track
from pmfid.testing.plants import ContractRecord, plant_for, wrap_record
from pmfid.types import Counts, Floats

#: Counts in a sample, by the order of size: with FINE the encoder does not matter, with COARSE it does.
FINE, COARSE = 5000.0, 5.0
#: Samples of a part that every method has enough of.
SHORT = 1000


T = TypeVar("T")


class Again(Protocol):
    """A way to copy an object."""

    def __call__(self, one: T, /) -> T: ...


def _repickle(one: T) -> T:
    again: T = pickle.loads(pickle.dumps(one))
    return again


COPIES: Mapping[str, Again] = {"copy.copy": copy.copy, "copy.deepcopy": copy.deepcopy, "pickle": _repickle}


class ContractError(PmfidError, AssertionError):
    """An estimator does not do what all of them owe; names the check and what was found."""


@runtime_checkable
class OffLine(Protocol):
    """An estimator over whole records."""

    def fit(self, u: ArrayLike, counts: ArrayLike) -> Fit: ...


@runtime_checkable
class OnLine(Protocol):
    """An estimator that runs sample by sample."""

    @property
    def estimate(self) -> Estimate: ...
    def step(self, u: float, counts: int) -> Estimate: ...
    def run(self, u: ArrayLike, counts: ArrayLike) -> Track: ...
    def reset(self) -> None: ...
    def get_state(self) -> bytes: ...
    def set_state(self, state: bytes) -> None: ...


@dataclass(frozen=True)
class Case:
    """estimator: at any point of its run, for its configuration is checked. record: (u, counts), None: simulated."""

    estimator: Estimator
    record: tuple[ArrayLike, ArrayLike] | None = None

    @cached_property
    def configured(self) -> Estimator:
        """The estimator at its start; without parameters to start from, which are those of the user's own plant."""
        foreign = self.record is None and "initial" in configuration_of(self.estimator)
        return change_arguments(self.estimator, {"initial": None} if foreign else {})

    @cached_property
    def fine(self) -> ContractRecord:
        """A record that determines all parameters."""
        return plant_for(self.configured, FINE, 1) if self.record is None else wrap_record(*check_arrays(*self.record))

    @cached_property
    def coarse(self) -> ContractRecord:
        """One with few counts in a sample; of another plant, in the encoder's view slower."""
        return plant_for(self.configured, COARSE, 2) if self.record is None else self.fine

    @cached_property
    def result(self) -> Fit | Track:
        """On the fine record."""
        return result_of(self.configured, self.fine.u, self.fine.counts)

    @cached_property
    def short_result(self) -> Fit | Track:
        """On its first part, where the bits alone matter."""
        return result_of(self.configured, *self.short)

    @property
    def short(self) -> tuple[Floats, Counts]:
        return self.fine.u[:SHORT], self.fine.counts[:SHORT]

    @cached_property
    def coarse_result(self) -> Fit | Track:
        """On the coarse record."""
        return result_of(self.endless, self.coarse.u, self.coarse.counts)

    @property
    def endless(self) -> Estimator:
        """The estimator at its start, without forgetting, where it has any."""
        taken, endless = configuration_of(self.configured), {"forgetting": 1.0, "forgetting_of": None}
        return change_arguments(self.configured, {name: value for name, value in endless.items() if name in taken})

    @property
    def theta(self) -> Floats:
        """(p,) on the fine record."""
        return last(self.result.theta)

    def start_estimator(self) -> OnLine:
        """The estimator at its start, to run. Raises UsageError if it does not run sample by sample."""
        fresh = replace(self.configured)
        if not isinstance(fresh, OnLine):
            raise UsageError(f"{name_of(fresh)} does not run sample by sample")
        return fresh


def result_of(estimator: Estimator, u: ArrayLike, counts: ArrayLike) -> Fit | Track:
    """What an estimator at its start makes of a record, of which it gets a copy."""
    return call(estimator, copy.deepcopy(u), copy.deepcopy(counts))


def call(estimator: Estimator, u: ArrayLike, counts: ArrayLike) -> Fit | Track:
    """The same with the arrays themselves."""
    fresh = replace(estimator)
    if isinstance(fresh, OffLine):
        return fresh.fit(u, counts)
    if isinstance(fresh, OnLine):
        return fresh.run(u, counts)
    raise UsageError(f"{name_of(estimator)} has neither fit nor step, run and state: see pmfid.testing")


def last(rows: Floats) -> Floats:
    """The last row of (n, p), or (p,) itself."""
    return np.asarray(np.atleast_2d(rows)[-1])


def name_of(estimator: Estimator) -> str:
    return estimator.method or type(estimator).__name__


def require(holds: bool, found: str) -> None:
    """Raises ContractError, saying what was found instead."""
    if not holds:
        raise ContractError(found)


def require_refusal(error: type[Exception], what: str, call: Callable[[], object]) -> None:
    """Raises ContractError unless the call raises just that."""
    try:
        call()
    except error:
        return
    except Exception as other:
        raise ContractError(f"{what} raises {type(other).__name__} ({other}), not {error.__name__}") from other
    raise ContractError(f"{what} is taken without {error.__name__}")

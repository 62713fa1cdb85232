"""Records on which the checks run estimators, and helpers of the checks."""

from __future__ import annotations

import copy
import math
import pickle
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from pmfid._estimate import Estimate
from pmfid.encoder import Encoder, quantize
from pmfid.errors import PmfidError, UsageError
from pmfid.estimators.base import Estimator
from pmfid.estimators.configuration import change_arguments, check_arrays, configuration_of
from pmfid.estimators.results import Fit, Track
from pmfid.models.drive import Model
from pmfid.models.equation import (
    COULOMB_BACKWARD,
    COULOMB_FORWARD,
    DEAD_TIME,
    ESTIMATE,
    MASS,
    OFFSET,
    STIFFNESS,
    VISCOUS_FORWARD,
)
from pmfid.models.transfer_function import TransferFunction
from pmfid.types import Counts, Floats

CASE_SAMPLES = 3000
#: Changes of the random input in the shortest record.
CASE_CHANGES = 250
#: Duration of an input step in time constants of the filters, for a drive and a process. The first number is also the
#: time constant of a drive.
DRIVE_HOLD = 3.0
PROCESS_HOLD = 0.8
#: Friction and load as fractions of the force, and the ratio of backward to forward friction.
CASE_COULOMB = 0.15
CASE_LOAD = 0.05
CASE_BACKWARD = 1.3
#: Natural frequency of a drive on a spring, as a fraction of the cutoff.
CASE_SPRING = 0.2
#: Frequencies of a process's poles, their damping, and its zeros. Frequencies and zeros are fractions of the
#: cutoff.
CASE_FREQUENCIES = (0.5, 0.2, 0.8)
CASE_DAMPING = 0.5
CASE_ZEROS = -1.5
#: An unknown dead time [samples].
CASE_LATE = 2.5
#: Standard deviation of a process, as a multiple of a drive's motion in a sample.
CASE_RANGE = 100.0
#: Counts in a sample, roughly. The encoder has no effect at `CASE_FINE` and a visible one at `CASE_COARSE`.
CASE_FINE = 5000.0
CASE_COARSE = 5.0
#: Samples that are enough for every method, and samples before a copy or a saved state.
CASE_SHORT = 1000

Scalar = TypeVar("Scalar", bound=np.generic)


@dataclass(frozen=True)
class ContractRecord:
    """A record u, counts (n,) and its true parameters theta (p,), which are None if unknown."""

    u: Floats
    counts: Counts
    theta: Floats | None


def wrap_record(u: Floats, counts: Counts) -> ContractRecord:
    """Return the caller's record as a `ContractRecord`."""
    return ContractRecord(_freeze(u), _freeze(counts), None)


def plant_for(estimator: Estimator, per_sample: float, seed: int) -> ContractRecord:
    """Simulate a record of the estimator's model. A drive moves about `per_sample` counts in a sample.

    Raises UsageError if the model cannot be simulated.
    """
    seen = min(per_sample, _most(estimator.encoder, estimator.dt))
    return _plant(RecordSetting(estimator.model, estimator.encoder, estimator.dt, estimator.cutoff, seen), seed)


@lru_cache
def _plant(setting: RecordSetting, seed: int) -> ContractRecord:
    model, rng = setting.model, np.random.default_rng(seed)
    if isinstance(model, TransferFunction):
        return _process(setting, model, rng)
    # A shaped force may bend at speeds and places that a simulated motion does not reach.
    missing = model.equation.without_simulation or ("its forces of a given form" if model.equation.shaped else "")
    if missing:
        raise UsageError(f"no record can be simulated: {missing}; give check_estimator a record (u, counts)")
    return _drive(setting, rng)


@dataclass(frozen=True)
class RecordSetting:
    """The settings of a simulated record; `per_sample` is the motion of a drive in a sample [counts]."""

    model: Model
    encoder: Encoder
    dt: float
    cutoff: float
    per_sample: float


def _most(encoder: Encoder, dt: float) -> float:
    """Return a quarter of the encoder's greatest speed [counts per sample], at most a sixteenth of its range."""
    speed = math.inf if encoder.max_speed is None else 0.25 * encoder.max_speed * dt / encoder.resolution
    return min(speed, 2.0 ** (encoder.bits - 4))


def _freeze(array: NDArray[Scalar]) -> NDArray[Scalar]:
    copy = array.copy()
    copy.setflags(write=False)
    return copy


def _input(setting: RecordSetting, hold: float, rng: np.random.Generator) -> Floats:
    """Return random input steps of four sizes, each held for `hold` time constants of the filters."""
    samples = max(1, round(hold / (setting.cutoff * setting.dt)))
    changes = max(CASE_CHANGES, -(-CASE_SAMPLES // samples))
    return rng.choice([-1.0, -0.6, 0.6, 1.0], changes).repeat(samples)


def _drive(setting: RecordSetting, rng: np.random.Generator) -> ContractRecord:
    from pmfid import _kernel64

    equation, cutoff = setting.model.equation, setting.cutoff
    resolution, dt, force = setting.encoder.resolution, setting.dt, abs(equation.input_gain)
    u = _input(setting, DRIVE_HOLD, rng)
    viscous = force * dt / (setting.per_sample * resolution)  # the steady speed is per_sample counts in a sample
    mass = viscous * DRIVE_HOLD / cutoff
    roles = np.zeros(len(equation.roles))
    roles[MASS], roles[OFFSET] = mass, CASE_LOAD * force
    roles[VISCOUS_FORWARD : VISCOUS_FORWARD + 2], roles[COULOMB_FORWARD : COULOMB_FORWARD + 2] = (
        viscous,
        CASE_COULOMB * force,
    )
    if equation.symmetric is not equation:  # otherwise the directions share friction and load
        roles[COULOMB_BACKWARD] *= CASE_BACKWARD
        roles[OFFSET] = 0.0
    roles[STIFFNESS] = mass * (CASE_SPRING * cutoff) ** 2
    present = np.array([index is not None for index in equation.roles])
    velocity = _kernel64.simulate(list(np.where(present, roles, 0.0)), equation.input_gain, dt, u)[0]
    y = np.r_[0.0, np.cumsum(velocity[:-1])] * dt
    theta = np.zeros(len(equation.names))
    for index, value in zip(equation.roles, roles, strict=True):
        if index is not None:
            theta[index] = value
    return ContractRecord(_freeze(u), _freeze(quantize(y, resolution)), theta)


def _process(setting: RecordSetting, model: TransferFunction, rng: np.random.Generator) -> ContractRecord:
    u = _input(setting, PROCESS_HOLD, rng)
    denominator = _denominator(model, setting.cutoff)
    numerator = np.atleast_1d(np.poly(CASE_ZEROS * setting.cutoff * np.arange(1, model.m + 1)))
    late = CASE_LATE * setting.dt if model.dead_time == ESTIMATE else float(model.dead_time) + model.delay * setting.dt
    y = _respond(numerator, denominator, u, setting.dt, late / setting.dt)
    scale = CASE_RANGE * setting.per_sample * setting.encoder.resolution / float(np.std(y))
    values = {f"a{i}": value for i, value in enumerate(denominator[::-1])}
    values |= {f"b{j}": scale * value for j, value in enumerate(numerator[::-1])}
    values[DEAD_TIME] = late
    names = (*model.equation.names, *dict(model.equation.further))
    theta = np.array([values.get(name, 0.0) for name in names])
    return ContractRecord(_freeze(u), _freeze(quantize(scale * y, setting.encoder.resolution)), theta)


def _denominator(model: TransferFunction, cutoff: float) -> Floats:
    """Return the coefficients in descending powers, with damped pairs of poles and poles at zero."""
    left = model.n - model.integrators
    coefficients: Floats = np.ones(1)
    for part in CASE_FREQUENCIES:
        pole = part * cutoff
        factors = {0: [1.0], 1: [1.0, pole]}
        coefficients = np.convolve(coefficients, factors.get(left, [1.0, 2 * CASE_DAMPING * pole, pole**2]))
        left = max(0, left - 2)
    return np.asarray(np.r_[coefficients, np.zeros(model.integrators)])


def _respond(numerator: Floats, denominator: Floats, u: Floats, dt: float, late: float) -> Floats:
    """Return the exact output (n,) from rest under a held input that arrives `late` samples late."""
    n, whole, part = denominator.size - 1, int(late), late - int(late)
    b = np.r_[numerator[::-1], np.zeros(n + 1 - numerator.size)]
    C = b[:n] - b[n] * denominator[:0:-1]
    A = np.zeros((n + 1, n + 1))  # the last state is the input
    A[: n - 1, 1:n], A[n - 1, :n], A[n - 1, n] = np.eye(n - 1), -denominator[:0:-1], 1.0
    before, after = expm(A * part * dt)[:n], expm(A * (1 - part) * dt)[:n]
    delayed = np.r_[np.zeros(whole + 1), u]
    x, y = np.zeros(n), np.empty(u.size)
    for k in range(u.size):
        y[k] = C @ x + b[n] * delayed[k if part else k + 1]
        x = after @ np.r_[before @ np.r_[x, delayed[k]], delayed[k + 1]]
    return y


T = TypeVar("T")


class Again(Protocol):
    """A function that copies an object."""

    def __call__(self, one: T, /) -> T: ...


COPIES: Mapping[str, Again] = {
    "copy.copy": copy.copy,
    "copy.deepcopy": copy.deepcopy,
    "pickle": lambda one: pickle.loads(pickle.dumps(one)),
}


class ContractError(PmfidError, AssertionError):
    """The error of an estimator that breaks the contract. Its message names the check and the finding.

    The class is also an AssertionError.

    Examples
    --------
    >>> from pmfid.testing import ContractError
    >>> issubclass(ContractError, AssertionError)
    True
    """


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
    """An estimator under test with its records. The estimator may have run, because only its configuration is checked.

    `record` is (u, counts). Without it the record is simulated.
    """

    estimator: Estimator
    record: tuple[ArrayLike, ArrayLike] | None = None

    @cached_property
    def configured(self) -> Estimator:
        """The estimator at its start. On a simulated record the caller's start values are removed."""
        foreign = self.record is None and "initial" in configuration_of(self.estimator)
        return change_arguments(self.estimator, {"initial": None} if foreign else {})

    @cached_property
    def fine(self) -> ContractRecord:
        """A record that determines all parameters."""
        return (
            plant_for(self.configured, CASE_FINE, 1)
            if self.record is None
            else wrap_record(*check_arrays(*self.record))
        )

    @cached_property
    def coarse(self) -> ContractRecord:
        """A record of a slower plant, with few counts in a sample."""
        return plant_for(self.configured, CASE_COARSE, 2) if self.record is None else self.fine

    @cached_property
    def result(self) -> Fit | Track:
        """The result on the fine record."""
        return result_of(self.configured, self.fine.u, self.fine.counts)

    @cached_property
    def short_result(self) -> Fit | Track:
        """The result on the first part of the fine record, for checks that compare bits."""
        return result_of(self.configured, *self.short)

    @property
    def short(self) -> tuple[Floats, Counts]:
        return self.fine.u[:CASE_SHORT], self.fine.counts[:CASE_SHORT]

    @cached_property
    def coarse_result(self) -> Fit | Track:
        """The result on the coarse record."""
        return result_of(self.endless, self.coarse.u, self.coarse.counts)

    @property
    def endless(self) -> Estimator:
        """The estimator at its start, without forgetting."""
        takes = "forgetting" in configuration_of(self.configured)
        return change_arguments(self.configured, {"forgetting": 1.0} if takes else {})

    @property
    def theta(self) -> Floats:
        """The estimated parameters (p,) on the fine record."""
        return last(self.result.theta)

    def start_estimator(self) -> OnLine:
        """Return the estimator at its start, ready to run. Raises UsageError if it does not run sample by sample."""
        fresh = replace(self.configured)
        if not isinstance(fresh, OnLine):
            raise UsageError(f"{name_of(fresh)} does not run sample by sample")
        return fresh


def result_of(estimator: Estimator, u: ArrayLike, counts: ArrayLike) -> Fit | Track:
    """Run an estimator from its start on a copy of a record, and return the result."""
    return call(estimator, copy.deepcopy(u), copy.deepcopy(counts))


def call(estimator: Estimator, u: ArrayLike, counts: ArrayLike) -> Fit | Track:
    """Run an estimator from its start on the arrays themselves, and return the result."""
    fresh = replace(estimator)
    if isinstance(fresh, OffLine):
        return fresh.fit(u, counts)
    if isinstance(fresh, OnLine):
        return fresh.run(u, counts)
    raise UsageError(f"{name_of(estimator)} has neither fit nor step, run and state: see pmfid.testing")


def last(rows: Floats) -> Floats:
    """Return the last row of (n, p), or a vector (p,) itself."""
    return np.asarray(np.atleast_2d(rows)[-1])


def name_of(estimator: Estimator) -> str:
    return estimator.method or type(estimator).__name__


def require(holds: bool, found: str) -> None:
    """Raise ContractError with the finding unless the condition holds."""
    if not holds:
        raise ContractError(found)


def require_refusal(error: type[Exception], what: str, call: Callable[[], object]) -> None:
    """Raise ContractError unless the call raises the given error."""
    try:
        call()
    except error:
        return
    except Exception as other:
        raise ContractError(f"{what} raises {type(other).__name__} ({other}), not {error.__name__}") from other
    raise ContractError(f"{what} raises no {error.__name__}")

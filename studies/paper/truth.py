"""Common parts of the studies of accuracy: the cart's truth, an estimate of a record, the Cramér-Rao bound, a table."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmfid.diagnostics.verdict import verdict
from pmfid.encoder import Encoder
from pmfid.errors import NotIdentifiableError
from pmfid.estimators.base import Estimator
from pmfid.estimators.batch import BatchEstimator
from pmfid.estimators.configuration import construct_estimator
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.registry import ESTIMATORS
from pmfid.estimators.results import Track
from pmfid.findings import codes
from pmfid.models.drive import Drive
from pmfid.simulation import CART, CART_DT, make_scenario
from pmfid.status import Status
from pmfid.types import Flags, Floats

#: The arguments of one work, and the results by task; each study knows their types.
Task = tuple[Any, ...]
Results = Mapping[Task, Any]

NAMES = ("mass", "viscous_friction", "coulomb_friction")
TRUTH = np.array([CART.mass, CART.viscous_friction, CART.coulomb_friction])
#: Filter time constant in samples, unless a table says otherwise.
TIME_CONSTANT = 3
#: Methods that simulate the whole record many times; they get fewer seeds.
SLOW = tuple(name for name in ("fit",) if name in ESTIMATORS)
NOT_VOUCHED = Status.STARTING | Status.SETTLING | Status.FALLBACK | Status.POOR_EXCITATION | Status.UNMODELLED
#: Relative step of the central differences for the bound.
STEP = 1e-4


@dataclass(frozen=True)
class Study:
    """One section of the page.

    `tasks` returns the tasks for a number of seeds, and `work` computes one of them in a separate process. `write`
    returns the section's lines from the number of seeds and the results by task.
    """

    name: str
    tasks: Callable[[int], list[Task]]
    work: Callable[..., object]
    write: Callable[[int, Results], list[str]]


@dataclass(frozen=True, eq=False)
class CartRecord:
    """Input u [V] and counts, each (n,); resolution [m per count]."""

    u: Floats
    counts: NDArray[np.int64]
    resolution: float


@dataclass(frozen=True, eq=False)
class Outcome:
    """One estimate.

    theta and std are (3,), nan without an estimate; then `failure` gives the reason. The status bits are those of the
    whole record or of the last sample. `relative_error` belongs to an off-line fit. The flags come from `verdict`, or
    are ().
    """

    theta: Floats
    std: Floats
    status: int = 0
    relative_error: float = np.nan
    failure: str = ""
    flags: tuple[str, ...] = ()


def scenario_record(name: str, seed: int, increments: int) -> CartRecord:
    """Return a scenario of 30 s as a record."""
    scenario = make_scenario(name, seed=seed, increments=increments)
    return CartRecord(scenario.motion.u, scenario.counts, scenario.resolution)


def make_estimator(
    method: str,
    record: CartRecord,
    time_constant: float = TIME_CONSTANT,
    input_gain: float = CART.input_gain,
    **options: object,
) -> Estimator:
    """Return the method on the cart's model; `time_constant` of the filters is in samples."""
    cutoff = 1 / (time_constant * CART_DT)
    own = {"model": Drive(input_gain), "encoder": Encoder(record.resolution), "dt": CART_DT, "cutoff": cutoff}
    return construct_estimator(ESTIMATORS[method], own | options)


def track_of(
    method: str,
    record: CartRecord,
    time_constant: float = TIME_CONSTANT,
    input_gain: float = CART.input_gain,
    **options: object,
) -> Track:
    """Return the estimates of a recursive method over a record."""
    estimator = make_estimator(method, record, time_constant, input_gain, **options)
    if not isinstance(estimator, RecursiveEstimator):
        raise TypeError(f"{method} is not recursive")
    return estimator.run(record.u, record.counts)


def estimate(
    method: str,
    record: CartRecord,
    time_constant: float = TIME_CONSTANT,
    input_gain: float = CART.input_gain,
    *,
    judged: bool = False,
    **options: object,
) -> Outcome:
    """Return the estimate after the whole record; a recursive method gives its last value.

    `judged` includes the flags. A method without an estimate, or with an error of linear algebra, also gives an
    outcome.
    """
    estimator = make_estimator(method, record, time_constant, input_gain, **options)
    try:
        outcome = _last(estimator, record)
    except (NotIdentifiableError, np.linalg.LinAlgError) as error:
        return _without(type(error).__name__)
    return replace(outcome, flags=_flags(estimator, record, outcome)) if judged and not outcome.failure else outcome


def _flags(estimator: Estimator, record: CartRecord, outcome: Outcome) -> tuple[str, ...]:
    try:
        return codes(verdict(estimator, record.u, record.counts, outcome.theta, outcome.std, 0.01).judged)
    except (NotIdentifiableError, np.linalg.LinAlgError) as error:
        return (f"verdict: {type(error).__name__}",)


def _without(failure: str, status: int = 0) -> Outcome:
    return Outcome(np.full(3, np.nan), np.full(3, np.nan), status, failure=failure)


def _last(estimator: Estimator, record: CartRecord) -> Outcome:
    if isinstance(estimator, BatchEstimator):
        fit = estimator.fit(record.u, record.counts)
        return Outcome(fit.theta, fit.theta_std, fit.status, fit.relative_error)
    if not isinstance(estimator, RecursiveEstimator):
        raise TypeError(f"{estimator.method} is neither off-line nor recursive")
    track = estimator.run(record.u, record.counts)
    status = int(track.status[-1])
    if status & Status.STARTING:
        return _without("still starting", status)
    return Outcome(track.theta[-1], track.theta_std[-1], status)


def percent(theta: Floats) -> Floats:
    """Return the errors in percent of the truth; theta is (..., 3)."""
    return np.asarray(100 * (theta / TRUTH - 1))


def vouched(track: Track) -> Flags:
    """Return the samples (n,) without a status bit that warns of the estimate as a whole."""
    return np.asarray((track.status & NOT_VOUCHED) == 0)


def positions(u: Floats, theta: Floats, v0: float) -> Floats:
    """Return positions (n,) [m] from x = 0 under u (n,), from the kernel's own simulation with stiction."""
    from pmfid import _kernel64

    mass, viscous, coulomb = theta.tolist()
    roles = [mass, viscous, viscous, coulomb, coulomb, 0.0, 0.0]
    mean_velocity = _kernel64.simulate(roles, CART.input_gain, CART_DT, u, v0)[0]
    return np.asarray(np.r_[0.0, np.cumsum(mean_velocity[:-1]) * CART_DT])


def cramer_rao(u: Floats, resolution: float) -> Floats:
    """Return the least variances (3,) of unbiased estimates under u (n,), with an unknown start x0, v0.

    The noise is white, with variance resolution^2/12 on every position (Ljung 1999, section 7.4).
    """
    columns = [np.ones_like(u)]
    for j, size in enumerate(STEP * np.r_[TRUTH, 1.0]):
        step = size * np.eye(4)[j]
        above, below = (positions(u, TRUTH + sign * step[:3], sign * float(step[3])) for sign in (1.0, -1.0))
        columns.append((above - below) / (2 * size))
    sensitivity = np.column_stack(columns)
    fisher = sensitivity.T @ sensitivity / (resolution**2 / 12)
    return np.asarray(np.diagonal(np.linalg.inv(fisher))[1:4])


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return a Markdown table, and the empty line after it."""
    lines = ["| " + " | ".join(cells) + " |" for cells in (header, *rows)]
    return [lines[0], "|" + "---|" * len(header), *lines[1:], ""]


def triple(values: Floats, digits: Sequence[int] = (2, 2, 2), sign: str = "+") -> str:
    """Return three numbers, of mass, viscous and Coulomb friction, as one cell."""
    return ", ".join(f"{value:{sign}.{n}f}" for value, n in zip(values, digits, strict=True))


def tally(names: Sequence[Sequence[str]]) -> str:
    """Return how often each name occurs in the runs: "feedback 3/5"."""
    every = [name for run in names for name in run]
    return ", ".join(f"{name} {every.count(name)}/{len(names)}" for name in sorted(set(every))) or "–"

"""The contract that every estimator keeps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from pmfid._estimate import Estimate
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.base import Estimator
from pmfid.estimators.fleet import Fleet
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.results import Fit
from pmfid.status import Status
from pmfid.testing import common
from pmfid.testing.case import (
    CASE_SHORT,
    COPIES,
    Case,
    ContractError,
    OffLine,
    OnLine,
    last,
    name_of,
    require,
    require_refusal,
    result_of,
)
from pmfid.testing.common import OTHER_DT
from pmfid.types import Counts, Floats

CONTRACT_SYMMETRIC = 1e-9
#: Samples after a copy or a saved state.
CONTRACT_AFTER = 400
#: Greatest relative difference between the two precisions.
CONTRACT_SINGLE = 2e-3
HOSTILE_SAMPLES = 20_000


def copies_fit_alike(case: Case) -> None:
    """Check that all copies of an estimator give the same bits, also if the estimator has run."""
    worker, expected = case.configured, case.short_result.theta
    for name, again in COPIES.items():
        found = result_of(again(worker), *case.short).theta
        require(np.array_equal(found, expected), f"{name} fits other numbers")


def rest_is_not_identifiable(case: Case) -> None:
    """Check that an output at rest raises NotIdentifiableError."""
    n = case.fine.u.size
    still = np.zeros(n, np.int64)
    require_refusal(NotIdentifiableError, "a record at rest", lambda: result_of(case.configured, np.ones(n), still))


def covariance_is_one(case: Case) -> None:
    """Check that the covariance is symmetric and positive definite, and the residual smaller than the target."""
    fit = case.coarse_result
    if not isinstance(fit, Fit):
        raise ContractError(f"fit gives a {type(fit).__name__}, not a Fit")
    correlation = fit.theta_cov / np.outer(fit.theta_std, fit.theta_std)
    require(bool(np.max(np.abs(correlation - correlation.T)) < CONTRACT_SYMMETRIC), "theta_cov is not symmetric")
    require(bool(np.all(np.linalg.eigvalsh(correlation) > 0)), "theta_cov is not positive definite")
    require(0 <= fit.relative_error < 1, f"relative_error is {fit.relative_error}")


HOSTILE = (0.0, 3.0, -3.0, np.nan, np.inf, -np.inf, 1e30, -1e30, 1e-40)


def copies_go_on_alone(case: Case) -> None:
    """Check that a copy of a running estimator continues with the same bits, and that the original stays."""
    u, counts = _later(case)
    for name, again in COPIES.items():
        estimator = _run_some(case)
        before, other = estimator.get_state(), again(estimator)
        moved = _bits(other, u, counts)
        require(estimator.get_state() == before, f"the original moves with its {name}")
        require(_bits(estimator, u, counts) == moved, f"{name} goes on with other bits")


def equality_is_of_the_configuration(case: Case) -> None:
    """Check that samples change neither the equality nor the hash, so that a running estimator can be a key."""
    begun: object = _run_some(case)
    require(begun == case.configured, "samples make it another configuration")
    require(hash(begun) == hash(case.configured), "samples change the hash")


def parts_are_the_whole(case: Case) -> None:
    """Check that a run in two parts has the bits of the whole run. The second part starts from a saved state."""
    u, counts = _later(case)
    whole = case.start_estimator().run(
        case.fine.u[: CASE_SHORT + CONTRACT_AFTER],
        case.fine.counts[: CASE_SHORT + CONTRACT_AFTER],
    )
    resumed = case.start_estimator()
    resumed.set_state(_run_some(case).get_state())
    stepped = [resumed.step(float(value), int(count)).theta for value, count in zip(u, counts, strict=True)]
    require(
        np.array_equal(np.array(stepped), whole.theta[CASE_SHORT:]),
        "step from a saved state has other bits than run",
    )
    require(np.array_equal(resumed.estimate.theta, stepped[-1]), "estimate is not the one of the last step")


def reset_is_a_start(case: Case) -> None:
    estimator = _run_some(case)
    estimator.reset()
    require(estimator.get_state() == case.start_estimator().get_state(), "reset leaves something of the samples")


def a_foreign_state_is_refused(case: Case) -> None:
    """Check that a foreign, damaged or empty state is refused with a UsageError and leaves no trace."""
    estimator = _run_some(case)
    before = estimator.get_state()
    other = Case(replace(case.configured, dt=OTHER_DT * case.configured.dt)).start_estimator()
    damaged = before[:-1] + bytes([before[-1] ^ 1])
    for what, state in (("of another dt", other.get_state()), ("that is damaged", damaged), ("of no bytes", b"")):
        require_refusal(UsageError, f"a state {what}", partial(estimator.set_state, state))
    require(estimator.get_state() == before, "a refused state leaves a trace")


def counts_are_integers(case: Case) -> None:
    require_refusal(TypeError, "a count of 7.9", lambda: case.start_estimator().step(1.0, 7.9))  # type: ignore[arg-type]


def rest_says_poor_excitation(case: Case) -> None:
    """Check that an axis at rest gives finite numbers and a status that reports no information."""
    n = 2 * case.fine.u.size // 3
    track = case.start_estimator().run(np.zeros(n), np.zeros(n, np.int64))
    require(bool(np.all(np.isfinite(track.theta))), "theta is not finite at rest")
    flagged = track.has_status(Status.POOR_EXCITATION) | track.has_status(Status.STARTING)
    require(bool(np.all(flagged[-n // 2 :])), "the status says neither poor excitation nor starting")


def anything_leaves_numbers(case: Case) -> None:
    """Check that extreme inputs, NaN and jumping counts leave theta finite and no standard error NaN."""
    rng = np.random.default_rng(9)
    u = rng.choice(HOSTILE, HOSTILE_SAMPLES)
    track = case.start_estimator().run(u, rng.integers(-(2**31), 2**31, HOSTILE_SAMPLES))
    require(bool(np.all(np.isfinite(track.theta))), "theta is not finite")
    require(not np.any(np.isnan(track.theta_std)), "theta_std is NaN")


def precisions_agree(case: Case) -> None:
    double, single = (
        last(result_of(replace(case.configured, precision=precision), case.fine.u, case.fine.counts).theta)
        for precision in ("float64", "float32")
    )
    size = np.maximum(np.abs(double), CONTRACT_SINGLE * np.max(np.abs(double)))
    require(
        bool(np.all(np.abs(single - double) < CONTRACT_SINGLE * size)),
        f"float32 finds {single}, float64 {double}",
    )


def the_kernels_own(case: Case) -> None:
    """Check the class of an estimate, independent estimators with one configuration, and axes side by side."""
    estimator = _run_some(case)
    if not isinstance(estimator, RecursiveEstimator):
        return
    require(isinstance(estimator.estimate, Estimate), "the estimate is no pmfid.Estimate")
    before, (u, counts) = estimator.get_state(), _later(case)
    other = estimator.start(before)
    moved, many = _bits(other, u, counts), Fleet(estimator, 1, workers=1).run(u, counts[None])
    require(estimator.get_state() == before, "the estimator moves with another one or a fleet")
    require(np.array_equal(many.theta[0, -1], other.estimate.theta), "a fleet has other bits")
    require(_bits(estimator, u, counts) == moved, "an estimator from a saved state has other bits")


def _run_some(case: Case) -> OnLine:
    """Return the estimator after `CASE_SHORT` samples."""
    estimator = case.start_estimator()
    estimator.run(case.fine.u[:CASE_SHORT], case.fine.counts[:CASE_SHORT])
    return estimator


def _later(case: Case) -> tuple[Floats, Counts]:
    """Return the samples that follow the first `CASE_SHORT`."""
    part = slice(CASE_SHORT, CASE_SHORT + CONTRACT_AFTER)
    return case.fine.u[part], case.fine.counts[part]


def _bits(estimator: OnLine, u: Floats, counts: Counts) -> bytes:
    """Return the bits of the results of a run, and of the state after the run."""
    track = estimator.run(u, counts)
    return b"".join((track.theta.tobytes(), track.theta_std.tobytes(), track.status.tobytes(), estimator.get_state()))


Check = Callable[[Case], None]


def _list_checks(*checks: Check) -> dict[str, Check]:
    return {check.__name__: check for check in checks}


COMMON = _list_checks(
    common.configuration_is_a_value,
    common.wrong_arguments_are_refused,
    common.wrong_arrays_are_refused,
    common.names_are_of_the_parameters,
    common.inputs_stay_untouched,
    common.finds_the_truth,
    common.more_data_make_shorter_error_bars,
    common.mirrors,
    common.scales_with_the_units,
)
OFF_LINE = _list_checks(copies_fit_alike, rest_is_not_identifiable, covariance_is_one)
ON_LINE = _list_checks(
    copies_go_on_alone,
    equality_is_of_the_configuration,
    parts_are_the_whole,
    reset_is_a_start,
    a_foreign_state_is_refused,
    counts_are_integers,
    rest_says_poor_excitation,
    anything_leaves_numbers,
    precisions_agree,
    the_kernels_own,
)


def checks_of(
    estimator: Estimator, record: tuple[ArrayLike, ArrayLike] | None = None
) -> list[tuple[str, Callable[[], None]]]:
    """Return the checks of an estimator, each with its name.

    The checks share their intermediate results.

    Parameters
    ----------
    estimator, record
        The arguments of `check_estimator`.

    Returns
    -------
    list of tuple
        Pairs (name, check). A check takes no argument and raises `ContractError`.

    Raises
    ------
    UsageError
        The cases of `check_estimator`.

    Examples
    --------
    >>> import pmfid
    >>> from pmfid.testing import checks_of
    >>> ls = pmfid.LS(pmfid.Drive(2.0), pmfid.Encoder(1e-5), dt=0.01, cutoff=30.0)
    >>> checks = dict(checks_of(ls))
    >>> checks["configuration_is_a_value"]()
    """
    if not isinstance(estimator, Estimator) or not isinstance(estimator, OffLine | OnLine):
        raise UsageError(
            "check_estimator needs an Estimator with fit, or with step, run and state, got "
            f"{type(estimator).__name__}; derive it from BatchEstimator or RecursiveEstimator"
        )
    case = Case(estimator, record)
    own = OFF_LINE if isinstance(estimator, OffLine) else ON_LINE
    return [(name, partial(_run, name, check, case)) for name, check in (COMMON | own).items()]


def check_estimator(estimator: Estimator, record: tuple[ArrayLike, ArrayLike] | None = None) -> None:
    """Check an estimator against the contract of all estimators of pmfid, in some seconds.

    Parameters
    ----------
    estimator
        An estimator with any configuration. It may have run, and does not change.
    record
        Arrays u and counts (n,), n >= 1400, in place of a simulated record. The true parameters are then unknown and
        not compared.

    Raises
    ------
    ContractError
        If a check fails. The message names the first failed check and the finding. The error is an AssertionError.
    UsageError
        If the object is no estimator, or if the equation cannot be simulated and no record is given.

    Notes
    -----
    The contract of all estimators:

    - The configuration is a value (frozen, `==`, `hash`). The constructor refuses errors with a UsageError.
    - Arrays and lists are only read.
    - Copies by `copy.copy`, `copy.deepcopy` and `pickle` give the same bits and share nothing.
    - Parameters have names and units.
    - On a record of its own model the estimator finds the parameters within 10 %. Other units and reversed signs give
      the same accuracy. More data give smaller standard errors.

    An estimator over whole records refuses rest as not identifiable, and its covariance is positive definite. For an
    estimator that runs sample by sample, steps, parts and saved states give the bits of one run. Foreign states are
    refused. Rest and hostile input leave finite numbers and a status. Results in float32 are close to those in float64.

    Examples
    --------
    >>> import pmfid
    >>> from pmfid.testing import check_estimator
    >>> check_estimator(pmfid.LS(pmfid.Drive(2.0), pmfid.Encoder(1e-5), dt=0.01, cutoff=30.0))
    """
    for _, check in checks_of(estimator, record):
        check()


def _run(name: str, check: Check, case: Case) -> None:
    try:
        check(case)
    except ContractError as error:
        raise ContractError(f"{name_of(case.estimator)}, {name}: {error}") from error.__cause__

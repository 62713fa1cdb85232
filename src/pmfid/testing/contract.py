"""The checks by name, and the one that runs them all."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from numpy.typing import ArrayLike

from pmfid.errors import UsageError
from pmfid.estimators.base import Estimator
from pmfid.testing import common, off_line, on_line
from pmfid.testing.case import Case, ContractError, OffLine, OnLine, name_of

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
    common.mirrored,
    common.scales_with_the_units,
)
OFF_LINE = _list_checks(off_line.copies_fit_alike, off_line.rest_is_not_identifiable, off_line.covariance_is_one)
ON_LINE = _list_checks(
    on_line.copies_go_on_alone,
    on_line.equality_is_of_the_configuration,
    on_line.parts_are_the_whole,
    on_line.reset_is_a_start,
    on_line.a_foreign_state_is_refused,
    on_line.counts_are_integers,
    on_line.rest_says_poor_excitation,
    on_line.anything_leaves_numbers,
    on_line.precisions_agree,
    on_line.the_kernels_own,
)


def checks_of(
    estimator: Estimator, record: tuple[ArrayLike, ArrayLike] | None = None
) -> list[tuple[str, Callable[[], None]]]:
    """The checks of an estimator, each with its name; arguments and errors of `check_estimator`. They share what they
    compute."""
    if not isinstance(estimator, Estimator) or not isinstance(estimator, OffLine | OnLine):
        raise UsageError(
            f"check_estimator takes an Estimator that has fit, or step, run and state, got {type(estimator).__name__}; "
            "derive it from BatchEstimator or RecursiveEstimator"
        )
    case = Case(estimator, record)
    own = OFF_LINE if isinstance(estimator, OffLine) else ON_LINE
    return [(name, partial(_run, name, check, case)) for name, check in (COMMON | own).items()]


def check_estimator(estimator: Estimator, record: tuple[ArrayLike, ArrayLike] | None = None) -> None:
    """Checks an estimator against the contract of all estimators of pmfid, in some seconds.

    Whatever the method: the configuration is a value (frozen, `==`, `hash`), and errors in it are refused at
    construction with a UsageError; arrays are only read, in any form; copies by `copy.copy`, `copy.deepcopy` and
    `pickle` give the same bits and share nothing; parameters have names and units; on a record of its own model it
    finds the parameters within 10 %, does the same in other units and with both signs reversed, and more data make
    smaller standard errors. Over whole records: rest is not identifiable, the covariance is one. Sample by sample: a
    run in parts, by steps or from a saved state has the bits of the whole; foreign states are refused; rest and hostile
    input leave finite numbers and a status; float32 is near float64.

    estimator: of any configuration, also one that has run; it stays as it is. record: u and counts, (n,) each with
    n >= 1400, in place of a simulated one; then the truth is not known and not asked for.
    Raises ContractError, an AssertionError, for the first check that fails, with its name and what was found;
    UsageError for an object that is no estimator, and without a record for an equation that cannot be simulated.
    """
    for _, check in checks_of(estimator, record):
        check()


def _run(name: str, check: Check, case: Case) -> None:
    try:
        check(case)
    except ContractError as error:
        raise ContractError(f"{name_of(case.estimator)}, {name}: {error}") from error.__cause__

"""Prior information from the keys `given` and `prior` of [estimator], and from input_gain = "estimate"."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from typing import TypeVar

from pmfid.config.axis import Axis
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.base import Estimator
from pmfid.estimators.facts import INPUT_GAIN
from pmfid.estimators.known import Known, Posterior, with_gain
from pmfid.findings import Finding, advise, make_notes
from pmfid.models.equation import ESTIMATE
from pmfid.pipeline.result import DriveResult
from pmfid.pipeline.stored import Stored

Found = TypeVar("Found")
#: Status word if a known value and the record contradict each other.
CONTRADICTED = "prior_contradicted"
CONTRADICTED_REMEDY = "check the given values, their units, input_gain and the model, or leave one of the values out"


def finds_gain(axis: Axis) -> bool:
    """Return whether the input gain is an unknown parameter."""
    return axis.model.input_gain == ESTIMATE


def set_gain(axis: Axis, gain: float) -> Axis:
    """Return a copy of the axis with another input gain."""
    return axis.model_copy(update={"model": axis.model.model_copy(update={INPUT_GAIN: gain})})


def set_any_gain(axis: Axis) -> Axis:
    """Return the axis with some number as input gain, for uses that do not depend on its value."""
    return set_gain(axis, 1.0) if finds_gain(axis) else axis


def set_stored_gain(axis: Axis, stored: Stored) -> Axis:
    """Return the axis with the input gain of a file's parameters if the gain was estimated.

    Raises UsageError if the file has no input gain.
    """
    if not finds_gain(axis):
        return axis
    if stored.input_gain is None:
        raise UsageError(
            f"{stored.source}: the result has no input_gain, and [model] gives none; write a number as "
            "[model] input_gain"
        )
    return set_gain(axis, stored.input_gain)


def try_both_signs(axis: Axis, identified: Callable[[Axis], Found]) -> Found:
    """Return the result of `identified` on an axis with a number as input gain.

    An unknown gain may have either sign. With the wrong sign, no model follows the record. Raises the errors of
    `identified`.
    """
    if not finds_gain(axis):
        return identified(axis)
    try:
        return identified(set_gain(axis, 1.0))
    except NotIdentifiableError as error:
        with suppress(NotIdentifiableError):
            return identified(set_gain(axis, -1.0))
        raise error from None


def known_of(axis: Axis, estimator: Estimator) -> Known | None:
    """Return the prior information of [estimator] on the parameters of a method, or None without any.

    The function ignores information on parameters that the method does not have. Raises UsageError if no remaining
    information determines the gain.
    """
    config, find = axis.estimator, finds_gain(axis)
    names = (*estimator.names, *([INPUT_GAIN] if find else []))
    given = {name: value for name, value in config.given.items() if name in names}
    prior = {name: pair for name, pair in config.prior.items() if name in names}
    return Known(estimator, given, prior, find) if given or prior or find else None


def put_together(result: DriveResult, known: Known, axis: Axis, estimate: Posterior) -> DriveResult:
    """Return a result with prior information. `estimate` is the combination of record and prior information.

    Raises NotIdentifiableError if the gain is below its standard deviation.
    """
    config, estimator = axis.estimator, result.estimator
    unused = [name for name in (*config.given, *config.prior) if name not in known.names]
    notes = [f"{estimator.method} does not estimate {name}, so the prior on {name} is not used" for name in unused]
    if known.find_gain:
        gain, std = estimate[INPUT_GAIN], estimate.theta_std[-1]
        if not std < abs(gain):
            raise NotIdentifiableError(
                f"input_gain comes out as {gain:.3g} with a standard deviation of {std:.2g}. Advice: "
                f"{advise(result.findings)}"
            )
        estimator = with_gain(estimator, gain)
    return replace(
        result,
        estimator=estimator,
        theta=estimate.theta,
        theta_std=estimate.theta_std,
        model_spread=estimate.model_spread,
        known=known,
    ).with_findings(
        *(Finding(CONTRADICTED, contradiction, CONTRADICTED_REMEDY) for contradiction in estimate.notes),
        *make_notes("known", [*notes, *_describe_known(known)]),
    )


def gain_needed(what: str) -> UsageError:
    return UsageError(
        f'{what} needs a number for the gain of the input: run pmfid identify with input_gain = "estimate", and '
        "write the input_gain that it finds into [model]"
    )


def check_numbers_known(axis: Axis, what: str) -> None:
    """Raise UsageError if the input gain is not a number, or if the axis has prior information.

    `what` names the function that needs the input gain and does not support prior information.
    """
    if finds_gain(axis):
        raise gain_needed(what)
    if known := (*axis.estimator.given, *axis.estimator.prior):
        raise UsageError(f"{what} uses no prior information: drop given and prior of {', '.join(known)}")


def _describe_known(known: Known) -> Iterator[str]:
    yield from (f"{name} = {value:.6g} is given" for name, value in known.given.items())
    yield from (f"{name} has the prior {mean:.6g} ± {std:.2g}" for name, (mean, std) in known.prior.items())
    if known.find_gain:
        names = " or ".join((*known.given, *known.prior))
        yield f"input_gain follows from {names}, and inherits the error of this value"

"""Checks of prior information on parameters: names, values, and whether it determines the gain of the input."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from numbers import Real

from pmfid.errors import UsageError, did_you_mean
from pmfid.models.equation import MASS, Equation

INPUT_GAIN = "input_gain"


def forces_of(equation: Equation) -> list[str]:
    """Return the names of the unknowns that are in proportion to the gain of the input."""
    return [str(term.name) for term in equation.unknown]


def check_known(
    equation: Equation,
    given: Mapping[str, float],
    prior: Mapping[str, Sequence[float]],
    names: Sequence[str],
    find_gain: bool,
) -> None:
    """Raise UsageError if the prior information on the parameters is invalid.

    A parameter must be one of `names`, must occur once, and needs a number that a machine can have. If `find_gain` is
    True, the information must determine the gain of the input.
    """
    for name in (*given, *prior):
        if name not in names:
            raise UsageError(
                f"{name} is not a parameter of this model, so it cannot be given; the parameters are "
                f"{', '.join(names)}{did_you_mean(name, names)}"
            )
    if twice := sorted(set(given) & set(prior)):
        raise UsageError(f"{', '.join(twice)} cannot have both a given value and a prior: remove one of them")
    _check_numbers(given, prior)
    known = {**given, **{name: pair[0] for name, pair in prior.items()}}
    positive = {name for name, own in zip(equation.names, equation.positive, strict=True) if own}
    for name in positive & set(known):
        if known[name] < 0:
            raise UsageError(f"{name} is given as {known[name]:g}, but it is never negative in a machine")
    mass = equation.roles[MASS]
    if mass is not None and not known.get(equation.names[mass], 1.0) > 0:
        raise UsageError(
            f"{equation.names[mass]} is given as 0, but a machine without it follows no equation of motion"
        )
    forces, exact = forces_of(equation), {*given, *(name for name, pair in prior.items() if pair[1] == 0)}
    if find_gain and INPUT_GAIN in exact:
        raise UsageError(
            "input_gain is among the given values, so nothing remains to be estimated: write its value "
            "into [model] or the Drive"
        )
    if find_gain and not any(name in (*forces, INPUT_GAIN) and value for name, value in known.items()):
        raise UsageError(
            "the gain of the input can be estimated only if a force is known: give one of "
            f"{', '.join(forces)} a value other than 0, for example given = {{ mass = 1.25 }} in "
            "[estimator]"
        )


def _check_numbers(given: Mapping[str, float], prior: Mapping[str, Sequence[float]]) -> None:
    for name, value in given.items():
        if not isinstance(value, Real) or isinstance(value, bool) or not math.isfinite(value):
            raise UsageError(f"given {name} must be a number, got {value!r}")
    for name, pair in prior.items():
        if isinstance(pair, Real):
            raise UsageError(
                f"prior of {name} must be a mean and a standard deviation, for example [1, 0.1], got {pair!r}"
            )
        numbers = [part for part in pair if isinstance(part, Real) and math.isfinite(part)]
        if len(pair) != 2 or len(numbers) != 2 or numbers[1] < 0:
            raise UsageError(
                f"prior of {name} must be a mean and a standard deviation, for example [1, 0.1], got {list(pair)!r}"
            )

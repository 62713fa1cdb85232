"""The delay of an input: a dead time, a first-order lag, or both, as the counts ask for."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from pmfid.errors import NotIdentifiableError
from pmfid.estimators.adequacy import MISSED, Adequacy
from pmfid.estimators.difference import Difference, least, rms
from pmfid.estimators.likelihood import climb, cost
from pmfid.models.equation import DEAD_TIME, ESTIMATE, LAG, LATE, Equation
from pmfid.types import Floats

#: Doubled log-likelihoods that differ by less are alike.
ALIKE = MISSED**2
#: Options of a model that make an input late.
OPTIONS = (DEAD_TIME, LAG)


@dataclass(frozen=True)
class Lateness:
    """A way of being late that explains the counts better than a model.

    times: [s] by the names of the model's options; gain: by how much the doubled log-likelihood is larger; follows:
    does the motion then explain the counts?
    """

    times: Mapping[str, float]
    gain: float
    follows: bool


def lateness(found: Adequacy) -> list[Lateness]:
    """Ways of being late under which the motion explains the counts clearly better than under the model, the best one
    first; a second one is there only where it is as likely, or has fewer unknowns."""
    ways: list[Lateness] = []
    for equation in _others(found.difference.equation):
        way = _fit_equation(found, equation)
        if way is not None and way.gain > ALIKE:
            ways.append(way)
        elif found.difference.equation.at_once == found.difference.equation:
            return []  # to first order the two are alike
    clear = sorted(ways, key=lambda way: -way.gain)
    simple = [way for way in clear if len(way.times) == 1]
    if simple and clear[0].gain - simple[0].gain < ALIKE:
        return simple
    return clear


def _others(equation: Equation) -> Iterator[Equation]:
    dead = equation.at_lag(0.0).at_dead_time(ESTIMATE)
    lag = equation.at_dead_time(0.0).at_lag(ESTIMATE)
    there = (bool(equation.dead_time), bool(equation.lag))
    if there != (True, False) or equation.dead_time != ESTIMATE:
        yield dead
    if there != (False, True) or equation.lag != ESTIMATE:
        yield lag
    if any(there):
        yield dead.at_lag(ESTIMATE)


def _fit_equation(found: Adequacy, equation: Equation) -> Lateness | None:
    """The best fit of another equation, from the model's fit; None: there is none, or none that is late."""
    difference, start = _prepare_fit(found, equation)
    try:
        q = least(difference, start)
    except NotIdentifiableError:
        return None
    cost_there = None
    if found.noise is not None and rms(difference(q)) <= difference.explained:
        cost_there, q, _ = climb(difference, q, None)  # a local maximum would do: it is better, or it is not
    values = dict(zip(_names(equation), q * difference.scale, strict=False))
    times = {name: float(values[name]) for name in OPTIONS if name in values}
    late = all(time > 0 for time in times.values())
    size = rms(difference(q))
    gain, follows = _gain(found, size, cost_there), size <= difference.explained
    return Lateness(times, gain, follows) if late else None


def _names(equation: Equation) -> tuple[str, ...]:
    """Of theta."""
    return (*equation.names, *dict(equation.further))


def _prepare_fit(found: Adequacy, equation: Equation) -> tuple[Difference, Floats]:
    """The difference of another equation, and q (q,) to start from: the same but for how late the input acts."""
    own, q = found.difference, found.q
    values, sizes = (dict(zip(_names(own.equation), numbers, strict=False)) for numbers in (q * own.scale, own.scale))
    asked = [name for name in _names(equation) if name in OPTIONS]
    for name in asked:
        values[name], sizes[name] = _late_by(found) / len(asked), own.dt
    scale = np.r_[[sizes[name] for name in _names(equation)], own.scale[-2:]]
    theta = np.array([values[name] for name in _names(equation)])
    difference = replace(own, equation=equation, scale=scale).fine_at(theta)
    return difference, np.r_[theta / scale[:-2], q[-2:]]


def _late_by(found: Adequacy) -> float:
    """Mean time [s] by which the input acts late, to begin with."""
    own = found.difference
    theta = found.q * own.scale
    known = own.equation.known_at(theta[len(own.equation.names) : -2])
    return float(known.role_values(theta)[LATE] + float(known.lag)) or found.dead_time or own.dt / 2


def _gain(found: Adequacy, size: float, cost_there: float | None) -> float:
    """size: root mean square of the other fit's difference; cost_there: its negative log-likelihood, where both are
    within the counts."""
    error = found.difference(found.q)
    if found.noise is None or cost_there is None:
        return 2 * error.size * math.log(rms(error) / size)
    return 2 * (cost(error, found.noise)[0] - cost_there)

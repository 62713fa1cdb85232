"""Where a search starts: the position and velocity with which a simulated motion follows the first samples best, and
Stribeck speeds."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from pmfid.errors import NotIdentifiableError
from pmfid.estimators.difference import WHITE, Difference, first_speed, least, rms
from pmfid.types import Floats

Found = TypeVar("Found")

#: Time constants of the filters over which the start of a free run is read.
READ = 5.0
#: Filter time constants over which speeds to begin with are read.
WITHIN = (1.0, READ)
#: Passes of Gauss and Newton's method; a stop that comes and goes may keep it from settling.
PASSES = 8
SETTLED = 1e-12
#: A step too far is tried once more as this part of itself.
SHORTER = 0.25
#: Stribeck speeds to start from, as parts of the usual one: with each, what is left is a sum of squares of its own.
STRIBECK_SPEEDS = (0.03, 0.1, 0.3)
#: Those that are gone on from: the one that leaves the least need not lead to the best maximum.
MOST_SPEEDS = 2


def start_samples(dt: float, cutoff: float) -> int:
    """How many samples the start of a free run is read from; dt [s], cutoff [rad/s]."""
    return max(2, math.ceil(READ / (cutoff * dt)))


def choose_start(difference: Difference, theta: Floats, cutoff: float, speeds: Sequence[float] = ()) -> Floats:
    """q (q,) at scaled parameters (p,), with a start to improve: that whose motion is the nearest, of the speeds that
    the counts show within 1 / cutoff [s] and within several times that, and of further ones.

    From a speed within stiction, where the axis was moving, there is no way to a better one.
    """
    shown = [first_speed(difference.y, difference.dt, cutoff / part, difference.resolution) for part in WITHIN]
    places = [np.array([difference.y[0], speed]) / difference.scale[-2:] for speed in dict.fromkeys((*shown, *speeds))]
    starts: list[Floats] = [np.concatenate([theta, place]) for place in places]
    return min(starts, key=lambda q: rms(difference(q)))


def fit_start(difference: Difference, q: Floats) -> Floats:
    """q (q,) with the start of least squares, its parameters as they are.

    From rest within stiction a velocity moves nothing: it is taken for that of q to a few counts in a filter time
    constant, as in every error bar.
    """
    prior = np.array([0.0, 1 / difference.start_velocity_std])
    speed, left = q[-1], _weigh_residual(difference, q, q[-1])
    for _ in range(PASSES):
        slope = np.r_[WHITE * difference.jacobian(q, first=q.size - 2), prior[None]]
        if not (np.all(np.isfinite(slope)) and np.all(np.isfinite(left))):
            break  # parameters that nothing can be simulated with
        step = np.r_[np.zeros(q.size - 2), np.linalg.lstsq(slope, -left)[0]]
        before = float(left @ left)
        for part in (1.0, SHORTER):
            trial = q + part * step
            found = _weigh_residual(difference, trial, speed)
            if float(found @ found) < before:
                q, left = trial, found
                break
        if not float(left @ left) < (1 - SETTLED) * before:
            break
    return q


def _weigh_residual(difference: Difference, q: Floats, speed: float) -> Floats:
    """(n + 1,) what is left of the position and of the start velocity `speed`, in their standard deviations."""
    return np.append(WHITE * difference(q), (q[-1] - speed) / difference.start_velocity_std)


def find_least_from_start(difference: Difference, q: Floats, cutoff: float, tolerances: Sequence[float]) -> Floats:
    """`least` from q (q,). Where a force has a shape, from where the motion at these parameters starts by the first
    samples, and from q itself only if more is left than the encoder explains: along the travel the sum of squares has a
    minimum for each way to begin. Raises NotIdentifiableError where nothing settles."""
    if not difference.equation.shaped:
        return least(difference, q, tolerances)
    found, refused = list[Floats](), NotIdentifiableError("no start of the motion leads anywhere")
    for begin in (read_start(difference, q, cutoff), q):
        try:
            found.append(least(difference, begin, tolerances))
        except NotIdentifiableError as error:
            refused = error
            continue
        if rms(difference(found[-1])) <= difference.explained:
            break
    if not found:
        raise refused
    return min(found, key=lambda one: rms(difference(one)))


def read_start(difference: Difference, q: Floats, cutoff: float) -> Floats:
    """q (q,) with a start that is read from the first samples."""
    direct = replace(difference, pole=0.0)
    first = direct.part(0, min(start_samples(direct.dt, cutoff), direct.y.size))
    return fit_start(first, choose_start(first, q[:-2], cutoff))


def fit_at_speeds(
    usual: float, at: Callable[[float], Found], worse: Callable[[Found], float]
) -> list[tuple[float, Found]]:
    """Stribeck speeds to go on from, the best first, and what was found at each; usual: speed of the motion; at: fits
    with a speed that is known; worse: by what they are compared. Raises NotIdentifiableError where none settles."""
    found = list[tuple[float, Found]]()
    refused = NotIdentifiableError("no Stribeck speed settles: record more of slow motion")
    for speed in (usual * np.array(STRIBECK_SPEEDS)).tolist():
        try:
            found.append((speed, at(speed)))
        except NotIdentifiableError as error:
            refused = error
    if not found:
        raise refused
    return sorted(found, key=lambda one: worse(one[1]))[:MOST_SPEEDS]

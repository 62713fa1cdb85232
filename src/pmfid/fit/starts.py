"""Blind starts: the parameters of a mass with friction from nothing but the record."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np

from pmfid._body import BASE
from pmfid.errors import NotIdentifiableError
from pmfid.findings import MOVE
from pmfid.fit.likelihood import Gaussian
from pmfid.fit.machine import COULOMB, MASS, OFFSET, VISCOUS, BodyForce, BodyModel
from pmfid.fit.problem import FitProblem, ObservedStretch
from pmfid.fit.solve import Optimum, solve
from pmfid.fit.terms import Sizes
from pmfid.types import Floats

#: Changes of the counts in the first window, and its fewest and most observations.
FEWEST_CHANGES, FEWEST_ROWS, MOST_ROWS = 60, 200, 10_000
#: Largest distance of the mass from the first guess, as a logarithm.
FAR = 7.0
#: Phases of the sine and the cosine of gravity.
PHASES = (0.0, math.pi / 2)
#: Factors of the first guess of mass, viscous friction and Coulomb friction.
GUESSES = (0.1, 0.3, 1.0, 3.0), (0.1, 0.5), (0.03, 0.2)


def make_first_body(turn: float) -> BodyModel:
    """Return a mass with viscous and Coulomb friction, a load, a spring, and gravity for an axis with a `turn`.

    A model without load and spring still starts with both, because a force of the position hides every other
    parameter. A spring stands for every force of the position in a short window.
    """
    forces = (BodyForce("spring"), *(BodyForce("wave", turn, phase) for phase in PHASES if turn))
    names = ("m", "d", "F", "load", "spring", "sin", "cos")[: 4 + len(forces)]
    lift = np.zeros((BASE + len(forces), len(names)))
    lift[[MASS, VISCOUS, COULOMB, OFFSET, *range(BASE, len(lift))], range(len(names))] = 1.0
    lowest = np.array([-np.inf, 0.0, 0.0, *[-np.inf] * (1 + len(forces))])
    return BodyModel(names, forces, np.zeros(len(lift)), lift, 0, lowest)


def blind_start(stretches: tuple[ObservedStretch, ...], resolution: float, turn: float) -> tuple[FitProblem, Optimum]:
    """Return the fit of a mass with friction and a load to the liveliest stretch.

    Raises NotIdentifiableError if the axis does not move.
    """
    body, longest = make_first_body(turn), max((one.y.size for one in stretches), default=0)
    if longest < 2 * len(body.names):
        raise NotIdentifiableError(f"no part of the record has more than {longest} samples in a row; {MOVE}")
    stretch = max(stretches, key=lambda one: float(np.sum(np.abs(np.diff(one.y)))))
    windows = _windows(stretch, resolution)
    first = next(windows)
    problem = FitProblem(body, (first,), resolution)
    force = float(np.sqrt(np.mean(first.drive.u**2)))
    if not force > 0:
        raise NotIdentifiableError(f"the input is zero while the axis moves; {MOVE}")
    travel = max(float(np.ptp(stretch.y)) / 2, resolution)
    prior = np.array(
        [
            0.0,
            0.0,
            0.0,
            1 / (0.5 * force) ** 2,
            (travel / (0.5 * force)) ** 2,
            *[1 / (0.5 * force) ** 2] * (2 * (turn > 0)),
        ]
    )
    guesses = list(_guesses(first, force, 2 * (turn > 0)))
    middle = math.log(float(np.median([guess[0] for guess in guesses])))
    problem = replace(problem, mass=(middle - FAR, middle + FAR))
    best: Optimum | None = None
    for guess in guesses:
        tried = solve(problem, soften((first,)), problem.start(guess), problem.first_starts(), prior, 25, 0.1)
        if best is None or tried.cost < best.cost:
            best = tried
    assert best is not None
    for window in windows:
        starts = best.starts if window.first == problem.stretches[0].first else None
        problem = replace(problem, stretches=(window,))
        starts = problem.first_starts() if starts is None else starts
        best = solve(problem, soften((window,)), best.q, starts, prior, small=0.1)
    return problem, best


def soften(stretches: tuple[ObservedStretch, ...]) -> Gaussian:
    """Return a likelihood with three times the rounding, because the first guesses are far away."""
    return Gaussian(stretches, scale=9.0)


def _guesses(window: ObservedStretch, force: float, further: int) -> Iterator[Floats]:
    """Yield (mass, viscous friction, Coulomb friction, load, spring, gravity) from speeds and accelerations."""
    t, width = window.times, max(1, min(max(3, window.y.size // 60), window.y.size // 4))
    smooth = np.ones(width) / width
    v = np.gradient(np.convolve(window.y - window.y[0], smooth, "same"), t)[width:-width]
    a = np.gradient(np.convolve(v, smooth, "same"), t[width:-width])
    speed, change = float(np.percentile(_moving(v), 90)), float(np.percentile(_moving(a), 80))
    for mass, viscous, coulomb in product(*GUESSES):
        yield np.array([force / change * mass, force / speed * viscous, force * coulomb, 0.0, 0.0, *[0.0] * further])


def _moving(x: Floats) -> Floats:
    """Return the sizes of a signal (n,) that is zero at rest, without the rests."""
    size = np.abs(x)
    return size[size > 1e-6 * np.max(size)] if np.any(size > 0) else np.ones(1)


def _windows(stretch: ObservedStretch, resolution: float) -> Iterator[ObservedStretch]:
    """Yield windows from the first motion on, each twice as long as the one before, up to the whole stretch."""
    changes = np.abs(np.diff(stretch.y)) / resolution
    if not np.any(changes > 0):
        raise NotIdentifiableError(f"the axis does not move in this record; {MOVE}")
    times, total = stretch.times, np.append(0.0, np.cumsum(changes))
    first = max(0, int(np.argmax(total > 0)) - 5)
    count = min(max(FEWEST_ROWS, stretch.y.size // 10), MOST_ROWS)
    while first + count < stretch.y.size:
        if total[first + count] >= FEWEST_CHANGES:
            yield stretch.cut(float(times[first]), float(times[first + count]))
        count *= 2
    yield stretch


def sizes_of(problem: FitProblem, start: FitProblem, solution: Optimum) -> Sizes:
    """Return the sizes that scale the priors, from the record and its blind start."""
    u = np.concatenate([one.drive.u for one in problem.stretches])
    y = np.concatenate([one.y for one in problem.stretches])
    warmth = np.concatenate([one.drive.columns[:1].ravel() for one in problem.stretches])
    (_, v), *_ = start.motion(solution.q, solution.starts)
    theta = start.theta(solution.q)
    force, top = float(np.sqrt(np.mean(u**2))), float(np.max(np.abs(u)))
    moving = np.abs(v[np.isfinite(v) & (v != 0)])
    if not moving.size:
        raise NotIdentifiableError(f"no motion under this input follows the record; {MOVE}")
    speed = float(np.quantile(moving, 0.98))
    acting = np.abs(u[np.abs(u) > 1e-6 * top])
    return Sizes(
        force,
        top,
        speed,
        max(float(theta[2]), 0.05 * force),
        max(float(theta[1]), 0.05 * force / speed),
        max(float(np.ptp(y)) / 2, problem.resolution),
        float(np.mean([np.mean(one.drive.step) for one in problem.stretches])),
        sum(float(np.sum(one.drive.step)) for one in problem.stretches),
        bool(np.ptp(acting) > 1e-3 * top),
        problem.machine.turn,
        float(np.mean(y)),
        float(np.std(warmth)) if warmth.size else 0.0,
    )

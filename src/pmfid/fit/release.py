"""Fits whose motion a spring holds near the measured one. The spring becomes weaker until the motion is free.

Masses that bounce make the likelihood of a free motion rough, because each wrong contact shifts all later ones. A held
motion comes into contact when the measured one does (synchronisation; Abarbanel, Creveling, Farsian and Kostuk 2009).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from pmfid.errors import NotIdentifiableError
from pmfid.fit.driven import distinct
from pmfid.fit.machine import LOAD_VISCOUS, VISCOUS, BodyForce
from pmfid.fit.problem import FitProblem, ObservedStretch
from pmfid.fit.shooting import rejoin
from pmfid.fit.solve import Optimum, solve
from pmfid.fit.starts import soften
from pmfid.fit.tuning import RELEASE_TUNING, TUNING
from pmfid.types import Floats


def release(plain: FitProblem, points: Sequence[Floats], prior: Floats, trial: bool = False) -> Optimum:
    """Return the best fit of two masses from starts q (p,), whose motion is held less and less.

    A `trial` asks only whether rounding explains the rest. It takes less time.
    Raises NotIdentifiableError in a trial if even held motions leave twice the cost of rounding.
    """
    enough, starts = rounding_of(plain), plain.first_starts()
    first = [(hold(plain, q, RELEASE_TUNING.rates[0]), q) for q in points]
    first.sort(key=lambda pair: sum(float(e @ e) for e in pair[0].residuals(pair[1], starts)))
    ends = [
        _descend(held, q, starts, prior, RELEASE_TUNING.first)
        for held, q in first[: RELEASE_TUNING.held if trial else None]
    ]
    ends.sort(key=lambda end: end.cost)
    for number, rate in enumerate(RELEASE_TUNING.rates[1:], 1):
        if trial and ends[0].cost > 2 * enough:
            raise NotIdentifiableError("two masses do not follow")
        tried = []
        for end in _distinct(plain, ends)[: len(RELEASE_TUNING.rates) - number]:
            tried.append(_descend(hold(plain, end.q, rate), end.q, end.starts, prior))
            if tried[-1].cost < enough:
                free = _descend(plain, tried[-1].q, tried[-1].starts, prior)
                if free.cost < enough:
                    return free
        ends = sorted(tried, key=lambda end: end.cost)
    ends = [_descend(plain, end.q, end.starts, prior) for end in ends]
    return _mend(plain, min(ends, key=lambda end: end.cost), prior)


def follow(plain: FitProblem, points: Sequence[Floats], prior: Floats) -> Optimum:
    """Return the best fit from good starts q (p,), whose motion is free or held by a weak spring, and then free."""
    ends, weak = list[Optimum](), (0.0, RELEASE_TUNING.rates[3], RELEASE_TUNING.rates[1])
    for rate, q in product(weak, points):
        end = _descend(hold(plain, q, rate) if rate else plain, q, plain.first_starts(), prior)
        ends.append(_descend(plain, end.q, end.starts, prior) if rate else end)
        if ends[-1].cost < rounding_of(plain):
            return ends[-1]
    return _mend(plain, min(ends, key=lambda end: end.cost), prior)


def rounding_of(problem: FitProblem) -> float:
    """Return the largest softened cost that rounding alone leaves."""
    return soften(problem.stretches).rounded_cost


def _mend(plain: FitProblem, best: Optimum, prior: Floats) -> Optimum:
    """Return a fit, or a better one from parts of the record if the fit leaves more than rounding and less than about a
    count."""
    before, rounding = float(plain.rows), rounding_of(plain)
    for number in TUNING.rejoined:
        if not rounding < best.cost < before:
            break
        before, best = best.cost / 2, min(rejoin(plain, best.q, prior, number), best, key=lambda end: end.cost)
    return best


def hold(plain: FitProblem, q: Floats, rate: float) -> FitProblem:
    """Return the problem with a spring and a damper between the shown mass and its measured motion. Both masses
    together swing with the `rate` [1/step] on the spring."""
    machine = plain.machine
    mass = float(np.sum(np.exp(q[[machine.lead, machine.further[0]]])))
    rate /= float(np.mean(plain.stretches[0].drive.step))
    spring, damper = mass * rate**2, 2 * mass * rate
    rest = np.append(machine.rest, [spring, -1.0])
    rest[LOAD_VISCOUS if machine.load else VISCOUS] += damper
    lift = np.vstack([machine.lift, np.zeros((2, machine.lift.shape[1]))])
    column = plain.stretches[0].drive.columns.shape[0]
    forces = BodyForce("spring", load=machine.load), BodyForce("column", column=column, load=machine.load)
    return replace(
        plain,
        machine=replace(machine, rest=rest, lift=lift, forces=forces),
        stretches=tuple(one.with_columns(_pull(one, spring, damper)[None]) for one in plain.stretches),
        parts=1,
    )


def _pull(stretch: ObservedStretch, spring: float, damper: float) -> Floats:
    """Return the force (n,) of spring and damper on a mass at rest at zero."""
    step = stretch.drive.step
    y = np.interp(np.append(0.0, np.cumsum(step)), stretch.times, stretch.y)
    return np.asarray(spring * (y[1:] + y[:-1]) / 2 + damper * np.diff(y) / step)


def _descend(
    problem: FitProblem, q: Floats, starts: Floats, prior: Floats, steps: int = RELEASE_TUNING.steps
) -> Optimum:
    return solve(problem, soften(problem.stretches), q, starts, prior, steps, 0.1)


def _distinct(plain: FitProblem, ends: Sequence[Optimum]) -> list[Optimum]:
    """Return the first ends with a share of the load, and a gap or else a stiffness, of their own."""
    load, stiffness, _, *gap = plain.machine.further
    sizes = [np.log(end.q[gap[0]]) if gap else end.q[stiffness] for end in ends]
    places = [np.array([size, end.q[load] - end.q[plain.machine.lead]]) for size, end in zip(sizes, ends, strict=True)]
    kept = {id(place) for place in distinct(places, RELEASE_TUNING.apart)}
    return [end for end, place in zip(ends, places, strict=True) if id(place) in kept]

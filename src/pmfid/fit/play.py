"""Blind starts of two masses with play, from one mass and a scan of gaps and shares of the load."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np

from pmfid.errors import NotIdentifiableError
from pmfid.findings import MOVE
from pmfid.fit.elastic import ROWS, count_parts, guess_sum, join, make_first_pair, restart, settle
from pmfid.fit.machine import DELAY
from pmfid.fit.problem import FitProblem, ObservedStretch
from pmfid.fit.solve import Optimum
from pmfid.fit.starts import blind_start
from pmfid.fit.tuning import PLAY_TUNING, TUNING
from pmfid.types import Floats


def play_start(problem: FitProblem) -> tuple[FitProblem, Optimum]:
    """Return the fit of two masses with play to the liveliest stretch.

    Parts with starts of their own (Bock 1983) keep wrong gaps near the record. The contact is stiff at first: it swings
    once in a few steps.

    Raises NotIdentifiableError if the axis does not move, or if the input is zero.
    """
    stretch = max(problem.stretches, key=lambda one: float(np.sum(np.abs(np.diff(one.y)))))
    force, step = float(np.sqrt(np.mean(stretch.drive.u**2))), float(np.mean(stretch.drive.step))
    if not (np.ptp(stretch.y) > 0 and force > 0):
        raise NotIdentifiableError(f"the axis or the input does not move in this record; {MOVE}")
    start, rigid = blind_start((stretch,), problem.resolution, 0.0)
    theta, smooth = start.theta(rigid.q)[:4], np.array([*guess_sum(stretch, force), 0.0])
    pair = make_first_pair(bool(np.any(problem.machine.lift[DELAY])), float(problem.machine.rest[DELAY]), plays=True)
    logs = np.log([theta[0], smooth[0]])
    bounds = (float(np.min(logs)) - TUNING.far, float(np.max(logs)) + TUNING.far)
    rates = (PLAY_TUNING.rates[0] / step, PLAY_TUNING.rates[1] / step)
    plain = FitProblem(pair, (stretch,), problem.resolution, mass=bounds, rate=rates)
    prior = np.zeros(plain.size)
    prior[3] = 1 / (0.5 * force) ** 2
    return plain, _follow(plain, stretch, prior, [q for one in (theta, smooth) for q in _scan(plain, one, step)])


def _scan(plain: FitProblem, theta: Floats, step: float) -> Iterator[Floats]:
    """Yield starts q (p,) over gaps and shares of the load."""
    mass, viscous, coulomb, load = theta.tolist()
    (stretch,), rate = plain.stretches, PLAY_TUNING.contact[0] / step
    gaps = np.geomspace(1, max(2, PLAY_TUNING.widest * float(np.ptp(stretch.y)) / plain.resolution), PLAY_TUNING.gaps)
    late = [0.5 * step] * (plain.size - len(ROWS) - 1)
    for gap, share in product((gaps * plain.resolution).tolist(), PLAY_TUNING.shares):
        reduced = mass * share * (1 - share)
        contact = (reduced * rate**2, 2 * PLAY_TUNING.contact[1] * rate * reduced, gap)
        motor, second = mass * (1 - share), mass * share
        pair = [motor, viscous / 2, coulomb / 2, load, second, viscous / 2, coulomb / 2, *contact, *late]
        yield plain.clip_to_bounds(plain.start(np.array(pair)))


def _follow(plain: FitProblem, stretch: ObservedStretch, prior: Floats, points: list[Floats]) -> Optimum:
    """Return the best fit of the whole stretch from starts that first follow some parts of it."""
    length = PLAY_TUNING.part * float(np.mean(stretch.drive.step))
    problem = plain.cut(count_parts(plain, length))
    problem = replace(problem, stretches=problem.stretches[:: math.ceil(len(problem.stretches) / PLAY_TUNING.parts)])
    first = problem.first_starts()
    ends = sorted((settle(problem, q, first, prior, 4) for q in points), key=lambda end: end.cost)
    ends = [settle(problem, end.q, end.starts, prior, 12) for end in ends[: TUNING.kept]]
    best: Optimum | None = None
    for end in sorted(ends, key=lambda end: end.cost)[:2]:
        tried = join(plain, problem, end, length, prior)
        best = tried if best is None or tried.cost < best.cost else best
        if best.cost < TUNING.rounded * stretch.y.size:
            return best
    assert best is not None
    for number in (TUNING.joined, TUNING.joined**2):
        best = restart(plain, best, prior, number)
        if best.cost < TUNING.rounded * stretch.y.size:
            break
    return best

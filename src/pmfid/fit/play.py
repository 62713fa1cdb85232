"""Blind starts of two masses with play, from one mass and a scan of gaps and shares of the load."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product

import numpy as np

from pmfid.fit.elastic import follow, guess_sum, liveliest, make_first_pair, prior_of, start_at
from pmfid.fit.problem import FitProblem
from pmfid.fit.solve import Optimum
from pmfid.fit.starts import blind_start
from pmfid.fit.tuning import PLAY_TUNING, TUNING
from pmfid.types import Floats


def play_start(problem: FitProblem, bound: float = math.inf) -> tuple[FitProblem, Optimum]:
    """Return the fit of two masses with play to the liveliest stretch. A first fit beyond a `bound` ends the search.

    The contact is stiff at first: it swings once in a few steps.

    Raises NotIdentifiableError if the axis does not move, or if the input is zero.
    """
    stretch, force = liveliest(problem)
    step = float(np.mean(stretch.drive.step))
    start, rigid = blind_start((stretch,), problem.resolution, 0.0)
    theta, smooth = start.theta(rigid.q)[:4], np.array([*guess_sum(stretch, force), 0.0])
    pair = make_first_pair(problem.machine, plays=True)
    logs = np.log([theta[0], smooth[0]])
    bounds = (float(np.min(logs)) - TUNING.far, float(np.max(logs)) + TUNING.far)
    rates = (PLAY_TUNING.rates[0] / step, PLAY_TUNING.rates[1] / step)
    plain = FitProblem(pair, (stretch,), problem.resolution, mass=bounds, rate=rates)
    points = [q for one in (theta, smooth) for q in _scan(plain, one, step)]
    parts = (PLAY_TUNING.part * step, PLAY_TUNING.parts)
    return plain, follow(plain, points, prior_of(plain, force), parts, bound)


def _scan(plain: FitProblem, theta: Floats, step: float) -> Iterator[Floats]:
    """Yield starts q (p,) over gaps and shares of the load."""
    mass, viscous, coulomb, load = theta.tolist()
    (stretch,), rate = plain.stretches, PLAY_TUNING.contact[0] / step
    gaps = np.geomspace(1, max(2, PLAY_TUNING.widest * float(np.ptp(stretch.y)) / plain.resolution), PLAY_TUNING.gaps)
    for gap, share in product((gaps * plain.resolution).tolist(), PLAY_TUNING.shares):
        reduced = mass * share * (1 - share)
        contact = (reduced * rate**2, 2 * PLAY_TUNING.contact[1] * rate * reduced, gap)
        motor, second = mass * (1 - share), mass * share
        pair = (motor, viscous / 2, coulomb / 2, load, second, viscous / 2, coulomb / 2, *contact)
        yield start_at(plain, np.array(pair))

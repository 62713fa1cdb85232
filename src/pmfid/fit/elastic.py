"""Blind starts of two masses on a spring or with play, from the measured motion and from scans."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from pmfid._body import ELASTIC_BASE
from pmfid.errors import NotIdentifiableError
from pmfid.findings import MOVE
from pmfid.fit.driven import driven_guesses, find_shaken_part
from pmfid.fit.machine import (
    COULOMB,
    DAMPING,
    DELAY,
    LOAD_COULOMB,
    LOAD_MASS,
    LOAD_VISCOUS,
    MASS,
    OFFSET,
    PLAY,
    STIFFNESS,
    VISCOUS,
    BodyModel,
)
from pmfid.fit.problem import FitProblem, ObservedStretch
from pmfid.fit.release import follow, release, rounding_of
from pmfid.fit.solve import Optimum
from pmfid.fit.starts import blind_start
from pmfid.fit.tuning import PLAY_TUNING, TUNING
from pmfid.types import Floats

#: Parameters of the first fits, in the order of `driven_guesses`.
ROWS = (MASS, VISCOUS, COULOMB, OFFSET, LOAD_MASS, LOAD_VISCOUS, LOAD_COULOMB, STIFFNESS, DAMPING)


def elastic_start(problem: FitProblem) -> tuple[FitProblem, Optimum]:
    """Return the fit of two masses on a spring, with friction and a load, to the liveliest stretch.

    Where no guess by the measured motion explains it, motions are held near the measured one, and a scan of resonances
    takes several times as long.

    Raises NotIdentifiableError if the axis does not move, or if the input is zero.
    """
    plain, points, ends = follow_guesses(problem)
    if ends and ends[-1].cost < rounding_of(plain):
        return plain, ends[-1]
    stretch, force = liveliest(problem)
    part = replace(plain, stretches=(find_shaken_part(stretch, problem.resolution),))
    total, prior = np.array([*guess_sum(stretch, force), 0.0]), prior_of(plain)
    if part.rows == plain.rows:
        return plain, min([*ends, _search_part(part, points, total, prior, ())], key=lambda end: end.cost)
    end = _search_part(part, points, total, prior, [follow(part, points, prior)] if points else [])
    return plain, min([*ends, follow(plain, [end.q], prior)], key=lambda end: end.cost)


def follow_guesses(
    problem: FitProblem, guide: ObservedStretch | None = None
) -> tuple[FitProblem, list[Floats], list[Optimum]]:
    """Return two masses on a spring in the liveliest stretch, the guesses q (p,) by the measured motion, and their
    fits. The last fit explains every count, or all guesses are followed.

    The guesses are those of a `guide`, a longer stretch, if there is one. A measured load gives no guess.
    Raises NotIdentifiableError if the axis does not move, or if the input is zero.
    """
    stretch, force = liveliest(problem)
    plain = _plain_pair(problem, stretch, np.array(guess_sum(stretch, force)[:1]), resonances(stretch))
    points, ends = list[Floats](), list[Optimum]()
    for guess in () if plain.machine.load else driven_guesses(guide or stretch, plain.resolution):
        points.append(start_at(plain, guess))
        ends.append(follow(plain, points[-1:], prior_of(plain)))
        if ends[-1].cost < rounding_of(plain):
            break
    return plain, points, ends


def _search_part(
    part: FitProblem, points: Sequence[Floats], total: Floats, prior: Floats, followed: Sequence[Optimum]
) -> Optimum:
    """Return the best fit to a part of the record from starts q (p,), which may be `followed` already, or else from a
    scan of resonances."""
    ends, enough = list(followed), rounding_of(part)
    if points and not (ends and ends[0].cost < enough):
        ends.append(release(part, points, prior))
    if not ends or min(end.cost for end in ends) > enough:
        ends.append(release(part, list(_scan(part, total)), prior))
    return min(ends, key=lambda end: end.cost)


def play_start(problem: FitProblem, trial: bool = False) -> tuple[FitProblem, Optimum]:
    """Return the fit of two masses with play to the liveliest stretch. A `trial` is that of `release`.

    The contact is stiff at first: it swings once in a few steps.

    Raises NotIdentifiableError if the axis does not move, if the input is zero, or if a trial fails.
    """
    stretch, force = liveliest(problem)
    step = float(np.mean(stretch.drive.step))
    start, rigid = blind_start((stretch,), problem.resolution, 0.0)
    totals = np.array([start.theta(rigid.q)[:4], [*guess_sum(stretch, force), 0.0]])
    low, high = PLAY_TUNING.rates
    plain = _plain_pair(problem, stretch, totals[:, 0], (low / step, high / step), plays=True)
    points = [q for total in totals for q in _scan_gaps(plain, total, step)]
    prior = prior_of(plain)
    part = replace(plain, stretches=(find_shaken_part(stretch, problem.resolution),))
    end = release(part, points, prior, trial)
    return plain, follow(plain, [end.q], prior) if part.rows < plain.rows else end


def _plain_pair(
    problem: FitProblem, stretch: ObservedStretch, masses: Floats, rate: tuple[float, float], plays: bool = False
) -> FitProblem:
    """Return the problem of two masses near first guesses of their sum (k,), with bounds of the resonance [1/s]."""
    mass = math.log(np.min(masses)) - TUNING.far, math.log(np.max(masses)) + TUNING.far
    return FitProblem(make_first_pair(problem.machine, plays), (stretch,), problem.resolution, mass=mass, rate=rate)


def make_first_pair(machine: BodyModel, plays: bool = False) -> BodyModel:
    """Return two masses with viscous and Coulomb friction, a load, and a gap if they play. The dead time, and whether
    the motor or the load is measured, are those of `machine`."""
    rows = [*ROWS, *([PLAY] if plays else []), *([DELAY] if np.any(machine.lift[DELAY]) else [])]
    lift = np.eye(ELASTIC_BASE)[:, rows]
    lowest = np.where(np.isin(rows, (MASS, OFFSET, LOAD_MASS, STIFFNESS)), -np.inf, 0.0)
    rest = machine.rest[DELAY] * np.eye(ELASTIC_BASE)[DELAY]
    places = tuple(rows.index(row) for row in (LOAD_MASS, STIFFNESS, DAMPING, PLAY) if row in rows)
    return BodyModel(tuple(map(str, rows)), (), rest, lift, 0, lowest, elastic=True, further=places, load=machine.load)


def resonance_of(theta: Floats) -> float:
    """Return the resonance [1/s] of two masses, whose parameters theta (p,) begin as `ROWS`."""
    masses = theta[[ROWS.index(MASS), ROWS.index(LOAD_MASS)]]
    return math.sqrt(theta[ROWS.index(STIFFNESS)] * float(np.sum(1 / masses)))


def resonances(stretch: ObservedStretch) -> tuple[float, float]:
    """Return the lowest and the highest resonance [1/s] that a stretch may show."""
    step, time = float(np.mean(stretch.drive.step)), float(np.sum(stretch.drive.step))
    low = max(TUNING.lowest, 2 / time)
    return 2 * math.pi * low, 2 * math.pi * max(TUNING.highest / step, 2 * low)


def start_at(plain: FitProblem, guess: Floats) -> Floats:
    """Return q (p,) at a guess, with a dead time of half a step if it is free."""
    late = [0.5 * float(np.mean(plain.stretches[0].drive.step))] * (plain.size - guess.size)
    return plain.clip_to_bounds(plain.start(np.append(guess, late)))


def liveliest(problem: FitProblem) -> tuple[ObservedStretch, float]:
    """Return the stretch with the longest way and its root mean square force.

    Raises NotIdentifiableError if the axis does not move, or if the input is zero.
    """
    stretch = max(problem.stretches, key=lambda one: float(np.sum(np.abs(np.diff(one.y)))))
    force = float(np.sqrt(np.mean(stretch.drive.u**2)))
    if not (np.ptp(stretch.y) > 0 and force > 0):
        raise NotIdentifiableError(f"the axis or the input does not move in this record; {MOVE}")
    return stretch, force


def prior_of(plain: FitProblem) -> Floats:
    """Return the prior precisions (p,), with a load of about half the root mean square force."""
    force = np.sqrt(np.mean(plain.stretches[0].drive.u ** 2))
    return np.asarray(np.eye(plain.size)[ROWS.index(OFFSET)] / (0.5 * force) ** 2)


def guess_sum(stretch: ObservedStretch, force: float) -> tuple[float, float, float]:
    """Return mass, viscous and Coulomb friction of both masses together by least squares on smoothed motions.

    Motions faster than the resonance show less than the whole mass, so that the largest mass counts.
    """
    t, u = stretch.times, np.append(stretch.drive.u, 0.0)[stretch.drive.row]
    best, sizes = np.zeros(3), []
    for width in (max(3, int(part * t.size)) for part in TUNING.widths):
        kernel = np.ones(width) / width
        y, force_of, at = (_smooth(column, kernel) for column in (stretch.y - stretch.y[0], u, t))
        v = np.gradient(y, at)
        a = np.gradient(v, at)
        X = np.column_stack([a, v, np.sign(v), np.ones(v.size)])
        size = np.linalg.norm(X, axis=0) + 1e-300
        theta = np.linalg.lstsq(X / size, force_of, rcond=None)[0] / size
        sizes.append(float(np.std(force_of) / (np.std(a) + 1e-300)))
        best = max(best, theta[:3], key=lambda one: float(one[0]))
    mass = float(best[0]) if best[0] > 0 else min(sizes)
    return mass, max(float(best[1]), 0.0), max(float(best[2]), 0.1 * force)


def _smooth(column: Floats, kernel: Floats) -> Floats:
    for _ in range(3):
        column = np.convolve(column, kernel, "valid")
    return column


def _scan(plain: FitProblem, total: Floats) -> Iterator[Floats]:
    """Yield starts q (p,) over resonances and shares of the load."""
    low, high = plain.rate
    count = max(2, round(TUNING.per_octave * math.log2(high / low)))
    for rate, share in product(np.geomspace(low, high, count).tolist(), TUNING.shares):
        yield _share_out(plain, total, share, (rate, TUNING.ratio))


def _scan_gaps(plain: FitProblem, total: Floats, step: float) -> Iterator[Floats]:
    """Yield starts q (p,) over gaps and shares of the load."""
    (stretch,), (rate, ratio) = plain.stretches, PLAY_TUNING.contact
    gaps = np.geomspace(1, max(2, PLAY_TUNING.widest * float(np.ptp(stretch.y)) / plain.resolution), PLAY_TUNING.gaps)
    for gap, share in product((gaps * plain.resolution).tolist(), PLAY_TUNING.shares):
        yield _share_out(plain, total, share, (rate / step, ratio), gap)


def _share_out(plain: FitProblem, total: Floats, share: float, swing: tuple[float, float], *gap: float) -> Floats:
    """Return q (p,) for the sums of mass, viscous and Coulomb friction and the load force (4,), a share of the load in
    the mass, and the resonance [1/s] and damping ratio of the pair."""
    (mass, viscous, coulomb, load), (rate, ratio) = total.tolist(), swing
    motor, second, reduced = mass * (1 - share), mass * share, mass * share * (1 - share)
    spring = (reduced * rate**2, 2 * ratio * rate * reduced)
    pair = (motor, viscous / 2, coulomb / 2, load, second, viscous / 2, coulomb / 2, *spring, *gap)
    return start_at(plain, np.array(pair))

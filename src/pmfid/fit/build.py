"""The construction of a model: noise that settles, and forces that are added and dropped."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmfid.fit.compare import MOST, ODDS
from pmfid.fit.likelihood import Gaussian, Intervals
from pmfid.fit.machine import DELAY, LAGGING
from pmfid.fit.problem import FitProblem, ObservedStretch
from pmfid.fit.search import GAIN, ROUNDS, SETTLED, WITHIN, FitSearch, errors_of, is_near_rounding, mean_square, narrow
from pmfid.fit.shooting import settle_starts
from pmfid.fit.solve import normal_of, solve
from pmfid.fit.starts import MOST_ROWS
from pmfid.types import Floats

#: Most steps of the comparison; most wavenumbers that a record is searched for, those at a time, and the likeliest.
MOST_STEPS, WAVENUMBERS, TOGETHER, LIKELY_WAVES = 12, 500, 50, 5
#: Pieces of a record, each with a start of its own. They judge which noise gives the better motion, and replace a
#: record that no whole motion follows.
PIECES = 16


def complete_readings(search: FitSearch) -> None:
    """Take sine and cosine of each error of the encoder that has one of them, because its phase needs both."""
    words = {search.table[i].words for i in search.chosen if search.table[i].reading is not None}
    wanted = {i for i, one in enumerate(search.table) if one.words in words}
    if not wanted <= set(search.chosen):
        before = set(search.chosen)
        search.choose(sorted(before | wanted))
        search.q[[k for i, k in zip(search.chosen, search.problem.places, strict=True) if i not in before]] = 0.0


def build(search: FitSearch) -> Gaussian | Intervals:
    """Estimate the noise, add and drop forces in this noise, and return the likelihood."""
    return add_forces(search, settle_either(search))


def add_forces(search: FitSearch, kinds: Sequence[str]) -> Gaussian | Intervals:
    """Add and drop forces in noise of some `kinds` until the counts are explained or no force gains evidence, and
    return the likelihood. A set that comes again ends the search, too.
    """
    seen = list[list[int]]()
    for _ in range(0 if search.reaches_bound(search.q) else MOST_STEPS):
        step = search.local(search.noise).best_step(search.chosen, range(len(search.table)))
        with_waves = step is None or not seen  # forces that mimic a wave leave less and less of it
        seen.append(sorted(search.chosen))
        if step in seen or not _take_better(search, step, with_waves):
            break
        search.solve(search.noise)
        if mean_square(search) < WITHIN:
            search.refine()
        explained = search.explain(tries=0)
        if explained is not None:
            return prune(search, explained)
        settle(search, kinds)
    return search.noise


def settle_either(search: FitSearch) -> Sequence[str]:
    """Settle with a force that wanders, and with an error of the position, keep the better end, and return its kind.

    The residuals of a poor fit look like an error of the position, even where a force wanders, and a force that wanders
    predicts the next sample of a wrong model well. The likelier end is kept, unless the other one follows pieces of
    the record better by more than chance makes likely in one of 20 cases (Fisher 1924).
    """
    from scipy.special import fdtri

    if len(search.wandering) == 1:
        settle(search, search.wandering)
        return search.wandering
    before, ends = search.remember(), []
    for kind in search.wandering:
        search.return_to(before)
        settle(search, (kind,))
        ends.append((search.noise.evidence(errors_of(search))[0], square_of_pieces(search), kind, search.remember()))
    best, other = sorted(ends, key=lambda end: -end[0])
    _, _, kind, state = other if other[1] * fdtri(PIECES, PIECES, 0.95) < best[1] else best
    search.return_to(state)
    return (kind,) if search.noise.wanders else search.wandering


def square_of_pieces(search: FitSearch) -> float:
    """Return the mean square of the residuals [counts^2] where each piece of the record has a start of its own."""
    problem = search.problem.cut(PIECES)
    likelihood = Gaussian(problem.stretches)
    starts = settle_starts(problem, likelihood, search.q, problem.first_starts())
    return 2 * likelihood(problem.linearise(search.q, starts))[0] / problem.rows


def settle(search: FitSearch, kinds: Sequence[str]) -> None:
    """Fit and estimate the noise in turn until the mass settles."""
    lead = search.plain.machine.lead
    for _ in range(ROUNDS):
        before = search.q[lead]
        search.noise = search.estimate_noise(kinds)
        search.solve(search.noise)
        if abs(search.q[lead] - before) < SETTLED:
            break


def _alternatives(search: FitSearch, step: Sequence[int]) -> list[Sequence[int]]:
    """Return a set, and the set with a lag in place of a new dead time or the reverse: near zero they are the same."""
    late = {i: one.name for i, one in enumerate(search.table) if one.base in (DELAY, LAGGING)}
    new = [i for i in step if i in late and i not in search.chosen]
    other = [i for i in late if i not in step]
    return [step, sorted([*(i for i in step if i not in new), *other])] if new and other else [step]


def prune(search: FitSearch, likelihood: Intervals) -> Intervals:
    """Drop candidates without which the motion still explains every count."""
    for i in list(search.chosen):
        kept = search.remember()
        search.choose([j for j in search.chosen if j != i])
        search.solve(Gaussian(search.plain.stretches), 10)
        shorter = narrow(search) if is_near_rounding(search) else None
        if shorter is None:
            search.return_to(kept)
        else:
            likelihood = shorter
    return likelihood


def _take_better(search: FitSearch, step: Sequence[int] | None, with_waves: bool) -> bool:
    """Take a set of forces or add a wave, whichever fits better in the present noise, and return whether one does."""
    before, ends = search.remember(), list[tuple[float, dict[str, object]]]()
    if step is not None:
        search.choose_best(_alternatives(search, step))
        ends.append((search.solve(search.noise, 10).cost - ODDS, search.remember()))
        search.return_to(before)
    if with_waves and search.waves and search.noise.wanders and len(search.chosen) < MOST:
        ends += _try_waves(search)
    search.return_to(min(ends, key=lambda end: end[0])[1] if ends else before)
    return bool(ends)


def _try_waves(search: FitSearch) -> list[tuple[float, dict[str, object]]]:
    """Return costs and states with effects that have a period along the travel, if the residuals show one.

    Side lobes of a true period have nearly its gain, so that the strongest waves are tried.
    """
    least = math.log(WAVENUMBERS * len(search.waves)) - 2 * ODDS
    without, before, ends = search.solve(search.noise, 3).cost, search.remember(), []
    for wave in _find_waves(search):
        if wave.gain > least:
            search.return_to(before)
            _take_wave(search, wave)
            ends.append((search.solve(search.noise, 10).cost + least, search.remember()))
    return [end for end in ends if end[0] < without]


@dataclass(frozen=True, eq=False)
class WeighedWave:
    """A wave of a kind: wavenumber [1/unit], gain of log evidence, and sizes (2,) of sine and cosine in prior sds."""

    kind: str
    wavenumber: float
    gain: float
    sizes: Floats


def _find_waves(search: FitSearch) -> list[WeighedWave]:
    """Return the waves with the largest gains, with periods from twice the travel to two steps of the motion."""
    weighed = list[WeighedWave]()
    steps = np.concatenate([np.abs(np.diff(one.y)) for one in search.problem.stretches])
    count = math.ceil(2 * search.sizes.travel / np.mean(steps[steps > 0]))
    wavenumbers = np.arange(1, min(count, WAVENUMBERS) + 1) / (4 * search.sizes.travel)
    for kind in search.waves:
        for chunk in np.array_split(wavenumbers, math.ceil(wavenumbers.size / TOGETHER)):
            weighed += _weigh_waves(search, kind, chunk)
    return sorted(weighed, key=lambda wave: -wave.gain)[:LIKELY_WAVES]


def _weigh_waves(search: FitSearch, kind: str, wavenumbers: Floats) -> list[WeighedWave]:
    """Return the waves of a kind by the beginning of the record, which bounds time and memory."""
    stretches, left = list[ObservedStretch](), MOST_ROWS
    for one in search.noise.stretches:
        stretches += [replace(one.part(0, min(left, one.drive.step.size)), origin=one.base)] if left > 0 else []
        left -= one.drive.step.size
    starts = search.starts[: len(stretches)]
    problem = _with_waves(replace(search.problem, stretches=tuple(stretches)), search, kind, wavenumbers)
    q = np.append(search.q, np.zeros(problem.size - search.q.size))
    noise = replace(search.noise, stretches=stretches)
    normal = normal_of(noise(problem.linearise(q, starts))[1], starts)
    prior = search.prior(problem)
    gains, steps = pair_gains(normal.A + np.diag(prior), normal.g + prior * q, search.q.size)
    return [WeighedWave(kind, *one) for one in zip(wavenumbers.tolist(), gains.tolist(), steps, strict=True)]


def _take_wave(search: FitSearch, wave: WeighedWave) -> None:
    """Add a wave, first as a force of the measured position, and then of the simulated one with a free period."""
    problem = _with_waves(search.problem, search, wave.kind, np.array([wave.wavenumber]))
    q = np.append(search.q, wave.sizes)
    optimum = solve(problem, search.noise, q, search.starts, search.prior(problem), 10, GAIN)
    first = len(search.table)
    search.q, search.starts = optimum.q[:-2], optimum.starts
    search.table = [*search.table, *search.make_waves(wave.kind, wave.wavenumber)]
    search.choose([*search.chosen, first, first + 1])
    places = dict(zip(search.chosen, search.problem.places, strict=True))
    search.q[[places[first], places[first + 1]]] = optimum.q[-2:]


def _with_waves(problem: FitProblem, search: FitSearch, kind: str, wavenumbers: Floats) -> FitProblem:
    """Return the problem with sine and cosine for each wavenumber [1/unit]. A force acts at the measured position,
    because that of the simulated motion may be a period away."""
    pairs = [one for w in wavenumbers.tolist() for one in search.make_waves(kind, w)]
    problem = problem.with_candidates([*problem.candidates, *pairs])
    forces = [one.force for one in pairs if one.force is not None]
    return problem.hold(forces) if forces else problem


def pair_gains(A: Floats, g: Floats, base: int) -> tuple[Floats, Floats]:
    """Return the gain (m,) of log evidence by each of m pairs of parameters after the first `base`, and their steps
    (m, 2)."""
    size = np.sqrt(np.maximum(np.diag(A), 1e-200))
    A, g = A / np.outer(size, size), g / size
    solved = np.linalg.solve(A[:base, :base] + 1e-12 * np.eye(base), np.column_stack([A[:base, base:], g[:base]]))
    inner = A[base:, base:] - A[base:, :base] @ solved[:, :-1]
    pull = g[base:] - A[base:, :base] @ solved[:, -1]
    m = pull.size // 2
    blocks = inner.reshape(m, 2, m, 2)[range(m), :, range(m), :]
    step = np.linalg.solve(blocks + 1e-9 * np.eye(2), pull.reshape(m, 2, 1))[..., 0]
    logs = np.log(np.maximum(np.linalg.det(blocks), 1e-300)) + 2 * np.log(size[base:]).reshape(m, 2).sum(axis=1)
    gains = 0.5 * np.sum(step * pull.reshape(m, 2), axis=1) - 0.5 * logs
    return gains, -step / size[base:].reshape(m, 2)

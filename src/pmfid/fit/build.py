"""The construction of a model: noise that settles, and forces that are added and dropped."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmfid.fit.compare import MOST, ODDS
from pmfid.fit.elastic import settle_starts
from pmfid.fit.likelihood import Gaussian, Intervals
from pmfid.fit.machine import DELAY, LAGGING
from pmfid.fit.search import ROUNDS, SETTLED, FitSearch, errors_of, is_near_rounding, narrow
from pmfid.fit.solve import normal_of
from pmfid.fit.terms import waves
from pmfid.types import Floats

#: Most steps of the comparison, and the number of wavenumbers that a record is searched for.
MOST_STEPS, WAVENUMBERS = 12, 100
#: Pieces of a record, each with a start of its own. They judge which noise gives the better motion, and replace a
#: record that no whole motion follows.
PIECES = 16


@dataclass(frozen=True, eq=False)
class NoiseEnd:
    """The end of a search with one kind of noise: log likelihood, mean square over pieces [counts^2], and the state."""

    likelihood: float
    square: float
    kind: str
    q: Floats
    starts: Floats
    noise: Gaussian


def complete_readings(search: FitSearch) -> None:
    """Take sine and cosine of each error of the encoder that has one of them, because its phase needs both."""
    words = {search.table[i].words for i in search.chosen if search.table[i].reading is not None}
    wanted = {i for i, one in enumerate(search.table) if one.words in words}
    if not wanted <= set(search.chosen):
        before = set(search.chosen)
        search.choose(sorted(before | wanted))
        search.q[[k for i, k in zip(search.chosen, search.problem.places, strict=True) if i not in before]] = 0.0


def build(search: FitSearch) -> Gaussian | Intervals:
    """Add and drop forces until the counts are explained or no force gains evidence, and return the likelihood.

    A set that comes again ends the search, too.
    """
    kinds, seen = settle_either(search), list[list[int]]()
    for _ in range(0 if search.reaches_bound(search.q) else MOST_STEPS):
        seen.append(sorted(search.chosen))
        step = search.local(search.noise).best_step(search.chosen, range(len(search.table)))
        if step in seen:
            break
        if step is not None:
            search.choose_best(_alternatives(search, step))
        elif not (search.waves and search.noise.wanders and len(search.chosen) < MOST and _add_wave(search)):
            break
        search.solve(search.noise)
        explained = search.explain(tries=0)
        if explained is not None:
            return prune(search, explained)
        settle(search, kinds)
    return search.noise


def settle_either(search: FitSearch) -> Sequence[str]:
    """Settle with a force that wanders, and with an error of the position, keep the better end, and return its kind.

    The residuals of a poor fit look like an error of the position, even where a force wanders, and a force that wanders
    predicts the next sample of a wrong model well. The likelier end is kept, unless the other one follows pieces of
    the record better by more than chance (Fisher 1924).
    """
    if len(search.wandering) == 1:
        settle(search, search.wandering)
        return search.wandering
    at, ends = (search.q, search.starts, search.noise), []
    for kind in search.wandering:
        search.q, search.starts, search.noise = at
        settle(search, (kind,))
        likelihood = search.noise.evidence(errors_of(search))[0]
        ends.append(NoiseEnd(likelihood, square_of_pieces(search), kind, search.q, search.starts, search.noise))
    best, other = sorted(ends, key=lambda end: -end.likelihood)
    if other.square * _most_by_chance() < best.square:
        best = other
    search.q, search.starts, search.noise = best.q, best.starts, best.noise
    return (best.kind,) if search.noise.wanders else search.wandering


def square_of_pieces(search: FitSearch) -> float:
    """Return the mean square of the residuals [counts^2] where each piece of the record has a start of its own."""
    problem = search.problem.cut(PIECES)
    likelihood = Gaussian(problem.stretches)
    starts = settle_starts(problem, likelihood, search.q, problem.first_starts())
    return 2 * likelihood(problem.linearise(search.q, starts))[0] / problem.rows


def _most_by_chance() -> float:
    """Return the ratio of two mean squares over PIECES pieces that chance exceeds in one of 20 cases."""
    from scipy.stats import f

    return float(f.ppf(0.95, PIECES, PIECES))


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


def prune(search: FitSearch, likelihood: Intervals, fewest: int = 1) -> Intervals:
    """Drop candidates without which the motion still explains every count, down to `fewest` candidates."""
    for i in list(search.chosen):
        if len(search.chosen) <= fewest:
            break
        kept = search.remember()
        search.choose([j for j in search.chosen if j != i])
        shorter = narrow(search) if _follows(search) else None
        if shorter is None:
            search.return_to(kept)
        else:
            likelihood = shorter
    return likelihood


def _follows(search: FitSearch) -> bool:
    """Return whether least squares ends near rounding."""
    search.solve(Gaussian(search.plain.stretches), 10)
    return is_near_rounding(search)


def _add_wave(search: FitSearch) -> bool:
    """Add the effect with a period along the travel that the residuals show best, if they show one."""
    reach = 2 * search.sizes.travel
    kind, wavenumber, gain = _strongest(search, np.arange(1, WAVENUMBERS + 1) / (2 * reach), search.waves)
    step = 1 / (2 * reach)
    for _ in range(3):
        step /= 4
        nearby = wavenumber + step * np.arange(-3, 4)
        _, wavenumber, gain = _strongest(search, np.asarray(nearby[nearby > 0]), (kind,))
    if gain < math.log(WAVENUMBERS * len(search.waves)) - 2 * ODDS:
        return False
    size = search.problem.resolution * 3 if not kind else 0.3 * search.sizes.coulomb
    first = len(search.table)
    search.table = [*search.table, *waves(kind, 1 / wavenumber, size)]
    search.choose([*search.chosen, first, first + 1])
    return True


def _strongest(search: FitSearch, wavenumbers: Floats, kinds: Sequence[str]) -> tuple[str, float, float]:
    """Return kind, wavenumber [1/unit] and gain of log evidence of the strongest wave."""
    best = ("", 0.0, -math.inf)
    for kind in kinds:
        size = search.problem.resolution * 3 if not kind else 0.3 * search.sizes.coulomb
        pairs = [one for w in wavenumbers.tolist() for one in waves(kind, 1 / w, size)]
        problem = replace(search.problem, candidates=(*search.problem.candidates, *pairs))
        q = np.append(search.q, np.zeros(len(pairs)))
        normal = normal_of(search.noise(problem.linearise(q, search.starts))[1], search.starts)
        prior = search.prior(problem)
        gains = pair_gains(normal.A + np.diag(prior), normal.g + prior * q, search.q.size)
        top = int(np.argmax(gains))
        if gains[top] > best[2]:
            best = (kind, float(wavenumbers[top]), float(gains[top]))
    return best


def pair_gains(A: Floats, g: Floats, base: int) -> Floats:
    """Return the gain (m,) of log evidence by each of m pairs of parameters after the first `base`."""
    size = np.sqrt(np.maximum(np.diag(A), 1e-200))
    A, g = A / np.outer(size, size), g / size
    solved = np.linalg.solve(A[:base, :base] + 1e-12 * np.eye(base), np.column_stack([A[:base, base:], g[:base]]))
    inner = A[base:, base:] - A[base:, :base] @ solved[:, :-1]
    pull = g[base:] - A[base:, :base] @ solved[:, -1]
    m = pull.size // 2
    blocks = inner.reshape(m, 2, m, 2)[range(m), :, range(m), :]
    step = np.linalg.solve(blocks + 1e-9 * np.eye(2), pull.reshape(m, 2, 1))[..., 0]
    logs = np.log(np.maximum(np.linalg.det(blocks), 1e-300)) + 2 * np.log(size[base:]).reshape(m, 2).sum(axis=1)
    return np.asarray(0.5 * np.sum(step * pull.reshape(m, 2), axis=1) - 0.5 * logs)

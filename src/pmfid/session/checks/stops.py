"""Stretches of equal counts in which the axis does not rest.

An axis cannot stop within a sample if its deceleration elsewhere is far smaller, and it cannot rest under a force far
above its friction. The first rule works for fine counts, the second for coarse ones.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmfid.judge.counts import counts_per_sample
from pmfid.session.checks.view import COULOMB, MASS, VISCOUS, View, solve_least_squares
from pmfid.types import Counts, Floats

__all__ = ["Stop", "held_back", "long_stops", "sudden"]

#: First and last sample of equal counts.
Stop = tuple[int, int]

#: Spans over which the edges of a stop are examined [samples]; least turn of the motion at an abrupt edge [counts].
SPANS, COUNTS = (1, 2, 4, 8, 16, 32), 6
#: Least ratio of the turn of the motion at an abrupt stop to the largest turn elsewhere.
ABRUPT = 2.5
#: A stop that the axis leaves slowly or never: the factor by which its limit is higher. With SEVERAL stops or more, its
#: turn must also exceed ABRUPT times the median of all stops.
DEAD, SEVERAL = 2.0, 3
#: Least part of the record outside of stops for this comparison.
APART = 0.2
#: Least samples of a stop; least counts that the usual speed would have brought within it.
SHORTEST, MISSED = 5, 4.0
#: Least part of the rows outside of stops: a column of steps has none.
MOVING = 0.05
#: An axis does not rest under a force above HELD times its friction, but for LATE samples, as with a dead time; the
#: axis would have moved by FAR counts.
HELD, LATE, FAR = 2.2, 5, 8.0
#: Most stops that are examined, the longest first.
MOST = 1000


def long_stops(counts: Counts) -> list[Stop]:
    """Every stretch of equal counts after the first change that is long against the time between two counts."""
    moving: NDArray[np.intp] = np.flatnonzero(np.diff(counts))
    if moving.size < 2:
        return []
    least = max(float(SHORTEST), MISSED / max(counts_per_sample(counts), 1e-9))
    pairs = zip((moving + 1).tolist(), [*moving[1:].tolist(), counts.size - 1], strict=True)
    stops = [(first, last) for first, last in pairs if last - first >= least]
    resting = sum(last - first for first, last in stops)
    if resting > (1 - MOVING) * counts.size:
        return []
    return sorted(sorted(stops, key=lambda stop: stop[0] - stop[1])[:MOST])


def sudden(counts: Counts, stops: list[Stop]) -> set[Stop]:
    """The stops that begin in full motion, and that end in motion or begin too suddenly for the axis itself."""
    edges = (counts == counts.min()) | (counts == counts.max())
    edges[[edge for stop in stops for edge in stop]] = True
    found = set[Stop]()
    for span in SPANS:
        if counts.size < 4 * span:
            break
        turn = np.zeros(counts.size)
        turn[span:-span] = np.abs(counts[2 * span :] - 2 * counts[span:-span] + counts[: -2 * span])
        apart = ~_widen_marks(edges, span)
        if np.mean(apart) < APART:
            break
        long_ones = [stop for stop in stops if stop[1] - stop[0] >= span]
        found |= _abrupt(turn, long_ones, float(np.max(turn[apart])))
    return found


def _abrupt(turn: Floats, stops: list[Stop], elsewhere: float) -> set[Stop]:
    """The stops at whose ends the turn of the motion (n,) far exceeds the turn elsewhere."""
    limit = max(ABRUPT * (elsewhere + 1), COUNTS)
    begins, ends = (np.array([turn[stop[side]] for stop in stops]) for side in (0, 1))
    # a counter that catches up jumps to where it should be: the larger edge then says more than the smaller one
    both = (np.sqrt(begins * ends) >= limit) & (np.minimum(begins, ends) > elsewhere + 1)
    usual = float(np.median(begins)) if begins.size else 0.0
    dead = (begins >= DEAD * limit) & (begins >= ABRUPT * (usual + 1) if begins.size >= SEVERAL else True)
    return {stop for stop, yes in zip(stops, both | dead, strict=True) if yes}


def held_back(force: Floats, stops: list[Stop], view: View, offset: int, dt: float, resolution: float) -> set[Stop]:
    """The stops in which the input `force` (n,) would have moved the axis; view: the filtered rows from the offset
    on."""
    rows = np.arange(view.z.size) + offset
    memory = round(3 * view.time)
    resting = np.zeros(force.size, dtype=bool)
    for first, last in stops:
        resting[first : last + memory] = True
    keep = ~resting[rows]
    if np.mean(keep) < MOVING:
        return set()
    theta = solve_least_squares(view.phi[keep], view.z[keep])
    if not (theta[MASS] > 0 and theta[COULOMB] >= 0):
        return set()
    return {stop for stop in stops if _moves(force[stop[0] : stop[1]], theta, dt) > FAR * resolution}


def _moves(force: Floats, theta: Floats, dt: float) -> float:
    """How far a force (n,) moves a body of theta from rest, at the least."""
    load = theta[3] if theta.size > 3 else 0.0
    moved = 0.0
    for sign in (1.0, -1.0):
        above = sign * (force - load) - HELD * theta[COULOMB]
        breaks = np.flatnonzero(np.diff(np.r_[0, above > 0, 0]))
        for first, last in zip(breaks[::2].tolist(), breaks[1::2].tolist(), strict=True):
            time = dt * max(0, last - first - LATE)
            push = float(np.mean(above[first:last]))
            fastest = push / max(float(theta[VISCOUS]), 1e-300) if theta[VISCOUS] > 0 else np.inf
            moved = max(moved, min(push / float(theta[MASS]) * time**2 / 2, fastest * time))
    return moved


def _widen_marks(marked: NDArray[np.bool_], span: int) -> NDArray[np.bool_]:
    """(n,): the marked samples, and `span` samples to either side."""
    return np.asarray(np.convolve(marked, np.ones(2 * span + 1), mode="same") > 0.5)

"""Upper bounds of the value that any input can reach."""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count

import numpy as np
from scipy.linalg import null_space

from pmfid.design.ascent import best_mixture, proportions, share
from pmfid.design.fisher import Affine, Criterion, affine
from pmfid.design.oracle import EmptyError, Oracle
from pmfid.design.polytope import EQUAL, SOLVER_PRECISION, input_set
from pmfid.design.problem import Problem
from pmfid.types import Floats

#: Share of the chords' gap that is worth narrowing. Another round must take away `BOUNDS_PROGRESS` of the excess.
#: More rounds do not help a part that has to be halved in any case.
BOUNDS_WORTH = 0.9
BOUNDS_PROGRESS = 0.15
BOUNDS_ROUNDS = 2
#: Number of vertices that a node remembers for mixtures.
BOUNDS_REMEMBERED = 80
LEAST_GAIN = 0.02
#: Error that the tolerances of the linear solver may add to a bound, in units of the incumbent's value.
SLACK_OF_BOUND = 1e-6

__all__ = ["Box", "WeightFrame", "frame"]


@dataclass(frozen=True, eq=False)
class WeightFrame:
    """A coordinate frame in which trace(weight F(u)) is |matrix u + offset|^2 + constant.

    The quadratic form holds for all inputs u that meet the equations of the limits. `weight` (p, p) is positive
    semidefinite. `matrix` (r, K) and `offset` (r,) have the largest coordinates first.
    """

    weight: Floats
    matrix: Floats
    offset: Floats
    constant: float


@dataclass(eq=False)
class Box:
    """Ranges lower <= z <= upper (r,) of a frame's coordinates over a part of the inputs."""

    lower: Floats
    upper: Floats

    @property
    def slope(self) -> Floats:
        """Slopes (r,) of the chords, for which z^2 <= slope z - lower upper inside the box."""
        return self.lower + self.upper

    def chords(self, z: Floats) -> float:
        """Return the sum of the chords at z, which is an upper bound of |z|^2."""
        return float(self.slope @ z - self.lower @ self.upper)

    def gaps(self, z: Floats) -> Floats:
        """Return the amount by which each chord is too high at z."""
        return np.maximum(0.0, (self.upper - z) * (z - self.lower))

    def copy(self) -> Box:
        return Box(self.lower.copy(), self.upper.copy())

    def measure(self, j: int, extreme: Callable[[Floats], Floats], where: WeightFrame) -> list[Floats]:
        """Narrow range j to the values that the inputs allow, and return the two inputs at its ends."""
        row, offset = where.matrix[j], where.offset[j]
        ends = [extreme(row), extreme(-row)]
        self.upper[j] = min(self.upper[j], row @ ends[0] + offset + SOLVER_PRECISION)
        self.lower[j] = max(self.lower[j], row @ ends[1] + offset - SOLVER_PRECISION)
        return ends


def frame(maps: Affine, weight: Floats, directions: Floats, u: Floats) -> WeightFrame:
    """Return the frame of a weight.

    The columns of `directions` (K, q) are the directions in which the equations let the input u move.
    """
    p = len(maps.scale)
    eigenvalues, vectors = np.linalg.eigh(weight)
    root = (vectors * np.sqrt(np.maximum(eigenvalues, 0.0))) @ vectors.T
    M = (root @ maps.matrix.reshape(p, -1)).reshape(maps.matrix.shape)
    here = (root @ maps.weigh_sensitivities(u)).ravel()
    basis = np.linalg.svd(M @ directions, full_matrices=False)[0].T
    z = basis @ here
    constant = float(here @ here - z @ z + np.sum(weight * maps.prior))
    matrix = basis @ M
    return WeightFrame(weight, matrix, z - matrix @ u, constant)


@dataclass(eq=False)
class _Node:
    """A part of the inputs, cut out by `rows` of (normal, lower, upper).

    `bound` is in units of the incumbent's value.
    """

    rows: list[tuple[Floats, float, float]]
    frame: WeightFrame
    box: Box
    bound: float = np.inf
    z: Floats = field(default_factory=lambda: np.zeros(0))
    seen: list[Floats] = field(default_factory=list)
    apart: tuple[Floats, Floats] | None = None


def upper_bound(
    problem: Problem, rule: Criterion, u: Floats, *, gap: float = 0.01, seconds: float = 60.0
) -> float | None:
    """Return an upper bound of the criterion's value over all inputs, or None for ME, which has no tangent.

    If time suffices, the bound is at most 1 + gap times the value of the input u (K,). `u` must be feasible. A better u
    makes the search faster. `seconds` is processor time, so the proof on a busy machine is as good.
    """
    if not rule.concave:
        return None
    search = _BoundSearch(problem, rule, u, gap, time.thread_time() + seconds)
    return search.run() * search.value


class _BoundSearch:
    def __init__(self, problem: Problem, rule: Criterion, u: Floats, gap: float, until: float) -> None:
        self.maps: Affine = affine(problem)
        self.rule, self.u, self.until = rule, u, until
        self.target = 1.0 + gap
        self.value = rule.value(self.maps.information(u))
        inputs = input_set(problem)
        self.oracle = Oracle(inputs)
        self.oracle.feasible()
        equations = inputs.matrix[inputs.upper - inputs.lower <= EQUAL]
        self.directions = null_space(equations) if len(equations) else np.eye(problem.intervals)
        self.order = count()
        self.heap: list[tuple[float, int, _Node]] = []

    def run(self) -> float:
        """Return the bound over the incumbent's value."""
        root = self._root()
        self._push(root)
        while self.heap and -self.heap[0][0] > self.target and time.thread_time() < self.until:
            node = heapq.heappop(self.heap)[2]
            for child in self._halves(node):
                self._close(child)
                self._push(child)
        return max(1.0, self.target if not self.heap else -self.heap[0][0])

    def _push(self, node: _Node) -> None:
        if node.bound > self.target:
            heapq.heappush(self.heap, (-node.bound, next(self.order), node))

    def _root(self) -> _Node:
        weight = share(self.rule, best_mixture(self.maps, self.rule, self.oracle, self.u)) / self.value
        node = self._make_node([], weight, [self.u])
        self._close(node)
        return node

    def _make_node(self, rows: list[tuple[Floats, float, float]], weight: Floats, seen: list[Floats]) -> _Node:
        """Return the part that the rows cut out, in the frame of a weight, with all ranges measured."""
        self._enter(rows)
        where = frame(self.maps, weight, self.directions, self.u)
        size = len(where.offset)
        box = Box(np.full(size, -np.inf), np.full(size, np.inf))
        for j in range(size):
            seen += box.measure(j, self.oracle.maximise_relaxed, where)
        node = _Node(rows, where, box, seen=seen[-BOUNDS_REMEMBERED:])
        self._bound(node)
        return node

    def _enter(self, rows: list[tuple[Floats, float, float]]) -> None:
        self.oracle.start()
        for normal, lower, upper in rows:
            self.oracle.restrict(normal, lower, upper)

    def _bound(self, node: _Node) -> None:
        where, box = node.frame, node.box
        vertex = self.oracle.maximise_relaxed(where.matrix.T @ box.slope)
        node.z = where.matrix @ vertex + where.offset
        node.bound = min(node.bound, box.chords(node.z) + where.constant + SLACK_OF_BOUND)
        node.seen.append(vertex)

    def _close(self, node: _Node) -> None:
        """Narrow the part until no input in the part exceeds the target, or until narrowing does not help."""
        try:
            if node.rows:
                self._enter(node.rows)
                self._bound(node)
            self._narrow(node)
            if node.bound > self.target and len(self.maps.scale) > 1:
                self._turn(node)
        except EmptyError:
            node.bound = -np.inf

    def _narrow(self, node: _Node) -> None:
        for _ in range(BOUNDS_ROUNDS):
            before = node.bound
            if before <= self.target or time.thread_time() > self.until:
                return
            self._measure(node)
            self._bound(node)
            if node.bound - 1.0 > (1.0 - BOUNDS_PROGRESS) * (before - 1.0):
                return

    def _measure(self, node: _Node) -> None:
        """Measure the coordinates with the largest gaps, over the inputs whose chords reach the target."""
        where, box = node.frame, node.box
        gaps = box.gaps(node.z)
        order = np.argsort(-gaps)
        much = int(np.searchsorted(np.cumsum(gaps[order]), BOUNDS_WORTH * gaps.sum())) + 1
        slope = box.slope
        least = self.target - where.constant + float(box.lower @ box.upper - slope @ where.offset)
        row = self.oracle.restrict(where.matrix.T @ slope, least - SLACK_OF_BOUND, np.inf)
        for j in order[:much]:
            node.seen += box.measure(j, self.oracle.maximise_relaxed, where)
        self.oracle.release(row)
        del node.seen[:-BOUNDS_REMEMBERED]

    def _turn(self, node: _Node) -> None:
        """Take the tangent at the best mixture of known inputs, if the present tangent is too high."""
        if len(node.seen) < 2 or time.thread_time() > self.until:
            return
        informations = np.array([self.maps.information(u) for u in node.seen])
        truth = np.tensordot(informations, node.frame.weight, 2).max()
        if truth <= (1.0 + self.target) / 2.0:
            return  # The chords are too high here, and the tangent is good enough.
        weights = proportions(self.rule, informations, 300)
        first, second = np.argsort(-weights)[:2]
        node.apart = (node.seen[first], node.seen[second])
        mean = np.tensordot(weights, informations, 1)
        if self.rule.value(mean) / self.value < truth - LEAST_GAIN:
            other = self._make_node(node.rows, share(self.rule, mean) / self.value, list(node.seen))
            self._narrow(other)
            if other.bound < node.bound:
                node.frame, node.box, node.z, node.bound = other.frame, other.box, other.z, other.bound

    def _halves(self, node: _Node) -> list[_Node]:
        where, box = node.frame, node.box
        gaps = box.gaps(node.z)
        j = int(np.argmax(gaps))
        middle = (box.lower[j] + box.upper[j]) / 2.0
        if node.apart and gaps.sum() < (node.bound - 1.0) / 2.0:
            # The chords are tight, so only motions on different sides keep the mixture above the target.
            j, middle = _find_split(where, box, *node.apart)
        halves: list[_Node] = []
        for side in (box.copy(), box.copy()):
            (side.upper if not halves else side.lower)[j] = middle
            row = (where.matrix[j], side.lower[j] - where.offset[j], side.upper[j] - where.offset[j])
            halves.append(_Node([*node.rows, row], where, side, node.bound, seen=[]))
        return halves


def _find_split(where: WeightFrame, box: Box, one: Floats, other: Floats) -> tuple[int, float]:
    """Return the coordinate in which two inputs differ most, and its middle value, well inside the box."""
    a, b = where.matrix @ one + where.offset, where.matrix @ other + where.offset
    j = int(np.argmax(np.abs(a - b)))
    margin = 0.1 * (box.upper[j] - box.lower[j])
    return j, float(np.clip((a[j] + b[j]) / 2.0, box.lower[j] + margin, box.upper[j] - margin))

"""From one input uphill: steps to vertices, and the same motion a little earlier or later.

The information is a convex quadratic of the input, so a criterion has many local optima. A step goes towards the vertex
that is best for the criterion's gradient, with the exact maximum on the way there (Frank and Wolfe 1956); the
neighbours of a local optimum are the vertices found at its shifted copies.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pmfid.design.criteria import Criterion
from pmfid.design.fisher import Affine
from pmfid.design.oracle import Oracle
from pmfid.design.problem import Float

__all__ = ["Climber"]

#: Part of the way to the vertex, first for all, then between the neighbours of the best.
STEPS = np.array([1.0, 0.75, 0.5, 0.35, 0.25, 0.15, 0.1, 0.05, 0.02, 0.005])
#: Shifts of the motion, in fortieths of the horizon.
SHIFTS = (1, -1, 4, -4, 16, -16)
#: Relative gain below which a step, or another local optimum, counts for nothing.
TOLERANCE = 1e-4
SAME = 1e-5


@dataclass
class Climber:
    """Searches local optima; remembers those it has met, so that none is left twice.

    maps, criterion, oracle: of one problem. Not for use by two threads at once.
    """

    maps: Affine
    criterion: Criterion
    oracle: Oracle
    _known: list[tuple[float, Float, float, Float]] = field(default_factory=list)

    def start(self, rng: np.random.Generator) -> tuple[float, Float]:
        """(log value, input (K,)) of the best found from a random vertex."""
        self.oracle.start()
        return self.climb(self.oracle.maximise(rng.standard_normal(self.oracle.shape.inputs)))

    def climb(self, u: Float) -> tuple[float, Float]:
        """(log value, input) of the local optimum above u that no shift improves."""
        value, u = self.ascend(u)
        met = []
        shifts, place, failed = self._shifts(), 0, 0
        while failed < len(shifts):
            known = self._recall(value, u)
            if known is not None:
                value, u = known
                break
            if not failed:
                met.append((value, u))
            better = self._neighbour(value, u, shifts[place % len(shifts)])
            place, failed = place + 1, failed + 1
            if better is not None:
                (value, u), failed = better, 0
        self._known += [(*local, value, u) for local in met]
        return value, u

    def ascend(self, u: Float, tolerance: float = TOLERANCE, steps: int = 60) -> tuple[float, Float]:
        """(log value, input) where no vertex promises a relative gain of more than the tolerance."""
        s = self.maps.weighted(u)
        value = float(self.criterion.log_value(s @ s.T + self.maps.prior))
        for _ in range(steps):
            slope = self._slope(s)
            vertex = self.oracle.maximise(slope)
            if slope @ (vertex - u) < tolerance:
                break
            change = self.maps.weighted(vertex) - s
            part, new = self._line(s, change)
            if new <= value:
                break
            u, s, value = u + part * (vertex - u), s + part * change, new
        return value, u

    def _slope(self, s: Float) -> Float:
        """Gradient of the log value to the input, from the weighted sensitivities (p, N)."""
        weight = self.criterion.gradient(s @ s.T + self.maps.prior)
        return np.asarray(self.maps.matrix.T @ (2.0 * (weight @ s)).ravel())

    def _line(self, s: Float, change: Float) -> tuple[float, float]:
        """(part of the way, log value) of the maximum between s and s + change: there F is a quadratic of the part."""
        constant = s @ s.T + self.maps.prior
        cross = s @ change.T
        linear, square = cross + cross.T, change @ change.T

        def best(parts: Float) -> tuple[int, float]:
            a = parts[:, None, None]
            values = self.criterion.log_value(constant + a * linear + a * a * square)
            i = int(values.argmax())
            return i, float(values[i])

        i, value = best(STEPS)
        if i == 0 or i == len(STEPS) - 1:
            return float(STEPS[i]), value
        parts = np.linspace(STEPS[i + 1], STEPS[i - 1], 17)
        i, value = best(parts)
        return float(parts[i]), value

    def _neighbour(self, value: float, u: Float, shift: int) -> tuple[float, Float] | None:
        """A better local optimum that the shifted input leads to, or None."""
        moved = np.clip(np.arange(len(u)) - shift, 0, len(u) - 1)
        vertex = self.oracle.maximise(self._slope(self.maps.weighted(u[moved])))
        if np.allclose(vertex, u, rtol=0.0, atol=1e-6 * np.abs(u).max()):
            return None
        other, u = self.ascend(vertex)
        return (other, u) if other > value + SAME else None

    def _shifts(self) -> list[int]:
        size = self.oracle.shape.inputs
        return list(dict.fromkeys(s for n in SHIFTS if 0 < abs(s := n * max(1, round(size / 40))) < size))

    def _recall(self, value: float, u: Float) -> tuple[float, Float] | None:
        """Where the search from this local optimum has ended before."""
        scale = 0.02 * float(np.abs(u).max())
        for seen, where, best, best_u in self._known:
            if abs(seen - value) < TOLERANCE and np.abs(where - u).max() < scale:
                return (best, best_u) if best > value else (value, u)
        return None

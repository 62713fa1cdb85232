"""Ascent of the information."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from pmfid.design.fisher import Affine, Criterion
from pmfid.design.oracle import Oracle
from pmfid.types import Floats

#: Shifts of the motion, in fortieths of the horizon.
ASCENT_SHIFTS = (1, -1, 4, -4, 16, -16)
#: Relative gain below which a step, or another local optimum, does not count.
ASCENT_TOLERANCE = 1e-4
ASCENT_SAME = 1e-5
#: Largest distance ahead of a full step at which the next gradient is taken, in steps.
ASCENT_FURTHEST = 8.0
#: Relative gain of a full step below which the step is only a drift.
ASCENT_DRIFT = 0.05
#: Largest excess of a motion over its share at which the weights count as converged. Smaller weights become 0.
ASCENT_ENOUGH = 1e-6
ASCENT_ROUNDS = 2000
#: Largest number of new motions, and the number of starts in the search for each motion.
ASCENT_MOTIONS = 30
ASCENT_SEARCHES = 4

__all__ = ["Climber"]

#: Parts of the way to the vertex. The search tries all of them first, then a finer set between the neighbours of the
#: best.
STEPS = np.array([1.0, 0.75, 0.5, 0.35, 0.25, 0.15, 0.1, 0.05, 0.02, 0.005])


@dataclass
class Climber:
    """A search for local optima that remembers the optima it has met.

    A remembered optimum is not left a second time. Two threads must not share one climber.
    """

    maps: Affine
    criterion: Criterion
    oracle: Oracle
    _known: list[tuple[float, Floats, float, Floats]] = field(default_factory=list)

    def start(self, rng: np.random.Generator) -> tuple[float, Floats]:
        """Return the log value and the input (K,) of the best local optimum found from a random vertex."""
        self.oracle.start()
        return self.climb(self.oracle.maximise(rng.standard_normal(self.oracle.inputs.size)))

    def climb(self, u: Floats) -> tuple[float, Floats]:
        """Return the log value and the input of the local optimum above u that no shift improves."""
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

    def ascend(self, u: Floats, tolerance: float = ASCENT_TOLERANCE, steps: int = 60) -> tuple[float, Floats]:
        """Climb from u until no vertex promises a relative gain above the tolerance, and return the log value and
        input.
        """
        s = self.maps.weigh_sensitivities(u)
        value = float(self.criterion.log_value(self._information(s)))
        ahead, drift, change = 0.0, 0, s
        for _ in range(steps):
            # Pulses drift towards their best place interval by interval. The gradient at a point ahead of the present
            # input therefore saves steps.
            slope = self._slope(s + ahead * change if ahead else s)
            vertex = self.oracle.maximise(slope)
            gain = float(slope @ (vertex - u))
            if not ahead and gain < tolerance:
                break
            change = self.maps.weigh_sensitivities(vertex) - s
            part, new = self._line(s, change)
            if new > value + ASCENT_SAME * bool(ahead):
                u, value = u + part * (vertex - u), new
                s = s + part * change
                drift = drift + 1 if part == 1.0 and gain < ASCENT_DRIFT else 0
                ahead = min(2.0 * ahead + 1.0, ASCENT_FURTHEST) if drift > 1 else 0.0
            elif ahead:
                ahead, drift = 0.0, 0
            else:
                break
        return value, u

    def _information(self, s: Floats) -> Floats:
        return np.asarray(s @ s.T + self.maps.prior)

    def _slope(self, s: Floats) -> Floats:
        """Return the gradient of the log value by the input, from the weighted sensitivities (p, N)."""
        weight = self.criterion.gradient(self._information(s))
        return np.asarray(self.maps.matrix.T @ (2.0 * (weight @ s)).ravel())

    def _line(self, s: Floats, change: Floats) -> tuple[float, float]:
        """Return the part of the way from s to s + change at which the log value is largest, and this value.

        The information F is a quadratic function of this part.
        """
        cross = s @ change.T
        constant, linear, square = self._information(s), cross + cross.T, change @ change.T

        def best(parts: Floats) -> tuple[int, float]:
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

    def _neighbour(self, value: float, u: Floats, shift: int) -> tuple[float, Floats] | None:
        """Return a better local optimum that the shifted input leads to, or None."""
        moved = np.clip(np.arange(len(u)) - shift, 0, len(u) - 1)
        vertex = self.oracle.maximise(self._slope(self.maps.weigh_sensitivities(u[moved])))
        if np.allclose(vertex, u, rtol=0.0, atol=1e-6 * np.abs(u).max()):
            return None
        other, u = self.ascend(vertex)
        return (other, u) if other > value + ASCENT_SAME else None

    def _shifts(self) -> list[int]:
        size = self.oracle.inputs.size
        return list(dict.fromkeys(s for n in ASCENT_SHIFTS if 0 < abs(s := n * max(1, round(size / 40))) < size))

    def _recall(self, value: float, u: Floats) -> tuple[float, Floats] | None:
        """Return the best value and input known from an earlier search at this local optimum, or None."""
        scale = 0.02 * float(np.abs(u).max())
        for seen, where, best, best_u in self._known:
            if abs(seen - value) < ASCENT_TOLERANCE and np.abs(where - u).max() < scale:
                return (best, best_u) if best > value else (value, u)
        return None


def proportions(rule: Criterion, informations: Floats, rounds: int = ASCENT_ROUNDS) -> Floats:
    """Return the weights (m,) with which a mixture of informations (m, p, p) has the largest criterion.

    The weights sum to 1. The multiplicative steps are from Silvey, Titterington and Torsney (1978).
    """
    weights = np.full(len(informations), 1.0 / len(informations))
    for _ in range(rounds):
        mean = np.tensordot(weights, informations, 1)
        shares = np.tensordot(informations, rule.gradient(mean), 2)
        if shares.max() < 1.0 + ASCENT_ENOUGH:
            break
        weights = weights * np.maximum(shares, 0.0) ** 0.9
        weights /= weights.sum()
    return np.where(weights < ASCENT_ENOUGH, 0.0, weights)


def share(rule: Criterion, mean: Floats) -> Floats:
    """Return the matrix W (p, p) with value(F) <= trace(W F) for every information F, with equality at the mean.

    The criteria are homogeneous and concave in F, so that the tangent at the mean is an upper bound.
    """
    return rule.gradient(mean) * rule.value(mean)


def best_mixture(maps: Affine, rule: Criterion, oracle: Oracle, u: Floats) -> Floats:
    """Return the information (p, p) of the best mixture of inputs that the search finds from u (K,).

    Each step of the mixture adds the input with the largest share of the tangent (Fedorov 1972, Wynn 1970).
    """
    rng, inputs = np.random.default_rng(0), [u]
    for _ in range(ASCENT_MOTIONS):
        informations = np.array([maps.information(u) for u in inputs])
        weights = proportions(rule, informations)
        mean = np.tensordot(weights, informations, 1)
        u = _largest_share(maps, rule.gradient(mean), oracle, rng)
        inputs = [v for v, weight in zip(inputs, weights, strict=True) if weight > 0]
        if np.sum(rule.gradient(mean) * maps.information(u)) < 1.001:
            break
        inputs.append(u)
    return np.asarray(mean)


def _largest_share(maps: Affine, weight: Floats, oracle: Oracle, rng: np.random.Generator) -> Floats:
    """Return the input with the largest trace(weight F(u)) that a few local searches find.

    Full steps climb, because the trace is a convex function of the input.
    """
    climber = Climber(_rotate_maps(maps, weight), Criterion("trace", len(maps.scale)), oracle)
    return max((climber.start(rng) for _ in range(ASCENT_SEARCHES)), key=lambda found: found[0])[1]


def _rotate_maps(maps: Affine, weight: Floats) -> Affine:
    """Return rotated maps, for which the plain trace equals trace(weight F)."""
    eigenvalues, vectors = np.linalg.eigh(weight)
    root = (vectors * np.sqrt(np.maximum(eigenvalues, 0.0))) @ vectors.T
    p = len(weight)
    return replace(
        maps,
        matrix=(root @ maps.matrix.reshape(p, -1)).reshape(maps.matrix.shape),
        offset=(root @ maps.offset.reshape(p, -1)).ravel(),
        prior=root @ maps.prior @ root,
    )

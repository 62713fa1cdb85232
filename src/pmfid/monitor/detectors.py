"""Detectors of a change, on standardised block deviations x and their information w (see `scores.Scale`).

Each is a frozen configuration with `start` and `update`; the state is a tuple of arrays, so that one call serves one
axis or many simulated ones at once. The statistic grows with the evidence for a change of any parameter in either
direction; what it may reach by chance is the business of `calibration`. A block without information changes nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from typing import ClassVar, Protocol

import numpy as np

from pmfid.monitor.names import DetectorName
from pmfid.types import Floats

State = tuple[Floats, ...]

#: The encoder's error is differentiated: sums of a few blocks have that much more variance than their information says,
#: and sums of many no more than that.
EDGE = 1.0


class Detector(Protocol):
    """name: as in AXIS.toml; tolerance: (p,) deviations in standard deviations that are no change."""

    name: ClassVar[DetectorName]

    def start(self, shape: tuple[int, ...]) -> State:
        """The state before the first block; shape: (..., p) of x."""
        ...

    def update(self, state: State, x: Floats, w: Floats, tolerance: Floats) -> tuple[State, Floats]:
        """The state after a block x, w: (..., p), and the statistic (...,)."""
        ...


@dataclass(frozen=True)
class Cusum:
    """Two-sided cumulative sum (Page 1954): g = max(0, g +- x - (drift + tolerance) w), the largest of all.

    drift: half the deviation that it is tuned for, in standard deviations of a block.
    """

    name: ClassVar[DetectorName] = "cusum"
    drift: float = 0.5

    def start(self, shape: tuple[int, ...]) -> State:
        return (np.zeros(shape), np.zeros(shape))

    def update(self, state: State, x: Floats, w: Floats, tolerance: Floats) -> tuple[State, Floats]:
        allowed = (self.drift + tolerance) * w
        state = (np.maximum(0.0, state[0] + x - allowed), np.maximum(0.0, state[1] - x - allowed))
        return state, np.maximum(*state).max(axis=-1)


@dataclass(frozen=True)
class PageHinkley:
    """Page-Hinkley (Hinkley 1971): the same sum, but about the mean of the past in place of the reference.

    So a reference that is slightly wrong raises no alarm, and a slow drift is followed in silence. memory: of that
    mean, in blocks of average information; it starts as if a tenth of that had been seen without a deviation.
    """

    name: ClassVar[DetectorName] = "page-hinkley"
    drift: float = 0.5
    memory: float = 1000.0

    def start(self, shape: tuple[int, ...]) -> State:
        return (np.zeros(shape), np.zeros(shape), np.zeros(shape), np.full(shape, self.memory / 10))

    def update(self, state: State, x: Floats, w: Floats, tolerance: Floats) -> tuple[State, Floats]:
        up, down, total, weight = state
        apart, allowed = x - w * total / weight, (self.drift + tolerance) * w
        up, down = np.maximum(0.0, up + apart - allowed), np.maximum(0.0, down - apart - allowed)
        keep = np.exp(-w / self.memory)
        return (up, down, keep * total + x, keep * weight + w), np.maximum(up, down).max(axis=-1)


@dataclass(frozen=True)
class Glr:
    """Generalised likelihood ratio (Willsky and Jones 1976): the best start of a shift of any size.

    T = max over the last `window` starts and the parameters of (|sum x| - tolerance sum w)^2 / (2 (sum w + edge)).
    """

    name: ClassVar[DetectorName] = "glr"
    window: int = 32

    def start(self, shape: tuple[int, ...]) -> State:
        return (np.zeros((self.window, *shape)), np.zeros((self.window, *shape)))

    def update(self, state: State, x: Floats, w: Floats, tolerance: Floats) -> tuple[State, Floats]:
        sums, weights = (_longer(part, new) for part, new in zip(state, (x, w), strict=True))
        beyond, known = np.abs(sums), weights + EDGE
        beyond -= tolerance * weights
        np.maximum(beyond, 0.0, out=beyond)
        beyond *= beyond
        beyond /= known
        return (sums, weights), beyond.max(axis=0).max(axis=-1) / 2


def _longer(sums: Floats, new: Floats) -> Floats:
    """Of the last j + 1 blocks in row j, (window, ..., p), behind one more (..., p)."""
    found = np.empty(sums.shape)
    found[0] = 0.0 + new
    np.add(sums[:-1], new, out=found[1:])
    return found


@dataclass(frozen=True)
class ChiSquare:
    """T = d^T C^-1 d of the deviation of the estimate within the memory, with its covariance.

    d = sum x / sqrt(sum w + edge), both discounted: the deviation of an estimate with that memory in its standard
    deviations. keep: discount of a block; precision: (p, p) C^-1, inverse covariance of d in normal work, row by row.
    """

    name: ClassVar[DetectorName] = "chi-square"
    keep: float = 0.9
    precision: tuple[tuple[float, ...], ...] = ()

    def start(self, shape: tuple[int, ...]) -> State:
        return (np.zeros(shape), np.zeros(shape))

    def deviation(self, state: State, x: Floats, w: Floats, tolerance: Floats) -> tuple[State, Floats]:
        """The state after a block, and d (..., p)."""
        total, weight = self.keep * state[0] + x, self.keep * state[1] + w
        beyond = np.maximum(np.abs(total) - tolerance * weight, 0.0)
        return (total, weight), np.copysign(beyond, total) / np.sqrt(weight + EDGE)

    def update(self, state: State, x: Floats, w: Floats, tolerance: Floats) -> tuple[State, Floats]:
        state, d = self.deviation(state, x, w, tolerance)
        precision, p = self.precision or np.eye(x.shape[-1]).tolist(), x.shape[-1]
        terms = [d[..., i] * precision[i][j] * d[..., j] for i in range(p) for j in range(p)]
        return state, reduce(np.add, terms)  # one after the other, as in `scores.in_order`


def make_detectors(keep: float, precision: tuple[tuple[float, ...], ...] = ()) -> dict[str, Detector]:
    """All detectors by name; keep: discount of a block in the memory of the estimate; precision: see `ChiSquare`."""
    made: list[Detector] = [Cusum(), PageHinkley(), Glr(), ChiSquare(keep, precision)]
    return {detector.name: detector for detector in made}


def statistics(detector: Detector, x: Floats, w: Floats, tolerance: Floats) -> Floats:
    """The statistic after each of the blocks x, w: (..., n, p); returns (..., n)."""
    state, found = detector.start((*x.shape[:-2], x.shape[-1])), np.empty(x.shape[:-1])
    for k in range(x.shape[-2]):
        state, found[..., k] = detector.update(state, x[..., k, :], w[..., k, :], tolerance)
    return found

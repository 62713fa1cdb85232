"""Detectors of a change, on standardised block deviations x and their information w (see `scores.Scale`).

Each is a frozen configuration; its state is an array (rows, p) for each axis, and what a block makes of it is computed
one axis after the other (`_stage.Detection`). The statistic grows with the evidence for a change of any parameter in
either direction; what it may reach by chance is the business of `calibration`. A block without information changes
nothing.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pmfid._stage import CHI_SQUARE, CUSUM, EDGE, GLR, PAGE_HINKLEY, Detection
from pmfid.monitor.names import DetectorName
from pmfid.types import Floats

__all__ = [
    "EDGE",
    "ChiSquare",
    "Cusum",
    "Detector",
    "Glr",
    "PageHinkley",
    "make_detectors",
    "statistics",
]


class Detector(ABC):
    """name: as in AXIS.toml."""

    name: ClassVar[DetectorName]

    @abstractmethod
    def detection(self, p: int) -> Detection:
        """The recursion of the statistic for p parameters."""

    def start(self, shape: tuple[int, ...]) -> Floats:
        """The state (..., rows, p) before the first block; shape: (..., p) of x."""
        return np.zeros((*shape[:-1], self.detection(shape[-1]).rows, shape[-1]))

    def update(self, state: Floats, x: Floats, w: Floats, tolerance: Floats) -> tuple[Floats, Floats]:
        """The state after a block x, w: (..., p), and the statistic (...,); tolerance: (..., p) deviations in standard
        deviations that are no change."""
        after = state.copy()
        found = _run(self, after, x[..., None, :], w[..., None, :], tolerance)
        return after, found[..., 0]


@dataclass(frozen=True)
class Cusum(Detector):
    """Two-sided cumulative sum (Page 1954): g = max(0, g +- x - (drift + tolerance) w), the largest of all.

    drift: half the deviation that it is tuned for, in standard deviations of a block.
    """

    name: ClassVar[DetectorName] = "cusum"
    drift: float = 0.5

    def detection(self, p: int) -> Detection:
        return Detection(CUSUM, p, drift=self.drift)


@dataclass(frozen=True)
class PageHinkley(Detector):
    """Page-Hinkley (Hinkley 1971): the same sum, but about the mean of the past in place of the reference.

    So a reference that is slightly wrong raises no alarm, and a slow drift is followed in silence. memory: of that
    mean, in blocks of average information; it starts as if a tenth of that had been seen without a deviation.
    """

    name: ClassVar[DetectorName] = "page-hinkley"
    drift: float = 0.5
    memory: float = 1000.0

    def detection(self, p: int) -> Detection:
        return Detection(PAGE_HINKLEY, p, drift=self.drift, memory=self.memory)

    def start(self, shape: tuple[int, ...]) -> Floats:
        state = super().start(shape)
        state[..., -1, :] = self.memory / 10
        return state


@dataclass(frozen=True)
class Glr(Detector):
    """Generalised likelihood ratio (Willsky and Jones 1976): the best start of a shift of any size.

    T = max over the last `window` starts and the parameters of (|sum x| - tolerance sum w)^2 / (2 (sum w + edge)).
    """

    name: ClassVar[DetectorName] = "glr"
    window: int = 32

    def detection(self, p: int) -> Detection:
        return Detection(GLR, p, window=self.window)


@dataclass(frozen=True)
class ChiSquare(Detector):
    """T = d^T C^-1 d of the deviation of the estimate within the memory, with its covariance.

    d = sum x / sqrt(sum w + edge), both discounted: the deviation of an estimate with that memory in its standard
    deviations. keep: discount of a block; precision: (p, p) C^-1, inverse covariance of d in normal work, row by row.
    """

    name: ClassVar[DetectorName] = "chi-square"
    keep: float = 0.9
    precision: tuple[tuple[float, ...], ...] = ()

    def detection(self, p: int) -> Detection:
        return Detection(CHI_SQUARE, p, drift=self.keep, precision=self.precision)

    def deviations(self, x: Floats, w: Floats) -> Floats:
        """d (runs, n, p) after each of the blocks x, w: (runs, n, p)."""
        p = x.shape[-1]
        return self.detection(p).deviations(self.start((len(x), p)), x, w, np.zeros((len(x), p)))


def make_detectors(keep: float, precision: tuple[tuple[float, ...], ...] = ()) -> dict[str, Detector]:
    """All detectors by name; keep: discount of a block in the memory of the estimate; precision: see `ChiSquare`."""
    made: list[Detector] = [Cusum(), PageHinkley(), Glr(), ChiSquare(keep, precision)]
    return {detector.name: detector for detector in made}


def statistics(detector: Detector, x: Floats, w: Floats, tolerance: Floats) -> Floats:
    """The statistic after each of the blocks x, w: (..., n, p); returns (..., n)."""
    return _run(detector, detector.start((*x.shape[:-2], x.shape[-1])), x, w, tolerance)


def _run(detector: Detector, state: Floats, x: Floats, w: Floats, tolerance: Floats) -> Floats:
    """The statistic from a state (..., rows, p), which is updated."""
    *many, n, p = x.shape
    axes, blocks = int(np.prod(many)), (-1, n, p)
    tolerances = np.broadcast_to(tolerance, (*many, p)).reshape(axes, p)
    own = state.reshape(axes, *state.shape[-2:])
    return detector.detection(p).run(own, x.reshape(blocks), w.reshape(blocks), tolerances).reshape(*many, n)

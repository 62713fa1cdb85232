"""Detectors of a change, on standardised block deviations x and their information w (see `scores.Scale`).

Each detector is a frozen configuration. The state of a detector is an array (rows, p) for each axis, which the kernel
`_stage.Detection` updates axis by axis. The statistic grows with the evidence for a change of any parameter in either
direction. The module `calibration` finds the values that the statistic may reach by chance. A block without information
changes nothing.
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
    """A detector of changes, with its `name` in AXIS.toml."""

    name: ClassVar[DetectorName]

    @abstractmethod
    def detection(self, p: int) -> Detection:
        """Return the recursion of the statistic for p parameters."""

    def start(self, shape: tuple[int, ...]) -> Floats:
        """Return the state (..., rows, p) before the first block, for x of the shape (..., p)."""
        return np.zeros((*shape[:-1], self.detection(shape[-1]).rows, shape[-1]))

    def update(self, state: Floats, x: Floats, w: Floats, tolerance: Floats) -> tuple[Floats, Floats]:
        """Return the state after a block x, w (..., p), and the statistic (...,).

        `tolerance` (..., p) is the deviation that is no change, in standard deviations.
        """
        after = state.copy()
        found = _run(self, after, x[..., None, :], w[..., None, :], tolerance)
        return after, found[..., 0]


@dataclass(frozen=True)
class Cusum(Detector):
    """Two-sided cumulative sum (Page 1954), the largest g = max(0, g +- x - (drift + tolerance) w) of all parameters.

    `drift` is half the deviation for which the detector is tuned, in standard deviations of a block.
    """

    name: ClassVar[DetectorName] = "cusum"
    drift: float = 0.5

    def detection(self, p: int) -> Detection:
        return Detection(CUSUM, p, drift=self.drift)


@dataclass(frozen=True)
class PageHinkley(Detector):
    """Page-Hinkley detector (Hinkley 1971), a cumulative sum about the past mean in place of the reference.

    A slightly wrong reference therefore raises no alarm, and a slow drift is followed in silence. `memory` is the
    memory of the mean, in blocks of average information. The mean starts as if a tenth of the memory had passed without
    a deviation.
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
    """Generalised likelihood ratio (Willsky and Jones 1976) of the best start of a shift of any size.

    The statistic is the maximum of (|sum x| - tolerance sum w)^2 / (2 (sum w + edge)) over parameters and the last
    `window` starts.
    """

    name: ClassVar[DetectorName] = "glr"
    window: int = 32

    def detection(self, p: int) -> Detection:
        return Detection(GLR, p, window=self.window)


@dataclass(frozen=True)
class ChiSquare(Detector):
    """Statistic d^T C^-1 d of the deviation d of the estimate within its memory, with the covariance C.

    The deviation d = sum x / sqrt(sum w + edge) has discounted sums. Its unit is the standard deviation of an estimate
    with equal memory. `keep` is the discount of a block. `precision` (p, p) is C^-1, the inverse covariance of d in
    normal work, row by row.
    """

    name: ClassVar[DetectorName] = "chi-square"
    keep: float = 0.9
    precision: tuple[tuple[float, ...], ...] = ()

    def detection(self, p: int) -> Detection:
        return Detection(CHI_SQUARE, p, drift=self.keep, precision=self.precision)

    def deviations(self, x: Floats, w: Floats) -> Floats:
        """Return d (runs, n, p) after each of the blocks x, w (runs, n, p)."""
        p = x.shape[-1]
        return self.detection(p).deviations(self.start((len(x), p)), x, w, np.zeros((len(x), p)))


def make_detectors(keep: float, precision: tuple[tuple[float, ...], ...] = ()) -> dict[str, Detector]:
    """Return all detectors by name.

    `keep` is the discount of a block in the memory of the estimate. `precision` belongs to `ChiSquare`.
    """
    made: list[Detector] = [Cusum(), PageHinkley(), Glr(), ChiSquare(keep, precision)]
    return {detector.name: detector for detector in made}


def statistics(detector: Detector, x: Floats, w: Floats, tolerance: Floats) -> Floats:
    """Return the statistic (..., n) after each of the blocks x, w (..., n, p)."""
    return _run(detector, detector.start((*x.shape[:-2], x.shape[-1])), x, w, tolerance)


def _run(detector: Detector, state: Floats, x: Floats, w: Floats, tolerance: Floats) -> Floats:
    """Return the statistic after each block, and update the state (..., rows, p)."""
    *many, n, p = x.shape
    axes, blocks = int(np.prod(many)), (-1, n, p)
    tolerances = np.broadcast_to(tolerance, (*many, p)).reshape(axes, p)
    own = state.reshape(axes, *state.shape[-2:])
    return detector.detection(p).run(own, x.reshape(blocks), w.reshape(blocks), tolerances).reshape(*many, n)

"""What monitors make of their blocks: one axis, block by block, or many quiet ones at once, by the same arithmetic.

It is that of `_stage.Watcher`, one axis after the other: how many there are makes no difference to the bits of one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pmfid._stage import Watcher
from pmfid.monitor.arrays import Watched
from pmfid.monitor.calibration import Calibration
from pmfid.monitor.detectors import Detector
from pmfid.monitor.scores import Scale
from pmfid.types import Floats

#: What is told where there is nothing to tell from, by the numbers that the watcher gives.
REASONS = ("", "the estimate has not started", "poor excitation", "standstill", "the motion tells nothing")


@dataclass(frozen=True)
class Watching:
    """What does not change from axis to axis. detector, threshold: of its statistic; relative: deviation that is no
    change; noise: (p, p) of the estimator; wait: blocks for a reference (p,); silent_blocks: without information after
    which nothing can be told; block_time [s]."""

    calibration: Calibration
    detector: Detector
    threshold: float
    relative: float
    noise: Floats
    wait: Callable[[Floats], int]
    silent_blocks: int
    block_time: float

    @property
    def _seen(self) -> Scale:
        """Of the units that the detector sees."""
        work = self.calibration.work
        return self.calibration.scale if work is None else work.scale

    def seen(self, sigma: Floats) -> Scale:
        """The same for axes with other references, and sigma (n, p) or (p,)."""
        return replace(self._seen, sigma=sigma)

    def sizes(self, theta: Floats) -> Floats:
        """(n,) by how much the noise of references (n, p) is larger than that of the calibration's."""
        first = float(self._square(self.calibration.theta[None])[0])
        return np.asarray(np.sqrt(self._square(theta) / max(first, 1e-300)))

    def _square(self, theta: Floats) -> Floats:
        total = np.zeros(len(theta))
        for i, j in np.ndindex(self.noise.shape):
            total = total + theta[:, i] * self.noise[i, j] * theta[:, j]
        return total

    def derive(self, own: Watched) -> None:
        """What follows from the references."""
        own.sigma[:] = self.sizes(own.theta)[:, None] * self._seen.sigma
        own.tolerance[:] = self.relative * np.abs(own.theta) / own.sigma
        known: dict[bytes, int] = {}
        for axis, theta in enumerate(own.theta):
            key = theta.tobytes()
            if key not in known:
                known[key] = self.wait(theta)
            own.wait[axis] = known[key]

    def refer(self, own: Watched, theta: Floats) -> None:
        """Starts to watch for deviations from references (n, p)."""
        own.theta[:] = theta
        self.derive(own)
        own.waiting[:] = own.wait
        own.silence[:] = own.members[:] = own.units[:] = 0
        own.opened[:] = own.opening[:] = own.begun[:] = own.statistic[:] = 0.0
        self.restart(own)

    def restart(self, own: Watched) -> None:
        """The detector begins anew."""
        own.detection[:] = self.detector.start(own.theta.shape)

    def detection_rows(self, p: int) -> int:
        """Rows of p numbers of the detector's state."""
        return self.detector.detection(p).rows

    @cached_property
    def watcher(self) -> Watcher:
        """What computes the following."""
        work = self.calibration.work
        return Watcher(
            self.calibration.scale.norms,
            self._seen.norms,
            self.detector.detection(self.calibration.theta.size),
            None if work is None else (work.size, work.offset, work.limit),
            self.threshold,
            self.block_time,
            self.silent_blocks,
        )

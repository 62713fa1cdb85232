"""Decisions of monitors on their blocks: of one axis, block by block, or of many quiet axes at once.

Both use the arithmetic of `_stage.Watcher`, one axis after the other, so the number of axes does not change any bit.
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

#: Reasons of the state CANNOT_TELL, by the numbers of the watcher.
REASONS = ("", "the estimate has not started", "poor excitation", "standstill", "the motion tells nothing")


@dataclass(frozen=True)
class Watching:
    """Configuration that all axes share. detector, threshold: of its statistic; relative: deviation that is no change;
    noise: (p, p) of the estimator; wait: blocks for a reference (p,); silent_blocks: blocks without information until
    the state is CANNOT_TELL; block_time [s]."""

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
        """Scale of the units that the detector takes."""
        work = self.calibration.work
        return self.calibration.scale if work is None else work.scale

    def rescale(self, sigma: Floats) -> Scale:
        """The scale for axes with other references: sigma is (n, p) or (p,)."""
        return replace(self._seen, sigma=sigma)

    def sizes(self, theta: Floats) -> Floats:
        """(n,) noise at references (n, p), over the noise at the calibration's reference."""
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
        """Resets the detector."""
        own.detection[:] = self.detector.start(own.theta.shape)

    def detection_rows(self, p: int) -> int:
        """Rows of p numbers of the detector's state."""
        return self.detector.detection(p).rows

    @cached_property
    def watcher(self) -> Watcher:
        """Kernel of these decisions."""
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

"""What quiet monitors make of their blocks, one axis or many at once, with the same bits.

Every operation is one of single numbers, or a sum in a fixed order: how many axes stand side by side, and where, makes
no difference.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pmfid.monitor.arrays import Watched
from pmfid.monitor.calibration import Calibration
from pmfid.monitor.detectors import Detector
from pmfid.monitor.events import CANNOT_TELL, STARTING, WATCHING
from pmfid.monitor.rows import STATES
from pmfid.monitor.scores import Blocks, Scale, mean_of, waiting_after
from pmfid.status import Status
from pmfid.types import Flags, Floats, Places

#: A block with less of the average information tells nothing.
INFORMATIVE = 0.05
NO_ALARM = int(Status.STARTING | Status.POOR_EXCITATION)
#: What is told where there is nothing to tell from.
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
        self._pack(self.detector.start(own.theta.shape), own)

    def detection_rows(self, p: int) -> int:
        """Rows of p numbers of the detector's state."""
        return sum(part.size // p for part in self.detector.start((1, p)))

    @cached_property
    def _parts(self) -> list[tuple[slice, tuple[int, ...]]]:
        """Of each array of the detector's state its rows in `Watched.detection`, and its shape before axis and p."""
        p, place, parts = self.calibration.theta.size, 0, []
        for part in self.detector.start((1, p)):
            rows = part.size // p
            parts.append((slice(place, place + rows), part.shape[:-2]))
            place += rows
        return parts

    def _pack(self, state: tuple[Floats, ...], own: Watched) -> None:
        for part, (rows, shape) in zip(state, self._parts, strict=True):
            order = len(shape), *range(len(shape)), len(shape) + 1
            own.detection[:, rows].reshape(-1, *shape, part.shape[-1])[:] = part.transpose(order)

    def _unpacked(self, own: Watched) -> tuple[Floats, ...]:
        axes, _, p = own.detection.shape
        return tuple(
            own.detection[:, rows].reshape(axes, *shape, p).transpose(*range(1, len(shape) + 1), 0, len(shape) + 1)
            for rows, shape in self._parts
        )

    def informed(self, own: Watched, rows: Floats, lost: NDArray[np.uint8]) -> tuple[Floats, Floats]:
        """Blocks (n, width), one of each axis, as far as they count, and their information (n,)."""
        own.waiting[:] = waiting_after(lost, own.waiting, own.wait)
        blocks = Blocks.of(rows * (own.waiting == 0)[:, None], own.theta.shape[1])
        information = self.calibration.scale.information(blocks)
        own.silence[:] = np.where(information > INFORMATIVE, 0, own.silence + 1)
        if self.calibration.work is not None:
            blocks = self.calibration.work.centred(blocks)
        return blocks.rows, information

    def whole(self, own: Watched, rows: Floats, information: Floats, time: Floats) -> tuple[Flags, Floats]:
        """Where a block completes a unit, and (n, width) the units; without units of work each block is one. time: of
        the blocks (n,)."""
        own.begun[:] = np.where(own.members == 0, time - self.block_time, own.begun)
        if self.calibration.work is None:
            return np.ones(len(rows), np.bool_), rows
        own.opening[:] = np.where(own.members[:, None] == 0, rows, own.opening + rows)
        own.opened[:] = own.opened + information
        own.members[:] += 1
        whole, units = own.opened >= self.calibration.work.size, own.opening.copy()
        own.members[whole], own.opened[whole], own.opening[whole] = 0, 0.0, 0.0
        return whole, units

    def counted(self, own: Watched, rows: Floats) -> Floats:
        """Takes units (n, width), one of each axis, into the statistic; their information (n,)."""
        units, work, seen = Blocks.of(rows, own.theta.shape[1]), self.calibration.work, self.seen(own.sigma)
        weighed = units if work is None else replace(work, scale=seen).weighed(units)
        x, w = seen.standardise(weighed)
        state, statistic = self.detector.update(self._unpacked(own), x, w, own.tolerance)
        self._pack(state, own)
        own.statistic[:] = statistic
        own.units[:] += 1
        return mean_of(w) if work is None else seen.information(units)

    def crossed(self, own: Watched, information: Floats, status: NDArray[np.uint32]) -> Flags:
        """(n,) where a suspicion begins."""
        beyond = (own.statistic > self.threshold) & (information > INFORMATIVE)
        return np.asarray(beyond & ((status & NO_ALARM) == 0))

    def looked(self, own: Watched, status: NDArray[np.uint32]) -> tuple[NDArray[np.uint8], Places]:
        """(n,) the state that each axis should be in, whether there is anything to tell from, and why, as a place in
        REASONS."""
        wanted, reason = own.state.copy(), np.zeros(status.size, np.int64)
        silent = own.silence >= self.silent_blocks
        found = (
            (own.silence == 0, WATCHING, 0),
            (silent, CANNOT_TELL, 4),
            (silent & ((status & int(Status.STANDSTILL)) != 0), CANNOT_TELL, 3),
            ((status & int(Status.POOR_EXCITATION)) != 0, CANNOT_TELL, 2),
            ((status & int(Status.STARTING)) != 0, STARTING, 1),
        )
        for where, state, why in found:  # the last one that holds
            wanted[where], reason[where] = STATES.index(state), why
        return wanted, reason

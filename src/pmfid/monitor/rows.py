"""Results of a fleet of monitors for its samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmfid.monitor.events import CANNOT_TELL, SETTLING, STARTING, SUSPICIOUS, WATCHING, Event
from pmfid.types import Flags, Floats

#: Names of the states, by their numbers.
STATES = (STARTING, WATCHING, CANNOT_TELL, SUSPICIOUS, SETTLING)


@dataclass(frozen=True)
class FleetRows:
    """Results for n samples of k axes. theta, std: (k, n, q) of the reported parameters; innovation: (k, n); status:
    (k, n) bits of the estimates; state: (k, n) of the monitors after each sample, numbers of `STATES`; events: (row,
    sample, event), row by row, each row in the order of time."""

    theta: Floats
    std: Floats
    innovation: Floats
    status: NDArray[np.uint32]
    state: NDArray[np.uint8]
    events: list[tuple[int, int, Event]]

    @classmethod
    def empty(cls, axes: int, samples: int, parameters: int) -> FleetRows:
        """Uninitialised arrays for `axes` axes, `samples` samples and `parameters` parameters."""
        shape = (axes, samples)
        theta, std = np.empty((*shape, parameters)), np.empty((*shape, parameters))
        return cls(theta, std, np.empty(shape), np.empty(shape, np.uint32), np.empty(shape, np.uint8), [])

    def part(self, rows: slice) -> FleetRows:
        """Some rows themselves, without events."""
        theta, std, innovation = self.theta[rows], self.std[rows], self.innovation[rows]
        return FleetRows(theta, std, innovation, self.status[rows], self.state[rows], [])

    def take(self, part: FleetRows, rows: NDArray[np.int64], time: slice, kept: Flags | None = None) -> None:
        """Copies `part` into the rows `rows` (k,), which rise, and the samples `time`; kept: (k,) rows, None: all."""
        taken = np.ones(rows.size, np.bool_) if kept is None else kept
        whole = taken.all() and rows[-1] - rows[0] == rows.size - 1  # rows rise: they follow one another
        place, source = (slice(rows[0], rows[-1] + 1), slice(None)) if whole else (rows[taken], taken)
        for name in ("theta", "std", "innovation", "status", "state"):
            getattr(self, name)[place, time] = getattr(part, name)[source]
        self.tell(part, rows, time, taken)

    def tell(self, part: FleetRows, rows: NDArray[np.int64], time: slice, kept: Flags) -> None:
        """The events of a part, as in `take`."""
        for row, sample, event in part.events:
            if kept[row]:
                self.events.append((int(rows[row]), time.start + sample, event))

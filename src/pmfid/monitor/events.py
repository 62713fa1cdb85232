"""Events and rows of a monitor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import UsageError
from pmfid.monitor.names import DETECTORS
from pmfid.types import Flags, Floats

STARTING, WATCHING, CANNOT_TELL, SUSPICIOUS, SETTLING = (
    "starting",
    "watching",
    "cannot tell",
    "suspicious",
    "settling",
)
#: All of them, in the order of their numbers.
STATES = (STARTING, WATCHING, CANNOT_TELL, SUSPICIOUS, SETTLING)


@dataclass(frozen=True)
class Watch:
    """What to watch for.

    detector: one of DETECTORS; mtbf_hours: mean time between false alarms [h], > 0; tolerance: relative deviation of a
    parameter that is no change, >= 0. Raises UsageError for a value outside these bounds.
    """

    detector: str = "glr"
    mtbf_hours: float = 24.0
    tolerance: float = 0.02

    def __post_init__(self) -> None:
        if self.detector not in DETECTORS:
            raise UsageError(f"detector must be one of {list(DETECTORS)}, got {self.detector!r}")
        if not 0.1 <= self.mtbf_hours <= 1e6:
            raise UsageError(f"mtbf_hours must be in [0.1, 1e6], got {self.mtbf_hours}; it is in hours")
        if not 0 <= self.tolerance < 1:
            raise UsageError(f"tolerance must be in [0, 1), got {self.tolerance}; 0.02 is 2 %")


@dataclass(frozen=True)
class Alarm:
    """A change. time: of the alarm [s]; changed_at: when it began to show [s]; parameter: name, or "input_gain",
    or "friction" if all frictions grew alike; change, std: [unit]; relative: change over the reference, over std if the
    reference is 0 ("friction": change and std are relative, too); statistic at the first suspicion, and its threshold;
    others: causes that the samples so far do not exclude."""

    time: float
    changed_at: float
    parameter: str
    unit: str
    change: float
    std: float
    relative: float
    statistic: float
    threshold: float
    others: tuple[str, ...] = ()


@dataclass(frozen=True)
class Settled:
    """A new reference after an alarm. time [s]; theta, std: (q,) of the parameters that the monitor reports; before:
    (q,) the previous reference. gain: if the alarm was on the input gain, the new gain, its standard deviation and the
    previous gain; theta is then expressed with the previous gain."""

    time: float
    theta: Floats
    std: Floats
    before: Floats
    gain: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class StateChange:
    """The state from time [s] on: STARTING, WATCHING, CANNOT_TELL, SUSPICIOUS or SETTLING; and the reason."""

    time: float
    state: str
    reason: str


@dataclass(frozen=True)
class Outlier:
    """A sample that no motion explains, at time [s]: it is left out, the watch goes on. signal: "counts" or "input"."""

    time: float
    signal: str


Event = Alarm | Settled | StateChange | Outlier


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

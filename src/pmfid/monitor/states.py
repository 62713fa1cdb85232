"""The states of monitored axes by their counts, in one array for each part of a state with a row for each axis."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pmfid._stage import ALONE, CHANGED, FRESH, KEPT, KNOWN, LOST, POWER, SAME, SAMPLES, USUAL
from pmfid.monitor.events import SETTLING, STATES, SUSPICIOUS
from pmfid.monitor.rows import MOST, RowArrays, rows_of
from pmfid.monitor.tuning import TUNING
from pmfid.types import Floats


@dataclass
class Sampled(RowArrays):
    """The state of an axis that changes with each sample.

    `whole` and `real` belong to its `Inputs`. `flagged` is the status of the last sample that was not lost. `warmer`
    (n, 2) are the temperature of the open block and the last known one, above the mean of normal work. `estimator` and
    `filter` are the packed states of the kernels. `sums` and `progress` belong to the open block (see `Scoring`).
    """

    whole: NDArray[np.int64]
    real: Floats
    flagged: NDArray[np.uint32]
    warmer: Floats
    estimator: NDArray[np.uint8]
    filter: NDArray[np.uint8]
    sums: Floats
    progress: NDArray[np.uint32]

    @property
    def samples(self) -> NDArray[np.int64]:
        """Number of samples so far (n,), lost samples included."""
        return self.whole[:, SAMPLES]


@dataclass
class Watched(RowArrays):
    """The state of an axis that changes with each block.

    `theta` (n, p) is the reference, `state` the number in `STATES`. `waiting` is the number of blocks that do not
    count. `silence` is the number of blocks since the last one with information. The open unit has the information
    `opened`, the sum `opening` (n, width), the blocks `members` and the time `begun`. `detection` is the state of the
    detector, and `units` the number of units with this reference. `line` (n, 2, p) has the sums of a line through zero:
    over all units with this reference, their number times x, and its square times w. `wait`, `sigma` and `tolerance`
    are derived from the reference.
    """

    theta: Floats = field(metadata=rows_of("p"))
    state: NDArray[np.uint8] = field(metadata=rows_of(kind=np.uint8))
    waiting: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64))
    silence: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64))
    opened: Floats = field(metadata=rows_of())
    opening: Floats = field(metadata=rows_of("width"))
    members: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64))
    begun: Floats = field(metadata=rows_of())
    detection: Floats = field(metadata=rows_of("starts", "p"))
    statistic: Floats = field(metadata=rows_of())
    units: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64))
    line: Floats = field(metadata=rows_of(2, "p"))
    wait: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64, saved=False))
    sigma: Floats = field(metadata=rows_of("p", saved=False))
    tolerance: Floats = field(metadata=rows_of("p", saved=False))


@dataclass
class Disturbed(RowArrays):
    """The data of an axis that alarms use and change.

    `units` (n, look_back, width) is a ring with the last units, and `begun` (n, look_back) has their times. `gathered`
    is the information since the suspicion or the alarm. `suspected` is the number of units since the suspicion, and
    `crossed` the statistic at the suspicion. `refined` is true if the estimate is already the model. `model` (n, p) has
    the parameters of the simulation, which follow the estimate while the new value is measured. `before` (n, p) is the
    reference before the change. `settled` (n, width) is the sum of the blocks about the present reference. `gain` is
    the input gain over the gain of the estimator. `cause` identifies parameter and direction of the last alarm, or is
    0. `since` is the time of the reference [s]. `slow` (n, p) times a change of the parameters is the relative change
    of the last alarm's cause, while this change goes on slowly; otherwise `slow` is 0. `rate` is the relative change
    per hour at the last alarm if it was slow, otherwise 0. `grown` is the number of units that had the deviation of the
    last alarm before it, by the line.
    """

    units: Floats = field(metadata=rows_of(TUNING.look_back, "width"))
    begun: Floats = field(metadata=rows_of(TUNING.look_back))
    gathered: Floats = field(metadata=rows_of())
    suspected: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64))
    crossed: Floats = field(metadata=rows_of())
    refined: NDArray[np.uint8] = field(metadata=rows_of(kind=np.uint8))
    before: Floats = field(metadata=rows_of("p"))
    model: Floats = field(metadata=rows_of("p"))
    settled: Floats = field(metadata=rows_of("width"))
    gain: Floats = field(metadata=rows_of(start=1))
    cause: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64))
    since: Floats = field(metadata=rows_of())
    slow: Floats = field(metadata=rows_of("p"))
    rate: Floats = field(metadata=rows_of())
    grown: Floats = field(metadata=rows_of())

    def recent(self, axis: int, units: int) -> tuple[Floats, Floats]:
        """Return the last units (m, width) of an axis and their times (m,), in order.

        `units` is the number of all units so far.
        """
        order = np.arange(max(0, units - TUNING.look_back), units) % TUNING.look_back
        return self.units[axis, order], self.begun[axis, order]


@dataclass
class AxisStates(RowArrays):
    """The states of some axes."""

    sampled: Sampled
    watched: Watched
    disturbed: Disturbed

    @property
    def samples(self) -> NDArray[np.int64]:
        return self.sampled.samples

    def are_possible(self, size: int) -> bool:
        """Return whether samples can have made these numbers, except the references and the states of the kernels.

        `size` is the number of samples in a block.
        """
        sampled, watched, rest = self.sampled, self.watched, self.disturbed
        samples, whole, real = sampled.samples, sampled.whole, sampled.real
        uneasy = np.isin(watched.state, [STATES.index(SUSPICIOUS), STATES.index(SETTLING)])
        counted = (samples, watched.waiting, watched.silence, watched.members, watched.units, rest.suspected)
        conditions = [
            *((number >= 0) & (number <= MOST) for number in counted),
            np.isin(whole[:, [LOST, KNOWN, CHANGED]], (0, 1)),
            (whole[:, FRESH] >= 0) & (whole[:, FRESH] <= np.minimum(samples, KEPT)),
            real[:, [USUAL, POWER]] >= 0,
            (real[:, [SAME, ALONE]] >= 0) & (real[:, [SAME, ALONE]] <= 1),
            sampled.progress[:, 0] < size,
            sampled.progress[:, 1] <= sampled.progress[:, 0],
            watched.state < len(STATES),
            rest.refined <= 1,
            ~uneasy | (watched.units > 0) | (rest.refined == 1),
            (watched.opened >= 0) & (rest.gathered >= 0),
            watched.line[:, 1] >= 0,
        ]
        finite = all(np.all(np.isfinite(array)) for _, array in self.list_saved() if array.dtype.kind == "f")
        return finite and all(np.all(condition) for condition in conditions)

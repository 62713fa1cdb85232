"""The states of monitored axes as bytes, in one array for each part of a state with a row for each axis.

The bytes of a file are not trusted until they are checked. Whole numbers are checked against their bounds, and real
numbers must be finite. The kernels check their own states.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from pmfid._kernel64 import ManyKernel
from pmfid._stage import KEPT
from pmfid.errors import UsageError
from pmfid.kernel.saved import HEAD, check_sealed, make_head, read_bytes, seal_parts
from pmfid.kernel.structures import layout_number
from pmfid.monitor.axis import Watching
from pmfid.monitor.events import SETTLING, STATES, SUSPICIOUS
from pmfid.monitor.rows import RowArrays
from pmfid.monitor.scores import Disturbed, Sampled, Scoring, Watched
from pmfid.types import Floats

#: Magic number and version of the saved states.
KIND = 0x4D464D50, 2  # the bytes "PMFM"
#: Largest number of axes of a fleet. A header with a larger number is refused.
MOST_AXES = 2**24
#: Largest number of samples and blocks in a state.
MOST = 2**60

FOREIGN = (
    "these bytes are not a state of this monitor; use a state of a monitor with the same "
    "estimator, calibration, watch and version"
)
DAMAGED = (
    "these bytes are damaged, or are not a state: the checksum is wrong; start from an older state, or without a state"
)
IMPLAUSIBLE = (
    "these numbers cannot be a state of a monitor, although their checksum is right; start from "
    "an older state, or without a state"
)


Rows = TypeVar("Rows", bound=RowArrays)


@dataclass
class AxisStates(RowArrays):
    """The states of some axes."""

    sampled: Sampled
    watched: Watched
    disturbed: Disturbed

    @property
    def samples(self) -> NDArray[np.int64]:
        return self.sampled.samples


def write_states(saved: RowArrays, config: int) -> bytes:
    """Return the bytes of all axes. `config` is the checksum of the configuration."""
    return b"".join(seal_parts(make_parts(saved, config)))


def make_parts(saved: RowArrays, config: int) -> list[memoryview]:
    """Return the saved bytes in parts, without the checksum. All parts but the first are the arrays themselves."""
    parts = [np.ascontiguousarray(array).reshape(-1).view(np.uint8).data for _, array in saved.list_saved()]
    return [memoryview(_head(saved, config, saved.axes).tobytes()), *parts]


def read(data: bytes, like: Rows, config: int) -> Rows:
    """Read bytes of `write_states` for any number of axes with the layout of `like`.

    Raises UsageError for all other bytes. `check_states` checks the numbers.
    """
    data = read_bytes(data)
    row, place = like.row_type.itemsize, HEAD.itemsize
    axes = (len(data) - place) // row
    if not 0 <= axes <= MOST_AXES:
        raise UsageError(FOREIGN)
    check_sealed(data, _head(like, config, axes), FOREIGN, DAMAGED)
    found = like.take_rows(slice(0, 1)).repeat_rows(axes)
    for _, array in found.list_saved():
        array[:] = np.frombuffer(data, array.dtype, array.size, place).reshape(array.shape)
        place += array.nbytes
    return found


def _head(saved: RowArrays, config: int, axes: int) -> NDArray[np.void]:
    row = saved.row_type
    return make_head(KIND, layout_number(row), config, (axes, row.itemsize))


class Judge(Protocol):
    """The parts of a `Monitor` that decide whether a state is possible."""

    watching: Watching

    @property
    def packers(self) -> tuple[ManyKernel, ManyKernel]: ...
    @property
    def scoring(self) -> Scoring: ...
    def plausible(self, theta: Floats) -> bool: ...


def check_states(judge: Judge, saved: AxisStates) -> AxisStates:
    """Return the states with their derived arrays. Raises UsageError for numbers that no sample could have made."""
    sampled, watched = saved.sampled, saved.watched
    references = np.unique(watched.theta, axis=0)
    fine = all(np.all(np.isfinite(array)) for _, array in saved.list_saved() if array.dtype.kind == "f")
    fine = fine and _counts_fit(judge, saved) and all(judge.plausible(theta) for theta in references)
    for many, states in zip(judge.packers, (sampled.estimator, sampled.filter), strict=True):
        many.hold(states)
        fine = fine and many.plausible()
    if not fine:
        raise UsageError(IMPLAUSIBLE)
    judge.watching.derive(watched)
    if np.any(watched.waiting > watched.wait):
        raise UsageError(IMPLAUSIBLE)
    return saved


def _counts_fit(judge: Judge, saved: AxisStates) -> bool:
    """Return whether the whole numbers, and the real numbers with a given sign, are within their bounds."""
    sampled, watched, rest = saved.sampled, saved.watched, saved.disturbed
    samples = sampled.samples
    uneasy = np.isin(watched.state, [STATES.index(SUSPICIOUS), STATES.index(SETTLING)])
    counted = (samples, watched.waiting, watched.silence, watched.members, watched.units, rest.suspected)
    conditions = [
        *((number >= 0) & (number <= MOST) for number in counted),
        (sampled.yes_or_no == 0) | (sampled.yes_or_no == 1),
        (sampled.fresh >= 0) & (sampled.fresh <= np.minimum(samples, KEPT)),
        sampled.sizes >= 0,
        (sampled.shares >= 0) & (sampled.shares <= 1),
        sampled.progress[:, 0] < judge.scoring.size,
        sampled.progress[:, 1] <= sampled.progress[:, 0],
        watched.state < len(STATES),
        rest.refined <= 1,
        rest.by_gain <= 1,
        ~uneasy | (watched.units > 0) | (rest.refined == 1),
        (watched.opened >= 0) & (rest.gathered >= 0),
        watched.line[:, 1] >= 0,
    ]
    return all(np.all(condition) for condition in conditions)

"""The states of monitored axes as bytes, in one array for each part of a state with a row for each axis.

The bytes of a file are not trusted until they are checked. Whole numbers are checked against their bounds, and real
numbers must be finite. The kernels check their own states.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import UsageError
from pmfid.kernel.saved import HEAD, check_sealed, make_head, read_bytes, seal_parts
from pmfid.kernel.structures import layout_number
from pmfid.monitor.rows import RowArrays

#: Magic number and version of the saved states.
KIND = 0x4D464D50, 2  # the bytes "PMFM"

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
    if axes < 0:
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

"""The states of monitored axes as bytes: one array for each part of a state, a row for each axis.

Bytes of a file are hostile until they are checked: whole numbers against what they may be, real ones against being no
number, the kernel's states by the kernel.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import UsageError
from pmfid.kernel.structures import layout_number

#: What stands before the states; layout: of a row; config: of whom it is; checksum: CRC-32 of all else.
HEAD = np.dtype([(name, "<u4") for name in ("magic", "version", "layout", "config", "axes", "size", "checksum")])
MAGIC, VERSION = 0x4D464D50, 1  # "PMFM"
#: No fleet has more axes: what a head says is not believed beyond that.
MOST_AXES = 2**24

#: Part of a state -> (axes, ...) of all axes.
States = dict[str, NDArray[np.generic]]

FOREIGN = (
    "these bytes are not the state of such a monitor; take them from one with the same estimator, calibration, watch "
    "and version"
)
DAMAGED = "these bytes are not a state or are damaged: the checksum is wrong; start from an older state, or from none"
IMPLAUSIBLE = (
    "these numbers are no state of a monitor, whatever their checksum says; start from an older state, or from none"
)


def row_type(states: Mapping[str, NDArray[np.generic]]) -> np.dtype[np.void]:
    """The type of one row of all parts."""
    return np.dtype([(name, part.dtype, part.shape[1:]) for name, part in states.items()])


def written(states: States, config: int) -> bytes:
    """The bytes of all axes; config: a checksum of whose they are."""
    head = _head(states, config, axes_of(states))
    parts = [np.ascontiguousarray(part).reshape(-1).view(np.uint8).data for part in states.values()]
    checksum = zlib.crc32(head.tobytes()[:-4])
    for part in parts:
        checksum = zlib.crc32(part, checksum)
    head["checksum"] = checksum
    return b"".join([head.tobytes(), *parts])


def read(data: bytes, like: States, config: int) -> States:
    """What `written` wrote of states such as `like`, of any number of axes. Raises UsageError for anything else; what
    the numbers may be is for others to say."""
    if not isinstance(data, bytes | bytearray | memoryview):
        raise UsageError(f"a state is the bytes that get_state gave, got {type(data).__name__}")
    data = bytes(data)
    row, place = row_type(like).itemsize, HEAD.itemsize
    if len(data) < place or (len(data) - place) % row or len(data) > place + row * MOST_AXES:
        raise UsageError(FOREIGN)
    head, axes = np.frombuffer(data[:place], HEAD)[0], (len(data) - place) // row
    if head["checksum"] != zlib.crc32(memoryview(data)[place:], zlib.crc32(data[: place - 4])):
        raise UsageError(DAMAGED)
    if head.tobytes()[:-4] != _head(like, config, axes).tobytes()[:-4]:
        raise UsageError(FOREIGN)
    found: States = {}
    for name, part in like.items():
        shape = (axes, *part.shape[1:])
        size = part.dtype.itemsize * int(np.prod(shape))
        found[name] = np.frombuffer(data[place : place + size], part.dtype).reshape(shape).copy()
        place += size
    return found


def axes_of(states: States) -> int:
    """The number of axes that states are of."""
    return len(next(iter(states.values())))


def _head(states: States, config: int, axes: int) -> NDArray[np.void]:
    head = np.zeros((), HEAD)
    row = row_type(states)
    head["magic"], head["version"], head["config"] = MAGIC, VERSION, config
    head["layout"], head["axes"], head["size"] = layout_number(row), axes, row.itemsize
    return head

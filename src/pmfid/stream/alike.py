"""Messages of many blocks of the same form, as gateways send them: one pass reads all blocks, in half of the time.

A message with any irregularity is left to `blocks`, which reports the reason.
"""

from __future__ import annotations

import math
import zlib
from functools import lru_cache

import numpy as np

from pmfid.session.monitored.reading import MAX_COUNT, MOST_TIME
from pmfid.stream.delivery import Table
from pmfid.stream.layout import HEADER, LONGEST_NAME, MAGIC, MOST_NUMBER, MOST_SAMPLES, VERSION, block_type
from pmfid.types import Flags

__all__ = ["read_alike_blocks"]

#: Fewest blocks for which one pass is faster.
FEWEST = 4
#: Names are the same in each message of a gateway: number of lists that are cached, and most names of one list.
LISTS, NAMES = 1024, 256
#: Bytes of the header that blocks have in common: magic, version, flags, samples; and the name's length.
_COMMON, _LETTERS = slice(0, 8), 12


def read_alike_blocks(data: bytes) -> Table | None:
    """The blocks of a message if all have the same form and all are valid; None otherwise."""
    if len(data) < HEADER.size or not data.startswith(MAGIC):
        return None
    _, version, flags, samples, _, letters, *_ = HEADER.unpack_from(data)
    if not (version == VERSION and 0 < samples <= MOST_SAMPLES and 0 < letters <= LONGEST_NAME and flags < 4):
        return None
    form = block_type(flags, samples, letters)
    if len(data) % form.itemsize or len(data) < FEWEST * form.itemsize:
        return None
    rows = np.frombuffer(data, form)
    whole = rows.view(np.uint8).reshape(rows.size, form.itemsize)
    same = (whole[:, _COMMON] == whole[0, _COMMON]).all() and (whole[:, _LETTERS] == letters).all()
    if not (same and _sums_fit(data, rows) and _are_in_range(rows, samples)):
        return None
    names = (_read_names if rows.size <= NAMES else _read_names.__wrapped__)(rows["name"].tobytes(), letters)
    return None if names is None else _build_table(rows, names)


def _sums_fit(data: bytes, rows: np.ndarray) -> bool:
    view, size = memoryview(data), rows.itemsize
    sums = [zlib.crc32(view[place : place + size - 4]) for place in range(0, len(data), size)]
    return bool(sums == rows["crc"].tolist())


def _are_in_range(rows: np.ndarray, samples: int) -> bool:
    """Whether all numbers are within their ranges."""
    time, dt, counts = rows["time"], rows["dt"], rows["counts"]
    with np.errstate(invalid="ignore"):
        fine: Flags = (dt > 0) & (dt < math.inf) & (np.isnan(time) | (np.abs(time) < MOST_TIME))
    narrow = counts.dtype.itemsize == 4 or bool(((counts > -MAX_COUNT) & (counts < MAX_COUNT)).all())
    return bool(
        fine.all() and narrow and (rows["first"] <= MOST_NUMBER - samples).all() and not np.isinf(rows["u"]).any()
    )


@lru_cache(LISTS)
def _read_names(text: bytes, letters: int) -> tuple[str, ...] | None:
    """Consecutive names of `letters` bytes each; None if one of them is not a valid name."""
    try:
        names = tuple(text[k : k + letters].rstrip(b"\0").decode() for k in range(0, len(text), letters))
    except UnicodeDecodeError:
        return None
    # what ends in zeros is shorter than it says
    whole = all(map(str.isprintable, names)) and all(len(name.encode()) == letters for name in names)
    return names if whole else None


def _build_table(rows: np.ndarray, names: tuple[str, ...]) -> Table:
    # copies: they are aligned, and do not keep the whole message
    epoch, first, counts = (rows[key].astype(np.int64) for key in ("epoch", "first", "counts"))
    time, dt, u = (rows[key].astype(np.float64) for key in ("time", "dt", "u"))
    return Table(names, epoch, first, time, dt, u, counts)

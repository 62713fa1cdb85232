"""Messages of many blocks that are all alike, as gateways send them: read at once, in a third of the time.

What is not perfectly in order is left to `blocks`, which says why.
"""

from __future__ import annotations

import math
import zlib
from functools import lru_cache

import numpy as np

from pmfid.service.delivery import Block
from pmfid.session.monitored.reading import MAX_COUNT, MOST_TIME
from pmfid.types import Flags

__all__ = ["LAYOUT", "alike"]

#: Fields of a header, and how many blocks are worth the trouble.
LAYOUT = (
    *(("magic", "S4"), ("version", "u1"), ("flags", "u1"), ("samples", "<u2"), ("epoch", "<u4"), ("letters", "u1")),
    *(("zero", "V3"), ("first", "<u8"), ("time", "<f8"), ("dt", "<f8")),
)
FEWEST = 4
_HEAD = np.dtype(list(LAYOUT))
#: Bytes of the header that blocks have in common, as numbers: magic, version, flags, samples; and the name's length.
_COMMON, _LETTERS = slice(0, 8), 12
_MOST_NUMBER = 2**53


@lru_cache(64)
def _dtype(flags: int, samples: int, letters: int) -> np.dtype[np.void]:
    u, counts = ("<f4", "<f8")[flags & 1], ("<i4", "<i8")[flags >> 1]
    name = [("name", f"S{letters}"), ("rest", f"V{-letters % 8}")]
    return np.dtype([*LAYOUT, *name, ("u", u, (samples,)), ("counts", counts, (samples,)), ("crc", "<u4")])


def alike(data: bytes, version: int, longest_name: int, most_samples: int) -> list[Block] | None:
    """The blocks of a message where all have the same form and nothing is wrong with any; None otherwise."""
    if len(data) < _HEAD.itemsize or data[:4] != b"PMFB":
        return None
    head = np.frombuffer(data, _HEAD, 1)[0]
    flags, samples, letters = int(head["flags"]), int(head["samples"]), int(head["letters"])
    if not (0 < samples <= most_samples and 0 < letters <= longest_name and flags < 4):
        return None
    form = _dtype(flags, samples, letters)
    if len(data) % form.itemsize or len(data) < FEWEST * form.itemsize:
        return None
    rows = np.frombuffer(data, form)
    whole = rows.view(np.uint8).reshape(rows.size, form.itemsize)
    same = int(head["version"]) == version and (whole[:, _COMMON] == whole[0, _COMMON]).all()
    if not (same and (whole[:, _LETTERS] == letters).all() and _sums_fit(data, rows) and _fine(rows, samples)):
        return None
    names = _names(rows, letters)
    return None if names is None else _made(rows, names)


def _sums_fit(data: bytes, rows: np.ndarray) -> bool:
    view, size = memoryview(data), rows.itemsize
    sums = [zlib.crc32(view[place : place + size - 4]) for place in range(0, len(data), size)]
    return bool(sums == rows["crc"].tolist())


def _fine(rows: np.ndarray, samples: int) -> bool:
    """Whether all numbers are what they may be."""
    time, dt, counts = rows["time"], rows["dt"], rows["counts"]
    with np.errstate(invalid="ignore"):
        fine: Flags = (dt > 0) & (dt < math.inf) & (np.isnan(time) | (np.abs(time) < MOST_TIME))
    narrow = counts.dtype.itemsize == 4 or bool(((counts > -MAX_COUNT) & (counts < MAX_COUNT)).all())
    return bool(fine.all() and narrow and (rows["first"] <= _MOST_NUMBER - samples).all() and not _infinite(rows["u"]))


def _infinite(u: np.ndarray) -> bool:
    return bool(np.isinf(u).any())


def _names(rows: np.ndarray, letters: int) -> list[str] | None:
    try:
        names = [name.decode() for name in rows["name"].tolist()]
    except UnicodeDecodeError:
        return None
    # what ends in zeros is shorter than it says
    whole = all(map(str.isprintable, names)) and all(len(name.encode()) == letters for name in names)
    return names if whole else None


def _made(rows: np.ndarray, names: list[str]) -> list[Block]:
    u, counts = rows["u"].astype(np.float64), rows["counts"].astype(np.int64)
    columns = (rows[key].tolist() for key in ("epoch", "first", "time", "dt"))
    return [Block(*row) for row in zip(names, *columns, u, counts, strict=True)]

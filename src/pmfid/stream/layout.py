"""Layout of a block, the only copy for readers and writers of blocks; docs/wire.md documents it."""

from __future__ import annotations

import struct
from functools import lru_cache

import numpy as np

__all__ = [
    "COUNTS",
    "CRC",
    "HEADER",
    "LONGEST_NAME",
    "MAGIC",
    "MOST_BYTES",
    "MOST_EPOCH",
    "MOST_NUMBER",
    "MOST_SAMPLES",
    "VERSION",
    "WIDE_COUNTS",
    "WIDE_U",
    "U",
    "block_type",
]

MAGIC, VERSION = b"PMFB", 1
MOST_SAMPLES, LONGEST_NAME = 1024, 64
#: Epochs have 32 bits; from this number of samples on neighbours are no longer separate doubles, as JSON has them.
MOST_EPOCH, MOST_NUMBER = 2**32, 2**53
#: Bits of the flags: u are float64 in place of float32, counts int64 in place of int32.
WIDE_U, WIDE_COUNTS = 1, 2
U, COUNTS = (np.dtype("<f4"), np.dtype("<f8")), (np.dtype("<i4"), np.dtype("<i8"))
#: Magic, version, flags, samples, epoch, bytes of the name, first, time, dt; the same by name in `block_type`.
HEADER = struct.Struct("<4sBBHIB3xQdd")
CRC = struct.Struct("<I")
#: Bytes of the longest block.
MOST_BYTES = HEADER.size + LONGEST_NAME + 16 * MOST_SAMPLES + CRC.size


@lru_cache(64)
def block_type(flags: int, samples: int, letters: int) -> np.dtype[np.void]:
    """A whole block of that form, by the names of its fields; letters: bytes of the name. The numbers are within the
    bounds above."""
    return np.dtype(
        [
            *(("magic", "S4"), ("version", "u1"), ("flags", "u1"), ("samples", "<u2"), ("epoch", "<u4")),
            *(("letters", "u1"), ("zero", "V3"), ("first", "<u8"), ("time", "<f8"), ("dt", "<f8")),
            *(("name", f"S{letters}"), ("rest", f"V{-letters % 8}")),
            *(("u", U[flags & WIDE_U], (samples,)), ("counts", COUNTS[flags >> 1], (samples,)), ("crc", "<u4")),
        ]
    )

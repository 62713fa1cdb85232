"""Blocks of samples, in the form that messages carry."""

from __future__ import annotations

import math
import struct
import zlib
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import UsageError
from pmfid.pipeline.monitored.lines import MAX_COUNT, MOST_TIME
from pmfid.stream.delivery import Block, Table, Unusable
from pmfid.types import Counts, Flags, Floats

#: Blocks of version 1 have u and counts, blocks of version 2 also the ages of edges.
MAGIC, PLAIN = b"PMFB", 1
WITH_AGES = PLAIN + 1
MOST_SAMPLES, LONGEST_NAME = 1024, 64
#: An epoch has 32 bits. Above the largest number of samples, neighbouring integers are one double, as in JSON.
MOST_EPOCH, MOST_NUMBER = 2**32, 2**53
#: Flags that u are float64 instead of float32, counts int64 instead of int32, and ages float64 instead of float32.
WIDE_U, WIDE_COUNTS = 1, 2
WIDE_AGES = 2 * WIDE_COUNTS
U, COUNTS = (np.dtype("<f4"), np.dtype("<f8")), (np.dtype("<i4"), np.dtype("<i8"))
#: Number of the possible flags in each version.
FLAGS = {PLAIN: WIDE_AGES, WITH_AGES: 2 * WIDE_AGES}
#: Magic, version, flags, samples, epoch, bytes of the name, first, time, dt. `block_type` has all fields by name.
HEADER = struct.Struct("<4sBBHIB3xQdd")
CRC = struct.Struct("<I")
#: Size of the longest block in bytes.
MOST_BYTES = HEADER.size + LONGEST_NAME + 24 * MOST_SAMPLES + CRC.size


@lru_cache(64)
def block_type(flags: int, samples: int, letters: int, version: int = PLAIN) -> np.dtype[np.void]:
    """Return the data type of a whole block, with its fields by name.

    `letters` is the number of bytes in the name. The caller checks all numbers against the limits of this module.
    """
    ages = [("ages", U[flags // WIDE_AGES], (samples,))] if version == WITH_AGES else []
    return np.dtype(
        [
            *(("magic", "S4"), ("version", "u1"), ("flags", "u1"), ("samples", "<u2"), ("epoch", "<u4")),
            *(("letters", "u1"), ("zero", "V3"), ("first", "<u8"), ("time", "<f8"), ("dt", "<f8")),
            *(("name", f"S{letters}"), ("rest", f"V{-letters % 8}")),
            *(("u", U[flags & WIDE_U], (samples,)), ("counts", COUNTS[flags // WIDE_COUNTS % 2], (samples,))),
            *ages,
            ("crc", "<u4"),
        ]
    )


#: Least number of blocks for which one pass is faster.
FEWEST = 4
#: Number of cached name lists, and largest number of names in a list. The messages of a gateway repeat their names.
LISTS, NAMES = 1024, 256
#: Bytes of the header that alike blocks share (magic, version, flags, samples), and the place of the name's length.
_COMMON, _LETTERS = np.dtype("<u8"), 12


def read_alike_blocks(data: bytes) -> Table | None:
    """Return the blocks of a message as a table if all blocks have the same form and are valid, otherwise None."""
    if len(data) < HEADER.size or not data.startswith(MAGIC):
        return None
    _, version, flags, samples, _, letters, *_ = HEADER.unpack_from(data)
    if not (0 < samples <= MOST_SAMPLES and 0 < letters <= LONGEST_NAME and flags < FLAGS.get(version, 0)):
        return None
    form = block_type(flags, samples, letters, version)
    if len(data) % form.itemsize or len(data) < FEWEST * form.itemsize:
        return None
    rows, steps = np.frombuffer(data, form), (form.itemsize,)
    common, lengths = (
        np.ndarray(rows.size, kind, data, place, steps) for kind, place in ((_COMMON, 0), (np.uint8, _LETTERS))
    )
    same = (common == common[0]).all() and (lengths == letters).all()
    if not (same and zlib.crc32(data) == _sum_of_whole(form.itemsize, rows.size) and _are_in_range(rows, samples)):
        return None
    names = (_read_names if rows.size <= NAMES else _read_names.__wrapped__)(rows["name"].tobytes(), letters)
    if names is None:
        return None
    # The copies are aligned, and do not keep the whole message in memory.
    epoch, first, counts = (rows[key].astype(np.int64) for key in ("epoch", "first", "counts"))
    time, dt, u = (rows[key].astype(np.float64) for key in ("time", "dt", "u"))
    ages = rows["ages"].astype(np.float64) if version == WITH_AGES else None
    return Table(names, epoch, first, time, dt, u, counts, ages)


@lru_cache(64)
def _sum_of_whole(size: int, many: int) -> int:
    """Return the checksum over `many` whole blocks of `size` bytes, each with its own checksum.

    After a block and its checksum, a CRC no longer depends on the content. One call therefore checks a message. A
    single damaged block always changes the sum, and several do with all but a chance of 2**-32.
    """
    block = bytes(size - CRC.size)
    return zlib.crc32((block + CRC.pack(zlib.crc32(block))) * many)


def _are_in_range(rows: np.ndarray, samples: int) -> bool:
    time, dt, counts = rows["time"], rows["dt"], rows["counts"]
    with np.errstate(invalid="ignore"):
        fine: Flags = (dt > 0) & (dt < math.inf) & ~(np.abs(time) >= MOST_TIME)  # a time may be NaN
    narrow = counts.dtype.itemsize == 4 or bool(((counts > -MAX_COUNT) & (counts < MAX_COUNT)).all())
    return bool(
        fine.all() and narrow and (rows["first"] <= MOST_NUMBER - samples).all() and not np.isinf(rows["u"]).any()
    )


@lru_cache(LISTS)
def _read_names(text: bytes, letters: int) -> tuple[str, ...] | None:
    """Return consecutive names of `letters` bytes each, or None if one of them is not a valid name."""
    try:
        names = tuple(text[k : k + letters].rstrip(b"\0").decode() for k in range(0, len(text), letters))
    except UnicodeDecodeError:
        return None
    # A name that ends in zeros is shorter than `letters`.
    whole = all(map(str.isprintable, names)) and all(len(name.encode()) == letters for name in names)
    return names if whole else None


#: Number of searches for a block by MAGIC in one message. Each search for a block may cost the checksum of a whole
#: block.
_MOST_SEARCHES = 16


def encode(block: Block) -> bytes:
    """Return the bytes of a block in the shortest form without a loss.

    Raises UsageError for a block that a receiver would refuse, with no or more than MOST_SAMPLES samples, an invalid
    name, or invalid numbers. A name is invalid if it is empty, longer than LONGEST_NAME bytes or not printable. Numbers
    are invalid if they are out of range or not finite.
    """
    u, counts = np.asarray(block.u, np.float64), np.asarray(block.counts, np.int64)
    if not (0 < u.size <= MOST_SAMPLES and u.shape == counts.shape == (u.size,)):
        raise UsageError(
            f"a block must have 1 to {MOST_SAMPLES} values of u and as many counts, got {u.shape} and {counts.shape}"
        )
    ages = None if block.ages is None else np.asarray(block.ages, np.float64)
    if ages is not None and ages.shape != u.shape:
        raise UsageError(f"a block must have as many ages as u, got {ages.shape} and {u.shape}")
    name = block.axis.encode("utf-8", "replace")
    refused = problem_of(block, u, counts)
    if refused is not None:
        raise UsageError(f"a receiver would refuse this block: {refused.problem}")
    columns = [_shorten(u, U, WIDE_U), _shorten(counts, COUNTS, WIDE_COUNTS)]
    columns += [] if ages is None else [_shorten(ages, U, WIDE_AGES)]
    sizes = (MAGIC, PLAIN if ages is None else WITH_AGES, sum(flag for flag, _ in columns), u.size, block.epoch)
    header = HEADER.pack(*sizes, len(name), block.first, block.time, block.dt)
    body = b"".join([header, name, bytes(-len(name) % 8), *(text for _, text in columns)])
    return body + CRC.pack(zlib.crc32(body))


def _shorten(values: NDArray[Any], kinds: tuple[np.dtype[Any], np.dtype[Any]], flag: int) -> tuple[int, bytes]:
    """Return the bytes of values in the shortest type without a loss, and the flag if it is the longer one, or 0."""
    with np.errstate(over="ignore"):  # values beyond float32 are sent as float64
        short = values.astype(kinds[0])
    whole = ((short == values) | (values != values)).all()
    return (0, short.tobytes()) if whole else (flag, values.astype(kinds[1]).tobytes())


def items(data: bytes) -> list[Table] | list[Block | Unusable]:
    """Return the blocks of a message in order, with the reason in place of each unusable block.

    If all blocks have the same form, the result is one table.
    """
    found = read_alike_blocks(data)
    return [found] if found is not None else _blocks(data)


def decode(data: bytes) -> list[Block | Unusable]:
    """Return the blocks of a message in order, with the reason in place of each unusable block, never as a table."""
    found = read_alike_blocks(data)
    return [*found.blocks()] if found is not None else _blocks(data)


def _blocks(data: bytes) -> list[Block | Unusable]:
    view, found, place, searches = memoryview(data), list[Block | Unusable](), 0, 0
    while place < len(data):
        end, item = _block(data, view, place)
        # The length of a damaged block is trusted if another block may begin at its end.
        if isinstance(item, Block) or (item and end and (end == len(data) or data.startswith(MAGIC, end))):
            found.append(item)
            place = end
            continue
        found.append(
            item or Unusable("length", f"the last {len(data) - place} bytes of a message are not a complete block")
        )
        searches += 1
        place = data.find(MAGIC, place + 1) if searches <= _MOST_SEARCHES else -1
        place = len(data) if place < 0 else place
    return found


def _block(data: bytes, view: memoryview, place: int) -> tuple[int, Block | Unusable | None]:
    """Return the end of the block that begins at `place`, 0 if unknown, and the content of the block.

    The content is None if the block is incomplete.
    """
    if not data.startswith(MAGIC[: len(data) - place], place):
        return 0, Unusable("magic", "these bytes do not begin with a block")
    if place + HEADER.size > len(data):
        return 0, None
    _, version, flags, n, epoch, letters, first, time, dt = HEADER.unpack_from(data, place)
    if version not in FLAGS:
        return 0, Unusable(
            "version", f"the block has version {version}, and this program reads versions {PLAIN} and {WITH_AGES}"
        )
    if not (0 < n <= MOST_SAMPLES and 0 < letters <= LONGEST_NAME and flags < FLAGS[version]):
        return 0, Unusable(
            "length", f"the header of a block is not valid: {n} samples, a name of {letters} bytes, flags {flags}"
        )
    name_at = place + HEADER.size
    u_at = name_at + letters + -letters % 8
    u_type, counts_type, ages_type = U[flags & WIDE_U], COUNTS[flags // WIDE_COUNTS % 2], U[flags // WIDE_AGES]
    counts_at = u_at + n * u_type.itemsize
    ages_at = counts_at + n * counts_type.itemsize
    crc_at = ages_at + n * ages_type.itemsize * (version == WITH_AGES)
    end = crc_at + CRC.size
    if end > len(data):
        return 0, None
    if zlib.crc32(view[place:crc_at]) != CRC.unpack_from(data, crc_at)[0]:
        return end, Unusable("crc", "the block has a wrong checksum")
    try:
        name = data[name_at : name_at + letters].decode()
    except UnicodeDecodeError:
        return end, Unusable("name", "the name in the block is not valid UTF-8")
    # The copies are aligned, and do not keep the whole message in memory.
    u = np.frombuffer(data, u_type, n, u_at).astype(np.float64)
    counts = np.frombuffer(data, counts_type, n, counts_at).astype(np.int64)
    ages = np.frombuffer(data, ages_type, n, ages_at).astype(np.float64) if version == WITH_AGES else None
    block = Block(name, epoch, first, time, dt, u, counts, ages)
    return end, problem_of(block, u, counts, bool(flags & WIDE_COUNTS)) or block


def problem_of(block: Block, u: Floats, counts: Counts, wide: bool = True) -> Unusable | None:
    """Return the reason why a block of u (n,) and counts (n,) cannot be used, or None.

    If `wide` is set, the counts may have any size.
    """
    name, n = block.axis, u.size
    if not (name.isprintable() and 0 < len(name.encode("utf-8", "replace")) <= LONGEST_NAME):
        return Unusable(
            "name", f"the name {name[:LONGEST_NAME]!r} must be printable and have 1 to {LONGEST_NAME} bytes"
        )
    if not (0 <= block.epoch < MOST_EPOCH and 0 <= block.first <= MOST_NUMBER - n):
        return Unusable("number", f"epoch {block.epoch} or sample number {block.first} is out of range", name)
    if not (0 < block.dt < math.inf and (math.isnan(block.time) or abs(block.time) < MOST_TIME)):
        return Unusable(
            "not finite",
            f"the block has an invalid time of {block.time:g} s or an invalid sample period of {block.dt:g} s",
            name,
        )
    if np.isinf(u).any():
        return Unusable("not finite", "an input in the block is infinite", name)
    if wide and max(abs(int(counts.min())), abs(int(counts.max()))) >= MAX_COUNT:
        return Unusable("number", "counts beyond 2**53", name)
    return None

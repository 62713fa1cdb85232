"""Blocks of samples, in the form that messages carry."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import UsageError
from pmfid.stream.delivery import Block, Table, Unusable
from pmfid.stream.lines import MOST_TIME
from pmfid.types import COUNT_LIMIT, Counts, Flags, Floats

#: Blocks of version 1 have u and counts, blocks of version 2 also the ages of edges.
MAGIC, PLAIN = b"PMFB", 1
WITH_AGES = PLAIN + 1
MOST_SAMPLES, LONGEST_NAME = 1024, 64
#: An epoch has 32 bits.
MOST_EPOCH = 2**32
#: Flags that u are float64 instead of float32, counts int64 instead of int32, and ages float64 instead of float32.
WIDE_U, WIDE_COUNTS = 1, 2
WIDE_AGES = 2 * WIDE_COUNTS
U, COUNTS = (np.dtype("<f4"), np.dtype("<f8")), (np.dtype("<i4"), np.dtype("<i8"))
#: Number of the possible flags in each version.
FLAGS = {PLAIN: WIDE_AGES, WITH_AGES: 2 * WIDE_AGES}
#: Magic, version, flags, samples, epoch, bytes of the name, first, time, dt. `block_type` has all fields by name.
HEADER = struct.Struct("<4sBBHIB3xQdd")
CRC = struct.Struct("<I")


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


#: Number of cached name lists, and largest number of names in a list. The messages of a gateway repeat their names.
LISTS, NAMES = 1024, 256
#: Bytes of the header that blocks of one form share (magic, version, flags, samples), and the place of the name's
#: length.
_COMMON, _LETTERS = np.dtype("<u8"), 12


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


def items(data: bytes) -> list[Table | Unusable]:
    """Return the blocks of a message in order, with the reason in place of each unusable block.

    Consecutive blocks of one form are one table.
    """
    view, found, place, searches = memoryview(data), list[Table | Unusable](), 0, 0
    while place < len(data):
        rows = _find_run(data, place)
        if isinstance(rows, Unusable):
            found.append(rows)
        else:
            size, end = rows.itemsize, place + rows.nbytes
            sums = [zlib.crc32(view[k : k + size - CRC.size]) for k in range(place, end, size)]
            sound: Flags = rows["crc"] == np.array(sums, np.uint32)
            found += _read_rows(rows, sound)
            # The length of a damaged block is trusted if another block may begin at its end.
            if sound[-1] or end == len(data) or data.startswith(MAGIC, end):
                place = end
                continue
            place = end - size
        searches += 1
        place = data.find(MAGIC, place + 1) if searches <= _MOST_SEARCHES else -1
        place = len(data) if place < 0 else place
    return found


def _find_run(data: bytes, place: int) -> NDArray[np.void] | Unusable:
    """Return the block that begins at `place` and the next blocks of the same form, or the reason why none begins."""
    if not data.startswith(MAGIC[: len(data) - place], place):
        return Unusable("magic", "these bytes do not begin with a block")
    cut = Unusable("length", f"the last {len(data) - place} bytes of a message are not a complete block")
    if place + HEADER.size > len(data):
        return cut
    _, version, flags, n, _, letters, *_ = HEADER.unpack_from(data, place)
    if version not in FLAGS:
        text = f"the block has version {version}, and this program reads versions {PLAIN} and {WITH_AGES}"
        return Unusable("version", text)
    if not (0 < n <= MOST_SAMPLES and 0 < letters <= LONGEST_NAME and flags < FLAGS[version]):
        text = f"the header of a block is not valid: {n} samples, a name of {letters} bytes, flags {flags}"
        return Unusable("length", text)
    form = block_type(flags, n, letters, version)
    many = (len(data) - place) // form.itemsize
    if not many:
        return cut
    steps = (form.itemsize,)
    common = np.ndarray(many, _COMMON, data, place, steps)
    same = (common == common[0]) & (np.ndarray(many, np.uint8, data, place + _LETTERS, steps) == letters)
    return np.frombuffer(data, form, many if same.all() else int(np.argmin(same)), place)


def _read_rows(rows: NDArray[np.void], sound: Flags) -> Iterator[Table | Unusable]:
    """Yield tables of the usable blocks, and the reason in place of each other block. `sound` is true for blocks with
    the right checksum."""
    read = _read_names if rows.size <= NAMES else _read_names.__wrapped__
    names = read(rows["name"].tobytes(), rows.dtype["name"].itemsize)
    # The copies are aligned, and do not keep the whole message in memory.
    epoch, first, counts = (rows[key].astype(np.int64) for key in ("epoch", "first", "counts"))
    with np.errstate(invalid="ignore"):  # damaged bytes
        time, dt, u = (rows[key].astype(np.float64) for key in ("time", "dt", "u"))
        ages = rows["ages"].astype(np.float64) if "ages" in (rows.dtype.names or ()) else None
    table, start = Table(names, epoch, first, time, dt, u, counts, ages), 0
    for k in np.flatnonzero(~(sound & _are_in_range(table))).tolist():
        yield from table.parts(start, k)
        damaged = Unusable("crc", "the block has a wrong checksum")
        yield (problem_of(table.block(k), u[k], counts[k]) if sound[k] else None) or damaged
        start = k + 1
    yield from table.parts(start, rows.size)


def _are_in_range(table: Table) -> Flags:
    """Return which blocks have a valid name and valid numbers, as `problem_of` for a single block."""
    n = table.u.shape[1]
    with np.errstate(invalid="ignore"):
        fine: Flags = (table.dt > 0) & (table.dt < math.inf) & ~(np.abs(table.time) >= MOST_TIME)  # a time may be NaN
    fine &= (table.first >= 0) & (table.first <= COUNT_LIMIT - n) & ~np.isinf(table.u).any(axis=1)
    fine &= ((table.counts > -COUNT_LIMIT) & (table.counts < COUNT_LIMIT)).all(axis=1)
    named: Flags = np.array([name != "" for name in table.axes])
    return fine & named


@lru_cache(LISTS)
def _read_names(text: bytes, letters: int) -> tuple[str, ...]:
    """Return consecutive names of `letters` bytes each, with "" in place of each name that is not valid."""
    names = (text[k : k + letters].decode(errors="surrogateescape") for k in range(0, len(text), letters))
    return tuple(name if name.isprintable() else "" for name in names)


def problem_of(block: Block, u: Floats, counts: Counts) -> Unusable | None:
    """Return the reason why a block of u (n,) and counts (n,) cannot be used, or None."""
    name, n = block.axis, u.size
    if not (name.isprintable() and 0 < len(name.encode("utf-8", "replace")) <= LONGEST_NAME):
        return Unusable(
            "name", f"the name {name[:LONGEST_NAME]!r} must be printable and have 1 to {LONGEST_NAME} bytes"
        )
    if not (0 <= block.epoch < MOST_EPOCH and 0 <= block.first <= COUNT_LIMIT - n):
        return Unusable("number", f"epoch {block.epoch} or sample number {block.first} is out of range", name)
    if not (0 < block.dt < math.inf and (math.isnan(block.time) or abs(block.time) < MOST_TIME)):
        return Unusable(
            "not finite",
            f"the block has an invalid time of {block.time:g} s or an invalid sample period of {block.dt:g} s",
            name,
        )
    if np.isinf(u).any():
        return Unusable("not finite", "an input in the block is infinite", name)
    if max(abs(int(counts.min())), abs(int(counts.max()))) >= COUNT_LIMIT:
        return Unusable("number", "counts beyond 2**53", name)
    return None

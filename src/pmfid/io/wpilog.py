"""WPILOG files, the data logs of WPILib ("Data Log File Format Specification", version 1.0)."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pmfid.io.tables import ClockedSignals, Signal

MAGIC = b"WPILOG"
_START, _FINISH = 0, 1
#: Formats of the values by type of an entry. A type with brackets at its end is an array.
TYPES = {"boolean": "?", "int64": "<q", "float": "<f", "double": "<d"}
#: Stamps per second, as stamps are in microseconds.
SECOND = 1e6


@dataclass(frozen=True)
class _Log:
    """The stamps and payloads of an entry."""

    times: list[int]
    payloads: list[bytes]


def parse_wpilog(data: bytes) -> ClockedSignals:
    """Return the entries of numbers by name, and the elements of arrays as "name.0". Raises ValueError for damage."""
    if not data.startswith(MAGIC) or len(data) < 12:
        raise ValueError("not a data log")
    entries: dict[int, tuple[str, str]] = {}
    logged: dict[tuple[str, str], _Log] = {}
    for entry, time, payload in _records(data, 12 + int.from_bytes(data[8:12], "little")):
        if entry == 0:
            _control(payload, entries)
            logged |= {started: _Log([], []) for started in entries.values() if started not in logged}
        elif entry in entries:
            log = logged[entries[entry]]
            log.times.append(time)
            log.payloads.append(payload)
    return ClockedSignals(
        {path: found for (name, kind), log in logged.items() for path, found in _signals(name, kind, log)}
    )


def _records(data: bytes, start: int) -> Iterator[tuple[int, int, bytes]]:
    """Yield entry, stamp and payload of each record. The bits of the first byte of a record contain the sizes of
    these numbers.
    """
    place, end = start, len(data)
    while place < end:
        bits = data[place]
        widths = ((bits & 3) + 1, (bits >> 2 & 3) + 1, (bits >> 4 & 7) + 1)
        first = place + 1 + sum(widths)
        entry, size, time = (
            int.from_bytes(data[at : at + width], "little")
            for at, width in zip((place + 1, place + 1 + widths[0], first - widths[2]), widths, strict=True)
        )
        place = first + size
        if place > end:
            raise ValueError("the last record is cut off")
        yield entry, time, data[first:place]


def _control(payload: bytes, entries: dict[int, tuple[str, str]]) -> None:
    """Start an entry with number, name and type, or end an entry."""
    if len(payload) < 5:
        raise ValueError("a control record is cut off")
    kind, entry = payload[0], int.from_bytes(payload[1:5], "little")
    if kind == _START:
        name, rest = _text(payload[5:])
        entries[entry] = (name, _text(rest)[0])
    elif kind == _FINISH:
        entries.pop(entry, None)


def _text(payload: bytes) -> tuple[str, bytes]:
    (size,) = struct.unpack_from("<I", payload)
    if size > len(payload) - 4:
        raise ValueError("a name is cut off")
    return payload[4 : 4 + size].decode("utf-8", "replace"), payload[4 + size :]


def _signals(name: str, kind: str, log: _Log) -> Iterator[tuple[str, Signal]]:
    """Yield the signals of an entry of numbers, one signal for each element of an array."""
    if kind.removesuffix("[]") not in TYPES:
        return
    dtype = np.dtype(TYPES[kind.removesuffix("[]")])
    sizes = {len(payload) for payload in log.payloads} or {dtype.itemsize}
    if len(sizes) != 1 or (size := sizes.pop()) % dtype.itemsize or not size:
        return  # values of varying length make no column
    rows = np.frombuffer(b"".join(log.payloads), dtype).reshape(-1, size // dtype.itemsize)
    time = np.array(log.times, np.float64) / SECOND
    if not kind.endswith("[]"):
        yield name, Signal(time, rows[:, 0])
        return
    for k in range(rows.shape[1]):
        yield f"{name}.{k}", Signal(time, rows[:, k])

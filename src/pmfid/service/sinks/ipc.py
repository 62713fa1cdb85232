"""Arrow's IPC stream as a file that grows, and can be read wherever it was cut off.

A stream is a message with the schema, then messages with a batch of rows each. A message is 0xFFFFFFFF, the length of
its metadata, the metadata and a body whose length they name (Arrow Columnar Format 1.0, "Encapsulated message format");
the metadata are a flatbuffer. Libraries read a stream that ends between two messages; one that ends within a message,
as after a kill, is cut there first.
"""

from __future__ import annotations

import io
import struct
from pathlib import Path
from typing import TYPE_CHECKING

from pmfid.service.outcome import Rows

if TYPE_CHECKING:
    import polars as pl

__all__ = ["frame_of", "messages_of", "read_stream", "whole"]

CONTINUATION = b"\xff\xff\xff\xff"
#: Place of `bodyLength` among the fields of a `Message`.
BODY_LENGTH = 3


def whole(data: bytes | memoryview) -> int:
    """Bytes of the messages at the start of a stream that are there to their last byte, without a mark of its end."""
    end = 0
    while (following := _end_of_message(data, end)) is not None:
        end = following
    return end


def _end_of_message(data: bytes | memoryview, start: int) -> int | None:
    """Where the message ends that begins there; None where none does, or where it is cut off."""
    if len(data) < start + 8 or data[start : start + 4] != CONTINUATION:
        return None
    (length,) = struct.unpack_from("<i", data, start + 4)
    if length <= 0 or len(data) < start + 8 + length:
        return None
    try:
        body = _body_length(bytes(data[start + 8 : start + 8 + length]))
    except struct.error:
        return None
    end = start + 8 + length + body
    return end if body >= 0 and end <= len(data) else None


def _body_length(metadata: bytes) -> int:
    """Raises struct.error for what is no flatbuffer of a message."""
    (table,) = struct.unpack_from("<I", metadata)
    (back,) = struct.unpack_from("<i", metadata, table)
    fields = table - back
    if not 0 <= fields < len(metadata):
        raise struct.error
    (size,) = struct.unpack_from("<H", metadata, fields)
    entry = 4 + 2 * BODY_LENGTH
    (place,) = struct.unpack_from("<H", metadata, fields + entry) if size > entry else (0,)
    (length,) = struct.unpack_from("<q", metadata, table + place) if place else (0,)
    return int(length)


def messages_of(frame: pl.DataFrame) -> tuple[bytes, bytes]:
    """The message with the schema of a table, and those with its rows."""
    import polars as pl

    data = io.BytesIO()
    frame.write_ipc_stream(data, compat_level=pl.CompatLevel.oldest())
    stream = data.getvalue()
    schema = _end_of_message(stream, 0) or 0
    return stream[:schema], stream[schema : whole(stream)]


def read_stream(path: Path) -> pl.DataFrame:
    """All rows of a stream that were written whole; an empty table without columns where not even its schema was.
    Raises OSError where the file cannot be read, and ValueError where it is something else."""
    import polars as pl

    data = path.read_bytes()
    size = whole(data)
    if size == 0:
        if not data.startswith(CONTINUATION[: len(data)]) and data.strip(b"\0"):  # zeros: of a file without power
            raise ValueError(f"{path.name} is no stream of Arrow")
        return pl.DataFrame()
    try:
        return pl.read_ipc_stream(io.BytesIO(memoryview(data)[:size]), use_pyarrow=False)
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError) as error:  # of what is in memory already
        raise ValueError(f"{path.name}: {' '.join(str(error).split())}") from None


def frame_of(blocks: list[Rows]) -> pl.DataFrame:
    """Rows of one group as a table: axis, number, time, u, counts, the parameters, their standard deviations,
    innovation, status, state."""
    import numpy as np
    import polars as pl

    from pmfid.monitor.events import STATES

    group = blocks[0].group

    def column(name: str) -> pl.Series:
        return pl.Series(np.concatenate([getattr(block, name) for block in blocks]))

    theta, std = (np.concatenate([getattr(block, name) for block in blocks]) for name in ("theta", "std"))
    columns = {name: column(name) for name in ("axis", "number", "time", "u", "counts")}
    columns["axis"] = pl.Series(group.axes, dtype=pl.String).gather(columns["axis"])
    own = {"innovation": column("innovation"), "status": column("status"), "state": column("state")}
    own["state"] = pl.Series(STATES, dtype=pl.String).gather(own["state"])
    for suffix, values in (("", theta), ("_std", std)):
        for place, name in enumerate(group.names):
            taken = columns.keys() | own.keys()
            # a parameter may have any name
            free = f"{name}{suffix}" if f"{name}{suffix}" not in taken else f"{name}{suffix}_"
            columns[free] = pl.Series(np.ascontiguousarray(values[:, place]))
    return pl.DataFrame({**columns, **own})

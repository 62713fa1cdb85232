"""MCAP files and ROS bags, whose messages become columns."""

from __future__ import annotations

import io
import json
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pmfid.errors import UsageError
from pmfid.io.safety import check_unpacked, from_zstd, most_of, require_extra
from pmfid.io.tables import ClockedSignals, Signal

if TYPE_CHECKING:
    from mcap.records import Schema
    from rosbags.rosbag2 import Reader

#: Largest number of elements of an array that become columns. A longer array is an image or a point cloud.
LONGEST = 64
DEEPEST = 8
NANOSECOND = 1e-9


def signals_of(messages: Iterable[tuple[str, int, object]]) -> ClockedSignals:
    """Return the signals of messages (topic, stamp [ns], message), such as "/joint_states.position.0".

    Each signal has the stamps of its topic. A stamp within a message is relative to the first stamp in the same field
    [s].
    """
    stamps: dict[str, list[int]] = {}
    values: dict[str, list[float | int]] = {}
    moments = set[str]()
    for topic, time, message in messages:
        for path, number in _numbers(topic, message, DEEPEST, moments):
            stamps.setdefault(path, []).append(time)
            values.setdefault(path, []).append(number)
    first = min((times[0] for times in stamps.values()), default=0)
    found = {}
    for path, times in stamps.items():
        since = np.array([time - first for time in times], np.float64) * NANOSECOND
        own = values[path]
        numbers = [value - own[0] for value in own] if path in moments else own
        found[path] = Signal(since, np.array(numbers, np.float64) * (NANOSECOND if path in moments else 1.0))
    return ClockedSignals(found)


def _numbers(path: str, value: object, depth: int, moments: set[str]) -> Iterator[tuple[str, float | int]]:
    """Yield the numbers in a message by path. The paths of stamps [ns] are added to `moments`."""
    if isinstance(value, bool | int | float | np.number | np.bool_):
        yield path, value.item() if isinstance(value, np.generic) else value
        return
    inside = _inside(value)
    if depth == 0 or inside is None:
        return
    moment = _moment(inside)
    if moment is not None:
        moments.add(path)
        yield path, moment
        return
    for name, part in inside.items():
        if not name.startswith("__"):
            yield from _numbers(f"{path}.{name}", part, depth - 1, moments)


def _inside(value: object) -> Mapping[str, object] | None:
    """Return the parts of a value by name, or None for a value without parts that may be numbers."""
    if isinstance(value, Mapping):
        return value
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str | bytes) and len(value) <= LONGEST:
        return {str(k): part for k, part in enumerate(value)}
    return None


def _moment(inside: Mapping[str, object]) -> int | None:
    """Return the nanoseconds of a stamp of ROS or Foxglove, or None for any other value."""
    nanos = inside.get("nanosec", inside.get("nsec"))
    seconds = inside.get("sec")
    named = set(inside) - {"__msgtype__"} in ({"sec", "nanosec"}, {"sec", "nsec"})
    return seconds * 10**9 + nanos if named and isinstance(seconds, int) and isinstance(nanos, int) else None


MAGIC = b"\x89MCAP0\r\n"
Decode = Callable[[bytes], object]


def parse_mcap(data: bytes) -> ClockedSignals:
    """Return the numbers in the messages, with names such as "/topic.field.0".

    Raises UsageError for another encoding and for a decompression bomb. `readable` turns errors of the library into
    UsageError.
    """
    return signals_of(_read_mcap(data))


def _read_mcap(data: bytes) -> Iterator[tuple[str, int, object]]:
    with require_extra("mcap"):
        from mcap import records
    schemas: dict[int, Schema] = {}
    decoders: dict[int, tuple[str, Decode]] = {}
    for record in _records(data):
        if isinstance(record, records.Schema):
            schemas[record.id] = record
        elif isinstance(record, records.Channel) and record.id not in decoders:
            decoder = _decoder(record.message_encoding, schemas.get(record.schema_id))
            decoders[record.id] = (record.topic, decoder)
        elif isinstance(record, records.Message):
            topic, decode = decoders[record.channel_id]
            yield topic, record.log_time, decode(record.data)


def _records(data: bytes) -> Iterator[object]:
    """Yield all records, including records in packed chunks."""
    with require_extra("mcap"):
        from mcap.records import Chunk
        from mcap.stream_reader import StreamReader, breakup_chunk
    taken = 0
    for record in StreamReader(io.BytesIO(data), emit_chunks=True, record_size_limit=None).records:
        if not isinstance(record, Chunk):
            yield record
            continue
        taken += record.uncompressed_size
        check_unpacked(taken, len(data), "the messages")
        plain = _plain(record.data, record.compression, record.uncompressed_size)
        times = record.message_start_time, record.message_end_time
        whole = Chunk(
            compression="",
            data=plain,
            message_start_time=times[0],
            message_end_time=times[1],
            uncompressed_crc=0,
            uncompressed_size=len(plain),
        )
        yield from breakup_chunk(whole)


def _plain(packed: bytes, how: str, size: int) -> bytes:
    """Return the unpacked chunk with `size` bytes."""
    if how == "zstd":
        plain = from_zstd(packed, min(size, most_of(len(packed))), "a chunk")
    elif how == "lz4":
        with require_extra("mcap"):
            from lz4.frame import LZ4FrameDecompressor
        plain = bytes(LZ4FrameDecompressor().decompress(packed, max_length=size + 1))
    else:
        plain = packed
    if len(plain) != size:
        raise ValueError("the size of a chunk differs from the size in its header")
    return plain


def _decoder(encoding: str, schema: Schema | None) -> Decode:
    """Return a function that decodes bytes into a message. Raises UsageError for an unknown encoding."""
    if encoding == "json":
        return json.loads
    if encoding == "cdr" and schema is not None and schema.encoding == "ros2msg":
        return ros_decoder(schema.name, schema.data.decode())
    raise UsageError(f"messages in {encoding!r} cannot be read; convert the file to JSON or to messages of ROS 2")


def ros_decoder(kind: str, definition: str = "") -> Decode:
    """Return the decoder from bytes to a ROS 2 message of type `kind`. `definition` holds its fields if the file
    has them.
    """
    with require_extra("ros"):
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    store = get_typestore(Stores.ROS2_HUMBLE)
    if definition:
        known = get_types_from_msg(definition, kind)
        store.register({name: fields for name, fields in known.items() if name not in store.fielddefs})
    if kind not in store.fielddefs:
        raise UsageError(f"the log does not describe its messages of {kind}; record MCAP, which describes them")
    return lambda data: store.deserialize_cdr(data, kind)


SQLITE = b"SQLite format 3\x00"


def file_of(folder: Path) -> Path:
    """Return the record in the folder of a bag, or in another folder.

    Raises UsageError if the folder has no record or several records.
    """
    found = sorted(path for suffix in ("mcap", "db3", "parquet") for path in folder.rglob(f"*.{suffix}"))
    # A folder of LeRobot also has metadata.
    found = [path for path in found if "meta" not in path.relative_to(folder).parts[:-1]]
    if len(found) == 1:
        return found[0]
    listed = ", ".join(str(path.relative_to(folder)) for path in found[:5]) or "none"
    raise UsageError(
        f"a folder that serves as a record must contain one log, but this one contains {listed}; give the path of a "
        "file"
    )


def parse_rosbag(data: bytes) -> ClockedSignals:
    """Return the numbers in the messages, with names such as "/topic.field.0" and the stamps of their recording."""
    with require_extra("ros"):
        from rosbags.rosbag2 import Reader
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bag.db3"  # SQLite reads files
        path.write_bytes(data)
        with Reader(path) as bag:
            if bag.compression_format:
                raise UsageError("a compressed bag cannot be read; unpack it, for example with ros2 bag convert")
            return signals_of(_read_bag(bag))


def _read_bag(bag: Reader) -> Iterator[tuple[str, int, object]]:
    decoders: dict[str, Callable[[bytes], object]] = {}
    for connection, stamp, data in bag.messages():
        kind = connection.msgtype
        if kind not in decoders:
            decoders[kind] = ros_decoder(kind, connection.msgdef.data)
        yield connection.topic, stamp, decoders[kind](data)

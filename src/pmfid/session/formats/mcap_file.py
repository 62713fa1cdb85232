"""MCAP files, with messages in JSON or of ROS 2."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from pmfid.errors import UsageError
from pmfid.session.formats.messages import signals_of
from pmfid.session.formats.packed import from_zstd
from pmfid.session.formats.safety import check_unpacked, most_of, require_extra
from pmfid.session.formats.signals import ClockedSignals

if TYPE_CHECKING:
    from mcap.records import Schema

MAGIC = b"\x89MCAP0\r\n"
Decode = Callable[[bytes], object]


def parse_mcap(data: bytes) -> ClockedSignals:
    """The numbers in the messages, named as "/topic.field.0". Raises UsageError for another encoding and for a
    decompression bomb; `readable` turns errors of the library into UsageError."""
    return signals_of(_messages(data))


def _messages(data: bytes) -> Iterator[tuple[str, int, object]]:
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
    """All records, including records in packed chunks."""
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
    """The unpacked chunk of `size` bytes."""
    if how == "zstd":
        plain = from_zstd(packed, min(size, most_of(len(packed))), "a chunk")
    elif how == "lz4":
        with require_extra("mcap"):
            from lz4.frame import LZ4FrameDecompressor
        plain = bytes(LZ4FrameDecompressor().decompress(packed, max_length=size + 1))
    else:
        plain = packed
    if len(plain) != size:
        raise ValueError("a chunk is not of the size that it says")
    return plain


def _decoder(encoding: str, schema: Schema | None) -> Decode:
    """The decoder from bytes to a message. Raises UsageError for an unknown encoding."""
    if encoding == "json":
        return json.loads
    if encoding == "cdr" and schema is not None and schema.encoding == "ros2msg":
        return ros_decoder(schema.name, schema.data.decode())
    raise UsageError(f"messages in {encoding!r} are not read, those in JSON and of ROS 2 are; convert the file to one")


def ros_decoder(kind: str, definition: str = "") -> Decode:
    """The decoder from bytes to a ROS 2 message; kind: its type; definition: its fields, if the file has them."""
    with require_extra("ros"):
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    store = get_typestore(Stores.ROS2_HUMBLE)
    if definition:
        known = get_types_from_msg(definition, kind)
        store.register({name: fields for name, fields in known.items() if name not in store.fielddefs})
    if kind not in store.fielddefs:
        raise UsageError(f"the log does not say what is in its messages of {kind}; record it as MCAP, which does")
    return lambda data: store.deserialize_cdr(data, kind)

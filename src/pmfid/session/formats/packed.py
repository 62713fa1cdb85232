"""Text that is packed by gzip or zstd, with a limit on the unpacked size."""

from __future__ import annotations

import io
import zlib

from pmfid.errors import UsageError
from pmfid.session.formats.safety import check_unpacked, most_of, require_extra

GZIP, ZSTD = b"\x1f\x8b", b"\x28\xb5\x2f\xfd"


def unpack_file(data: bytes) -> bytes:
    """The unpacked bytes of a file; the bytes themselves if they are not packed. Raises UsageError for a decompression
    bomb, and for a truncated file."""
    if data.startswith(GZIP):
        return _unpack_gzip(data)
    return from_zstd(data, most_of(len(data)), "the text") if data.startswith(ZSTD) else data


def from_zstd(data: bytes, most: int, what: str) -> bytes:
    """The unpacked bytes of one or more frames of zstd, at most `most`; what: their name in messages."""
    with require_extra("zst"):
        import zstandard
    packed = io.BytesIO(data)
    try:
        text = zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True).read(most + 1)
    except zstandard.ZstdError:
        text = b""
    if len(text) > most:
        check_unpacked(most_of(len(data)) + 1, len(data), what)
    if not text:
        raise UsageError("not a readable .zst file, truncated or corrupt; export it again")
    return text


def _unpack_gzip(data: bytes) -> bytes:
    """The unpacked bytes of one or more members of gzip."""
    most, text = most_of(len(data)), bytearray()
    rest = data
    while rest.startswith(GZIP):
        member = zlib.decompressobj(wbits=31)
        text += member.decompress(rest, most + 1 - len(text))
        check_unpacked(len(text), len(data), "the text")
        if not member.eof:
            raise UsageError("not a readable .gz file, truncated or corrupt; export it again")
        rest = member.unused_data
    return bytes(text)

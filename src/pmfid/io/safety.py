"""Limits for the unpacked size of a file, and decompression."""

from __future__ import annotations

import io
import logging
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager

from pmfid.errors import UsageError

#: Largest unpacked size of a file, as a multiple of its own size or as a number of bytes. The larger of the two limits
#: counts.
MOST_TIMES, MOST_BYTES = 20, 2**28


@contextmanager
def readable(kind: str) -> Iterator[None]:
    """Turn any error of a reader into a UsageError, except for exceptions that end the program.

    Examples are OSError, ValueError, zlib.error, and the PanicException of polars, which is no Exception.
    """
    try:
        yield
    except UsageError:
        raise
    except BaseException as error:
        if isinstance(error, (KeyboardInterrupt, SystemExit, GeneratorExit)):
            raise
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise UsageError(f"not a readable {kind} file, truncated or corrupt ({reason}); export it again") from None


@contextmanager
def silent() -> Iterator[None]:
    """Suppress warnings and logs of a library, because only the error reports damage to a file."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(before)


@contextmanager
def require_extra(extra: str) -> Iterator[None]:
    """Guard the import of a library from an extra of the package.

    Raises UsageError with the command that installs the extra.
    """
    try:
        yield
    except ImportError as error:
        name = (error.name or extra).partition(".")[0]
        raise UsageError(
            f"{name} is needed to read the file and is not installed: pip install 'pmfid[{extra}]'"
        ) from None


def most_of(packed: int) -> int:
    """Return the largest unpacked size [bytes] that `packed` bytes may have."""
    return max(MOST_BYTES, MOST_TIMES * packed)


def check_unpacked(size: int, packed: int, what: str) -> None:
    """Raise UsageError if `packed` bytes may not unpack to `size` bytes."""
    if size > most_of(packed):
        raise UsageError(
            f"{what} needs {size / 1e6:.0f} MB or more when a file of {packed / 1e6:.2g} MB is unpacked; "
            f"decimate or cut the "
            "record"
        )


def checked_archive(data: bytes) -> zipfile.ZipFile:
    """Return a ZIP archive after a check of its parts and of their declared sizes.

    Raises UsageError for a decompression bomb, and ValueError or BadZipFile for damage.
    """
    archive = zipfile.ZipFile(io.BytesIO(data))
    check_unpacked(sum(part.file_size for part in archive.infolist()), len(data), "what is packed")
    if any(part.flag_bits & 1 for part in archive.infolist()):
        raise UsageError("the file is encrypted; save it without a password")
    if (bad := archive.testzip()) is not None:
        raise ValueError(f"{bad} is damaged")
    return archive


GZIP, ZSTD = b"\x1f\x8b", b"\x28\xb5\x2f\xfd"


def unpack_file(data: bytes) -> bytes:
    """Return the unpacked bytes of a file, or the bytes themselves if they are not packed.

    Raises UsageError for a decompression bomb, and for a truncated file.
    """
    if data.startswith(GZIP):
        return _unpack_gzip(data)
    return from_zstd(data, most_of(len(data)), "the text") if data.startswith(ZSTD) else data


def from_zstd(data: bytes, most: int, what: str) -> bytes:
    """Return the unpacked bytes of one or more frames of zstd, at most `most` bytes. `what` is the name of the data
    in messages.
    """
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
    """Return the unpacked bytes of one or more members of gzip."""
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

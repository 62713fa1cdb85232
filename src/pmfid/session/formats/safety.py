"""Protection against damaged files and decompression bombs: no reader ends the program or unpacks gigabytes."""

from __future__ import annotations

import io
import logging
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager

from pmfid.errors import UsageError

#: Largest unpacked size of a file: a multiple of its own size, or a number of bytes if that is more.
MOST_TIMES, MOST_BYTES = 20, 2**28


@contextmanager
def readable(kind: str) -> Iterator[None]:
    """Turns any error of a reader into a UsageError: OSError, ValueError, zlib.error, and the PanicException of polars,
    which is no Exception. Only exceptions that end the program pass through."""
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
    """No warnings and no logs of a library: damage to a file is reported by the error alone."""
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
    """For the import of a library from an extra of the package: raises UsageError with the command that installs it."""
    try:
        yield
    except ImportError as error:
        name = (error.name or extra).partition(".")[0]
        raise UsageError(f"{name} reads such a file, and is not installed: pip install 'pmfid[{extra}]'") from None


def most_of(packed: int) -> int:
    """Most bytes that `packed` bytes may unpack to."""
    return max(MOST_BYTES, MOST_TIMES * packed)


def check_unpacked(size: int, packed: int, what: str) -> None:
    """Raises UsageError if `packed` bytes may not unpack to `size` bytes."""
    if size > most_of(packed):
        raise UsageError(
            f"{what} takes {size / 1e6:.0f} MB or more out of a file of {packed / 1e6:.2g} MB; decimate or cut the "
            "record"
        )


def checked_archive(data: bytes) -> zipfile.ZipFile:
    """A ZIP archive with whole parts of their declared sizes. Raises UsageError for a decompression bomb, and
    ValueError or BadZipFile for damage."""
    archive = zipfile.ZipFile(io.BytesIO(data))
    check_unpacked(sum(part.file_size for part in archive.infolist()), len(data), "what is packed")
    if any(part.flag_bits & 1 for part in archive.infolist()):
        raise UsageError("the file is encrypted; save it without a password")
    if (bad := archive.testzip()) is not None:
        raise ValueError(f"{bad} is damaged")
    return archive

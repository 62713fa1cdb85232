"""What no reader of a file may do: end the program at a damaged one, or take gigabytes out of a small one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from pmfid.errors import UsageError

#: Values that a file may unpack to, in bytes: so many times its own size, or this many; more is a bomb or a mistake.
MOST_TIMES, MOST_BYTES = 20, 2**28


@contextmanager
def readable(kind: str) -> Iterator[None]:
    """Turns whatever a reader stumbles over into a UsageError: OSError, ValueError, zlib.error, and polars' Rust core a
    PanicException that is no Exception. Only what ends the program passes through."""
    try:
        yield
    except UsageError:
        raise
    except BaseException as error:
        if isinstance(error, (KeyboardInterrupt, SystemExit, GeneratorExit)):
            raise
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise UsageError(f"not a readable {kind} file, truncated or corrupt ({reason}); export it again") from None


def check_unpacked(size: int, packed: int, what: str) -> None:
    """Raises UsageError before so many bytes are taken from so few."""
    if size > max(MOST_BYTES, MOST_TIMES * packed):
        raise UsageError(
            f"{what} takes {size / 1e6:.0f} MB or more out of a file of {packed / 1e6:.2g} MB; decimate or cut the "
            "record"
        )

"""Files of a report: whole or as they were before, and never through a link."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path


def replace_file(path: Path, data: bytes) -> None:
    """Writes `data` in place of what was at the path; a link is replaced, not followed; a device is written to.

    Raises OSError if that cannot be: then the file is what it was.
    """
    if path.exists() and not path.is_file():
        path.write_bytes(data)
        return
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_bytes(data)
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise OSError(error.errno, error.strerror, str(path)) from None


def write_json(path: Path, content: Mapping[str, object]) -> None:
    """Writes an object as JSON, as `replace_file` does."""
    replace_file(path, (json.dumps(content, indent=2, allow_nan=False) + "\n").encode())

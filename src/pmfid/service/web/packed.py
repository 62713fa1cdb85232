"""Lines of JSON, arrays in them as their bytes in base64: exact to the bit, and quick to write and to read."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pmfid.presentation import plain
from pmfid.service.board import Overview
from pmfid.service.board.panel import Records

__all__ = ["json_line", "pack_array", "pack_overview", "pack_rows"]


def pack_array(array: NDArray[np.generic], kind: str) -> str:
    """`kind:base64`; kind: f8, f4, i4, u4 or u1, little endian. NaN and infinity stay what they are."""
    return f"{kind}:{b64encode(np.ascontiguousarray(array, '<' + kind).tobytes()).decode('ascii')}"


def pack_rows(rows: Records) -> dict[str, object]:
    """Columns of rows by name; of theta and std a list with one for each parameter. Whole numbers are f8, exact to
    2^53, which is what a browser computes with."""
    columns: dict[str, object] = {
        name: pack_array(rows[name], "f8") for name in ("number", "time", "u", "counts", "innovation")
    }
    for name in ("theta", "std"):
        columns[name] = [pack_array(column, "f8") for column in rows[name].T]
    return {**columns, "status": pack_array(rows["status"], "u4"), "state": pack_array(rows["state"], "u1")}


def pack_overview(group: int, overview: Overview, start: float) -> dict[str, object]:
    """Changes in a group; received: in tenths of a second after `start`, by `time.monotonic()`."""
    return {
        "group": group,
        "axis": pack_array(overview.axis, "i4"),
        "received": pack_array(np.round(10 * (overview.received - start)), "i4"),
        "value": pack_array(overview.value, "f4"),
        "std": pack_array(overview.std, "f4"),
        "deviation": pack_array(overview.deviation, "f4"),
        "status": pack_array(overview.status, "u4"),
        "state": pack_array(overview.state, "u1"),
    }


def json_line(content: Mapping[str, object]) -> bytes:
    """One line of NDJSON; numbers that JSON does not have are null."""
    try:
        text = json.dumps(content, allow_nan=False, separators=(",", ":"))
    except (TypeError, ValueError):
        text = json.dumps(plain(content), allow_nan=False, separators=(",", ":"))
    return text.encode() + b"\n"

"""MDF4 files, which measuring systems in vehicles write."""

from __future__ import annotations

import io
from contextlib import closing, suppress
from typing import Any

import numpy as np

from pmfid.io.safety import check_unpacked, require_extra
from pmfid.io.tables import ClockedSignals, Signal

MAGIC = (b"MDF     ", b"UnFinMF ")


def parse_mdf(data: bytes) -> ClockedSignals:
    """Return the channels of numbers by name, with their unit in brackets.

    If a name is repeated, the column name contains the number of the group. Raises UsageError for a decompression bomb.
    `readable` turns errors of asammdf into UsageError.
    """
    found: dict[str, Signal] = {}
    with require_extra("mdf4"):
        from asammdf.blocks.mdf_v4 import MDF4
    whole = type("Whole", (MDF4,), {"__del__": _silence_close})
    with closing(whole(io.BytesIO(data), __internal__=True, original_name=None)) as file:
        check_unpacked(_size(file), len(data), "the data")
        for k, group in enumerate(file.groups):
            for j, channel in enumerate(group.channels):
                signal = file.get(group=k, index=j, ignore_invalidation_bits=True)
                if channel.channel_type in (2, 3) or signal.samples.dtype.kind not in "biuf" or signal.samples.ndim > 1:
                    continue  # the channel is the clock or a text
                name = f"{signal.name} [{signal.unit}]" if signal.unit else signal.name
                name = f"{k}.{name}" if name in found else name
                found[name] = Signal(np.asarray(signal.timestamps, np.float64), signal.samples)
    return ClockedSignals(found)


def _silence_close(file: Any) -> None:
    """Close a file without messages, because an incompletely read file would report on standard error."""
    with suppress(Exception):
        file._tempfile.close()


def _size(file: Any) -> int:
    """Return the bytes of all values as numbers."""
    return sum(8 * int(group.channel_group.cycles_nr) * len(group.channels) for group in file.groups)

"""TDMS files, which LabVIEW writes."""

from __future__ import annotations

import io
import struct
from typing import Any

import numpy as np

from pmfid.io.safety import check_unpacked, require_extra
from pmfid.io.tables import ClockedSignals, Signal, Table

MAGIC = b"TDSm"
#: Number of bytes before a segment, and declared size of a segment that the writer did not finish.
LEAD_IN, UNFINISHED = 28, 2**64 - 1


def parse_tdms(data: bytes) -> Table:
    """Return the channels as "group.channel", or as "channel" if the file has one group, with their unit in brackets.

    Waveforms have their own clocks. Raises UsageError for a decompression bomb. `readable` turns errors of npTDMS into
    UsageError.
    """
    with require_extra("tdms"):
        from nptdms import TdmsFile
    _check_whole(data)
    with TdmsFile.open(io.BytesIO(data)) as file:
        channels = [channel for group in file.groups() for channel in group.channels()]
        check_unpacked(sum(8 * len(channel) for channel in channels), len(data), "the data")
        alone = len(file.groups()) == 1
        columns = {_name(channel, alone): channel for channel in channels}
        if all("wf_increment" in channel.properties for channel in channels):
            return ClockedSignals({name: Signal(channel.time_track(), channel[:]) for name, channel in columns.items()})
        return {name: np.asarray(channel[:]) for name, channel in columns.items()}


def _check_whole(data: bytes) -> None:
    """Raise ValueError if a segment is longer than the file, because its channels would be cut without a warning.

    An unfinished segment is allowed.
    """
    place = 0
    while place < len(data):
        if len(data) - place < LEAD_IN:
            raise ValueError("a segment is cut off")
        (size,) = struct.unpack_from("<Q", data, place + 12)
        if size == UNFINISHED:
            return
        place += LEAD_IN + size
    if place > len(data):
        raise ValueError("the last segment is cut off")


def _name(channel: Any, alone: bool) -> str:
    unit = str(channel.properties.get("unit_string", ""))
    name = str(channel.name) if alone else f"{channel.group_name}.{channel.name}"
    return f"{name} [{unit}]" if unit else name

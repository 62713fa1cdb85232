"""TDMS files, as LabVIEW writes them."""

from __future__ import annotations

import io
import struct
from typing import Any

import numpy as np

from pmfid.session.formats.safety import check_unpacked, require_extra
from pmfid.session.formats.signals import ClockedSignals, Signal
from pmfid.session.tables import Table

MAGIC = b"TDSm"
#: Bytes in front of a segment, and its size where the writer was ended before it knew.
LEAD_IN, UNFINISHED = 28, 2**64 - 1


def parse_tdms(data: bytes) -> Table:
    """The channels as "group.channel", or "channel" where there is one group, with their unit in brackets: of waveforms
    with their clock, else as they are. Raises UsageError for a bomb, and with what npTDMS raises what `readable` turns
    into one."""
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
    """Raises ValueError where a segment goes on behind the end of the file: its channels would be cut short, without a
    word. One that was never finished says so."""
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

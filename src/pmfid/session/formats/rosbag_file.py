"""Bags of ROS 2: a folder of files, or one of these files; this reader takes bags in SQLite."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from pmfid.errors import UsageError
from pmfid.session.formats.mcap_file import ros_decoder
from pmfid.session.formats.messages import signals_of
from pmfid.session.formats.safety import require_extra
from pmfid.session.formats.signals import ClockedSignals

if TYPE_CHECKING:
    from rosbags.rosbag2 import Reader

SQLITE = b"SQLite format 3\x00"


def file_of(folder: Path) -> Path:
    """The record in the folder of a bag, or in another folder. Raises UsageError for no record, and for several."""
    found = sorted(path for suffix in ("mcap", "db3", "parquet") for path in folder.rglob(f"*.{suffix}"))
    found = [path for path in found if "meta" not in path.relative_to(folder).parts[:-1]]  # of LeRobot
    if len(found) == 1:
        return found[0]
    listed = ", ".join(str(path.relative_to(folder)) for path in found[:5]) or "none"
    raise UsageError(f"a folder with one log is a record, this one has {listed}; give the path of a file")


def parse_rosbag(data: bytes) -> ClockedSignals:
    """The numbers in the messages, named as "/topic.field.0", with the stamps of their recording."""
    with require_extra("ros"):
        from rosbags.rosbag2 import Reader
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bag.db3"  # SQLite reads files
        path.write_bytes(data)
        with Reader(path) as bag:
            if bag.compression_format:
                raise UsageError("a packed bag is not read; convert it, as with ros2 bag convert")
            return signals_of(_messages(bag))


def _messages(bag: Reader) -> Iterator[tuple[str, int, object]]:
    decoders: dict[str, Callable[[bytes], object]] = {}
    for connection, stamp, data in bag.messages():
        kind = connection.msgtype
        if kind not in decoders:
            decoders[kind] = ros_decoder(kind, connection.msgdef.data)
        yield connection.topic, stamp, decoders[kind](data)

"""A source of Spark for files of blocks that grow, as gateways write them: blocks of docs/wire.md in a row."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pyspark.sql.datasource import DataSource, DataSourceStreamReader, InputPartition

from pmfid.fleet.tuning import TUNING
from pmfid.stream.blocks import BlockStream, encode
from pmfid.stream.delivery import Block

if TYPE_CHECKING:
    from pyspark.sql.types import StructType

__all__ = ["BlockFiles"]


class BlockFiles(DataSource):  # type: ignore[misc]
    """`spark.readStream.format("pmfid-blocks").load(FOLDER)`: columns `axis`, `block` of the *.pmfb files there.

    A file may grow at its end, and new ones may come. Where the source stands is the size of each file that it has
    read, so what is read again after a restart are the same bytes.
    """

    @classmethod
    def name(cls) -> str:
        return "pmfid-blocks"

    def schema(self) -> str:
        return "axis string, block binary"

    def streamReader(self, schema: StructType) -> _BlockReader:
        return _BlockReader(Path(self.options["path"]))


class _Range(InputPartition):  # type: ignore[misc]
    """Bytes of a file."""

    def __init__(self, path: str, start: int, end: int) -> None:
        self.path, self.start, self.end = path, start, end


class _BlockReader(DataSourceStreamReader):  # type: ignore[misc]
    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def initialOffset(self) -> dict[str, int]:
        return {}

    def latestOffset(self, start: dict[str, int], limit: object) -> dict[str, int]:
        """Where each file ends now, at the end of a block; what has only begun waits."""
        found = dict(start)
        for path in sorted(self._folder.glob("*.pmfb")):
            known = start.get(path.name, 0)
            if path.is_file() and path.stat().st_size > known:
                found[path.name] = known + _whole(path, known)
        return found

    def partitions(self, start: dict[str, int], end: dict[str, int]) -> list[_Range]:
        pairs = ((name, start.get(name, 0), size) for name, size in sorted(end.items()))
        return [_Range(str(self._folder / name), first, last) for name, first, last in pairs if last > first]

    def read(self, partition: _Range) -> Iterator[tuple[Any, ...]]:
        """What is no block is a row as well, so that the shards count it."""
        with open(partition.path, "rb") as file:
            file.seek(partition.start)
            data = file.read(partition.end - partition.start)
        for item in BlockStream().feed(data):
            yield (item.axis, encode(item)) if isinstance(item, Block) else ("", item.reason.encode())


def _whole(path: Path, start: int) -> int:
    """Bytes of whole blocks from `start` on."""
    stream, size = BlockStream(), 0
    with open(path, "rb") as file:
        file.seek(start)
        while data := file.read(TUNING.block_files_piece):
            stream.feed(data)
            size += len(data)
    return size - stream.waiting

"""Classes that Spark runs, which read growing files of blocks and process a shard with its state."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from struct import Struct
from typing import TYPE_CHECKING, Any

from pyspark.sql.datasource import DataSource, DataSourceStreamReader, InputPartition
from pyspark.sql.streaming.stateful_processor import StatefulProcessor, StatefulProcessorHandle

from pmfid.fleet.shards import StreamPlan, StreamShard, table_of
from pmfid.fleet.tuning import TUNING
from pmfid.stream.blocks import BlockStream, encode
from pmfid.stream.delivery import Block

if TYPE_CHECKING:
    import pandas as pd
    from pyspark.sql.types import StructType


class BlockFiles(DataSource):  # type: ignore[misc]
    """The source `spark.readStream.format("pmfid-blocks").load(FOLDER)` with the columns `axis` and `block` of *.pmfb
    files.

    A file may grow at its end, and new files may come. The position of the source is the size of each file that it has
    read. After a restart, equal positions therefore give equal bytes.
    """

    @classmethod
    def name(cls) -> str:
        return "pmfid-blocks"

    def schema(self) -> str:
        return "axis string, block binary"

    def streamReader(self, schema: StructType) -> _BlockReader:
        return _BlockReader(Path(self.options["path"]))


class _Range(InputPartition):  # type: ignore[misc]
    """A range of bytes in a file."""

    def __init__(self, path: str, start: int, end: int) -> None:
        self.path, self.start, self.end = path, start, end


class _BlockReader(DataSourceStreamReader):  # type: ignore[misc]
    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def initialOffset(self) -> dict[str, int]:
        return {}

    def latestOffset(self, start: dict[str, int], limit: object) -> dict[str, int]:
        """Return the size of each file up to its last whole block. An incomplete block waits."""
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
        """Yield a row for each block. Invalid data also become a row, so that the shards count them."""
        with open(partition.path, "rb") as file:
            file.seek(partition.start)
            data = file.read(partition.end - partition.start)
        for item in BlockStream().feed(data):
            yield (item.axis, encode(item)) if isinstance(item, Block) else ("", item.reason.encode())


def _whole(path: Path, start: int) -> int:
    """Return the number of bytes of whole blocks from `start`."""
    stream, size = BlockStream(), 0
    with open(path, "rb") as file:
        file.seek(start)
        while data := file.read(TUNING.block_files_piece):
            stream.feed(data)
            size += len(data)
    return size - stream.waiting


#: The name of the state, and its only column, which holds the body of a checkpoint, packed by `pack_state`.
STATE, COLUMN = "shard", "body binary"
#: Size of a body [bytes].
SIZE = Struct("<Q")


def pack_state(body: bytes) -> bytes:
    """Return the size of a body and its compressed bytes, about a third, because Spark copies a state several times."""
    from pyarrow import compress

    return SIZE.pack(len(body)) + bytes(compress(body, "lz4", asbytes=True))


def unpack_state(state: bytes) -> bytes:
    """Return the body. Raises ValueError for bytes that `pack_state` has not made."""
    from pyarrow import decompress

    size = SIZE.unpack_from(state)[0] if len(state) >= SIZE.size else -1
    if not 0 <= size <= TUNING.processor_most * len(state):
        raise ValueError("the block is damaged, or has another version")
    return bytes(decompress(memoryview(state)[SIZE.size :], size, "lz4", asbytes=True))


class ShardProcessor(StatefulProcessor):  # type: ignore[misc]
    """The processor of the shards, with a key for each shard.

    The rows of a shard have the column `block`, which is never missing. If an initial state is given, the shard begins
    with this state.
    """

    def __init__(self, plan: StreamPlan, keys: Sequence[int]) -> None:
        self._plan = plan
        self._numbers = {key: number for number, key in enumerate(keys)}

    def init(self, handle: StatefulProcessorHandle) -> None:
        self._state = handle.getValueState(STATE, COLUMN)

    def handleInputRows(self, key: Any, rows: Iterator[pd.DataFrame], timerValues: Any) -> Iterator[pd.DataFrame]:
        kept = self._state.get()
        shard = StreamShard(self._plan, self._numbers[int(key[0])], None if kept is None else unpack_state(kept[0]))
        shard.take([bytes(data) for frame in rows for data in frame["block"]])
        self._state.update((pack_state(shard.save_state()),))
        yield table_of(shard).to_pandas()

    def handleInitialState(self, key: Any, initialState: pd.DataFrame, timerValues: Any) -> None:
        """Begin from states that came from elsewhere."""
        self._state.update((pack_state(initialState["body"].iloc[0]),))

    def close(self) -> None:
        pass

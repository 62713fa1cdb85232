"""What Spark runs for a shard: its state out of the state store, the blocks of a batch, its state back."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from struct import Struct
from typing import TYPE_CHECKING, Any

from pyspark.sql.streaming.stateful_processor import StatefulProcessor, StatefulProcessorHandle

from pmfid.fleet.stream.shard import StreamPlan, StreamShard, table_of
from pmfid.fleet.tuning import TUNING

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["STATE", "ShardProcessor", "pack_state", "unpack_state"]

#: The name of the state, and its one column: the body of a checkpoint of `pmfid serve`, as `pack_state` makes it.
STATE, COLUMN = "shard", "body binary"
#: Of a body [bytes].
SIZE = Struct("<Q")


def pack_state(body: bytes) -> bytes:
    """The size of a body, and its compressed bytes, about a third: Spark copies a state several times on its way."""
    from pyarrow import compress

    return SIZE.pack(len(body)) + bytes(compress(body, "lz4", asbytes=True))


def unpack_state(state: bytes) -> bytes:
    """The body. Raises ValueError for bytes that `pack_state` has not made."""
    from pyarrow import decompress

    size = SIZE.unpack_from(state)[0] if len(state) >= SIZE.size else -1
    if not 0 <= size <= TUNING.processor_most * len(state):
        raise ValueError("it is damaged, or of another version")
    return bytes(decompress(memoryview(state)[SIZE.size :], size, "lz4", asbytes=True))


class ShardProcessor(StatefulProcessor):  # type: ignore[misc]
    """keys: of each shard; rows: the column `block`, nowhere missing; a checkpoint's body of a shard to begin with
    where one is given."""

    def __init__(self, plan: StreamPlan, keys: Sequence[int]) -> None:
        self._plan = plan
        self._numbers = {key: number for number, key in enumerate(keys)}

    def init(self, handle: StatefulProcessorHandle) -> None:
        self._state = handle.getValueState(STATE, COLUMN)

    def handleInputRows(self, key: Any, rows: Iterator[pd.DataFrame], timerValues: Any) -> Iterator[pd.DataFrame]:
        """The rows of a batch: estimates, notices, counts."""
        kept = self._state.get()
        shard = StreamShard(self._plan, self._numbers[int(key[0])], None if kept is None else unpack_state(kept[0]))
        shard.take([bytes(data) for frame in rows for data in frame["block"]])
        self._state.update((pack_state(shard.save_state()),))
        yield table_of(shard).to_pandas()

    def handleInitialState(self, key: Any, initialState: pd.DataFrame, timerValues: Any) -> None:
        """Begins from states that came from elsewhere."""
        self._state.update((pack_state(initialState["body"].iloc[0]),))

    def close(self) -> None:
        """Nothing is open."""
